"""What a band filter does to energies in fine time bins, as one product of spectra."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft

from roomfit.signals.filters import FilterBank, energy_share, ringing_s, smearing_kernel
from roomfit.typing import ComplexArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Smearing:
    """The filter of one band on uniform bins.

    Attributes
    ----------
    n_bins, length : int
        Length of what is smeared, and of its transform.
    spectrum : complex array, shape (length // 2 + 1,)
        Of the shares in which an impulse's energy falls into the bins about its own.
    squares : complex array, shape (length // 2 + 1,)
        Of the squares of these shares.
    """

    n_bins: int
    length: int
    spectrum: ComplexArray
    squares: ComplexArray


def band_smearing(bank: FilterBank, n_bins: int, bin_s: float) -> Smearing:
    """Return the smearing of the first band of a bank on so many bins of one width."""
    reach = min(n_bins, int(np.ceil(float(ringing_s(bank)[0]) / bin_s)))
    lags = np.arange(-reach, reach + 1)
    edges_s = bin_s * (np.arange(-reach, reach + 2) - 0.5)
    share = energy_share(smearing_kernel(bank), 0, [0.0], edges_s)[0]
    length = fft.next_fast_len(n_bins + reach, real=True)
    kernels = np.zeros((2, length))
    np.add.at(kernels[0], lags % length, share)
    np.add.at(kernels[1], lags % length, share**2)
    spectra = fft.rfft(kernels, axis=1)
    return Smearing(n_bins, length, spectra[0], spectra[1])


def smear(smearing: Smearing, energies: FloatArray) -> FloatArray:
    """Return energies as the filter would show them, shape (..., n_bins); never negative.

    What the filter carries beyond the first or the last bin is lost.
    """
    # the transform's rounding, 1e-16 of the largest, must not make an energy negative
    return np.maximum(_through(smearing, smearing.spectrum, energies), 0.0)


def smear_squares(smearing: Smearing, squares: FloatArray) -> FloatArray:
    """Return sums of squared shares times squared energies of lone impulses, (..., n_bins)."""
    return np.maximum(_through(smearing, smearing.squares, squares), 0.0)


def before_smearing(smearing: Smearing, gradients: FloatArray) -> FloatArray:
    """Return derivatives by the energies before the filter from those by the energies after it.

    The transpose of `smear`; shapes (..., n_bins).
    """
    return _through(smearing, np.conj(smearing.spectrum), gradients)


def _through(smearing: Smearing, spectrum: ComplexArray, rows: FloatArray) -> FloatArray:
    transformed = fft.rfft(rows, smearing.length, axis=-1)
    return np.asarray(
        fft.irfft(transformed * spectrum, smearing.length, axis=-1)[..., : smearing.n_bins]
    )
