"""Time windows of a band, and the energy spreading of its filter between fine time bins.

Windows are fine early, where reflections distinguish walls, and grow late.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import fft
from scipy.sparse import csr_array

from roomfit.base.bands import BandKind, Bands
from roomfit.base.kernels import kernel
from roomfit.base.typing import ComplexArray, FloatArray, IntArray
from roomfit.signals.filters import energy_share, ringing_s, spreading_kernel


@dataclass(frozen=True, slots=True, eq=False)
class Spreading:
    """The filter of one band on uniform bins."""

    # n_bins, length: length of what is spread, and of its transform
    n_bins: int
    length: int
    # (length // 2 + 1,), of the shares in which an impulse's energy falls into the bins about its
    # own
    spectrum: ComplexArray
    squares: ComplexArray  # (length // 2 + 1,), of the squares of these shares


def band_spreading(bands: Bands, n_bins: int, bin_s: float) -> Spreading:
    """Return the spreading of the first of some bands on so many bins of one width."""
    return _band_spreading(bands.kind, float(bands.centres_hz[0]), n_bins, bin_s)


# of the bands of a few fits: each pair of a room has the same
@lru_cache(maxsize=32)
def _band_spreading(kind: BandKind, centre_hz: float, n_bins: int, bin_s: float) -> Spreading:
    bands = Bands(kind, np.array([centre_hz]))
    reach = min(n_bins, int(np.ceil(float(ringing_s(bands)[0]) / bin_s)))
    lags = np.arange(-reach, reach + 1)
    edges_s = bin_s * (np.arange(-reach, reach + 2) - 0.5)
    share = energy_share(spreading_kernel(bands), 0, [0.0], edges_s)[0]
    length = fft.next_fast_len(n_bins + reach, real=True)
    kernels = np.zeros((2, length))
    np.add.at(kernels[0], lags % length, share)
    np.add.at(kernels[1], lags % length, share**2)
    spectra = fft.rfft(kernels, axis=1)
    return Spreading(n_bins, length, spectra[0], spectra[1])


def spread_energy(spreading: Spreading, energies: FloatArray) -> FloatArray:
    """Return energies as the filter would show them, shape (..., n_bins); never negative.

    What the filter carries beyond the first or the last bin is lost.
    """
    # the transform's rounding, 1e-16 of the largest, must not make an energy negative
    return np.maximum(_through(spreading, spreading.spectrum, energies), 0.0)


def spread_squared_energy(spreading: Spreading, squares: FloatArray) -> FloatArray:
    """Return sums of squared shares times squared energies of single impulses, (..., n_bins)."""
    return np.maximum(_through(spreading, spreading.squares, squares), 0.0)


def despread(spreading: Spreading, gradients: FloatArray) -> FloatArray:
    """Return derivatives by the energies before the filter from those by the energies after it."""
    return _through(spreading, np.conj(spreading.spectrum), gradients)


def _through(spreading: Spreading, spectrum: ComplexArray, rows: FloatArray) -> FloatArray:
    transformed = fft.rfft(rows, spreading.length, axis=-1)
    return np.asarray(
        fft.irfft(transformed * spectrum, spreading.length, axis=-1)[..., : spreading.n_bins]
    )


WINDOW_DECAYS = {"T20_s": (-5.0, -25.0), "EDT_s": (0.0, -10.0)}
"""Ranges of levels in dB that `windows_decay_s` knows."""


def windows_decay_s(edges_s: FloatArray, energy: FloatArray, name: str) -> float:
    """Return T20 or EDT of one response from the energies of its windows, noise taken off, in s.

    From the line through what is left at the windows' beginnings, 5 to 25 or 0 to 10 dB below the
    whole; NaN where fewer than three lie there. Energy after the last window is left out.
    """
    highest_db, lowest_db = WINDOW_DECAYS[name]
    left = np.cumsum(np.maximum(energy, 0.0)[::-1])[::-1]
    level_db = 10.0 * np.log10(np.maximum(left, np.finfo(np.float64).tiny) / max(left[0], 1e-300))
    inside = (level_db <= highest_db) & (level_db >= lowest_db)
    if np.count_nonzero(inside) < 3:
        return float("nan")
    slope, _ = np.polyfit(edges_s[:-1][inside], level_db[inside], 1)
    return float(-60.0 / slope) if slope < 0.0 else float("nan")


def with_squares(
    spreading: csr_array, row: FloatArray, squares: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return ``shares @ row`` and ``shares**2 @ squares`` in one pass, (n_windows,) each."""
    once, twice = np.empty((2, spreading.shape[0]))
    _add_up_both(spreading.indptr, spreading.indices, spreading.data, row, squares, once, twice)
    return once, twice


def squares_in_windows(spreading: csr_array, row: FloatArray) -> FloatArray:
    """Return ``shares**2 @ row`` without an array of squares, shape (n_windows,)."""
    return with_squares(spreading, row, row)[1]


@kernel(allocates=False)
def _add_up_both(
    pointers: IntArray,
    bins: IntArray,
    spreading: FloatArray,
    row: FloatArray,
    squares: FloatArray,
    once: FloatArray,
    twice: FloatArray,
) -> None:
    for w in range(len(pointers) - 1):
        a = b = 0.0
        for e in range(pointers[w], pointers[w + 1]):
            share, at = spreading[e], bins[e]
            a += share * row[at]
            b += share * share * squares[at]
        once[w], twice[w] = a, b


def window_edges_s(
    direct_s: float,
    end_s: float,
    bandwidth_hz: float,
    *,
    periods: float = 1.5,
    fine_s: float = 0.0,
) -> FloatArray:
    """Return the edges of the windows in which a band's energy is compared, (n_windows + 1,).

    The first window holds the direct sound. Widths are ``max(dt, 0.1 (t - direct))`` with ``dt =
    max(1 ms, periods / B)``: a band of bandwidth B does not resolve time any finer, and late energy
    falls so evenly that a tenth of the elapsed time loses nothing.
    """
    finest_s = max(1e-3 if fine_s == 0.0 else 0.5e-3, periods / bandwidth_hz)
    before_s = 2.0 * max(1e-3, 1.5 / bandwidth_hz)
    edges = [direct_s - before_s, direct_s + finest_s]
    while True:
        elapsed_s = edges[-1] - direct_s
        following = edges[-1] + max(finest_s, (0.03 if elapsed_s < fine_s else 0.1) * elapsed_s)
        if following > end_s:
            return np.array(edges)
        edges.append(following)
