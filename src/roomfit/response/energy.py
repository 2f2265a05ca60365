"""The energy reader of paths: window energies by band, with their derivative by absorption."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.errors import CannotTell, InputError
from roomfit.response.rows import EnergyRows
from roomfit.response.weighing import (
    pieces_of,
    power_table,
    sum_pieces,
    weigh_batches,
    weigh_parallel,
    weigh_serial,
)
from roomfit.typing import FloatArray

# Two milliseconds of work: threads wake in microseconds, but a busy machine keeps the last of them
# waiting for milliseconds.
_ROWS_WORTH_THREADS = 200_000


@dataclass(frozen=True, slots=True, eq=False)
class EnergyResponse:
    """Energy of every band and window of one pair.

    Attributes
    ----------
    energy : float array, shape (n_bands, n_windows)
        1/m2 for a source of unit power: the direct sound at r metres is ``1 / (4 pi r**2)``.
    derivative : float array, shape (n_materials, n_bands, n_windows), or None
        Derivative by the absorption of each material in the same band; never positive.
    """

    energy: FloatArray
    derivative: FloatArray | None


def weigh(
    rows: EnergyRows,
    coefficients: FloatArray,
    attenuation_per_m: FloatArray,
    *,
    derivative: bool = True,
) -> EnergyResponse:
    """Return the window energies under an absorption: one pass over the rows for all bands.

    Smooth in every coefficient and falling in each. The derivative is exact, at a = 0 and a = 1
    too. Same bits for any number of threads.

    Parameters
    ----------
    rows : EnergyRows
    coefficients : float array, shape (n_materials, n_bands)
        Energy absorption, 0 to 1.
    attenuation_per_m : float array, shape (n_bands,)
        Energy attenuation of the air, 0 or more.
    derivative : bool
        False leaves the derivative out and takes about half the time.

    Raises
    ------
    InputError
        Wrong shape, or a value out of range.

    Notes
    -----
    Sum over the rows of ``weight exp(-m length) product of (1 - a)**hits``;
    `roomfit.materials.absorption.surviving_energy` is the readable form of the product.
    """
    reflected, attenuation = _checked(rows, coefficients, attenuation_per_m)
    n_bands, n_materials = reflected.shape
    powers = power_table(reflected, rows.max_hits)
    pieces = pieces_of(rows.offsets)
    energies = np.zeros((len(pieces), n_bands))
    slopes = np.zeros((len(pieces), n_bands, n_materials if derivative else 0))
    small = len(rows) * n_bands < _ROWS_WORTH_THREADS
    (weigh_serial if small else weigh_parallel)(
        *(pieces, rows.weight_per_m2, rows.hits, rows.length_m),
        *(reflected, powers, attenuation, energies, slopes),
    )
    energy = np.zeros((n_bands, rows.n_windows))
    by_absorption = np.zeros((n_materials if derivative else 0, n_bands, rows.n_windows))
    sum_pieces(pieces, energies, slopes, energy, by_absorption)
    return EnergyResponse(energy, by_absorption if derivative else None)


def batch_energies(
    rows: EnergyRows, coefficients: FloatArray, attenuation_per_m: FloatArray
) -> FloatArray:
    """Return what each Monte-Carlo batch of rays adds to the window energies.

    Their sum and the energy of the image paths, which are in no batch, make up `weigh`'s energy.

    Returns
    -------
    float array, shape (n_batches, n_bands, n_windows)
    """
    reflected, attenuation = _checked(rows, coefficients, attenuation_per_m)
    n_batches = max(rows.n_batches, int(rows.batch.max(initial=-1)) + 1)
    energy = np.zeros((n_batches, len(attenuation), rows.n_windows))
    weigh_batches(
        *(rows.offsets, rows.batch, rows.weight_per_m2, rows.hits, rows.length_m),
        *(power_table(reflected, rows.max_hits), attenuation, energy),
    )
    return energy


def monte_carlo_sd(
    rows: EnergyRows, coefficients: FloatArray, attenuation_per_m: FloatArray
) -> FloatArray:
    """Return the standard error of the window energies that comes from the number of rays.

    From the spread of independent batches, which those of a Fibonacci spiral are not; zero where
    all energy comes from image paths.

    Returns
    -------
    float array, shape (n_bands, n_windows)
        Standard deviation of `weigh`'s energy over repeated traces, 1/m2.

    Raises
    ------
    CannotTell
        The rays form a single batch.
    """
    batches = batch_energies(rows, coefficients, attenuation_per_m)
    if not np.any(rows.batch >= 0):
        return np.zeros(batches.shape[1:])
    if len(batches) < 2:
        raise CannotTell(
            "one batch of rays does not tell its own noise",
            needed="at least 2 independent batches",
            hint="trace with n_batches of 8 or more",
        )
    return np.asarray(np.sqrt(len(batches) * np.var(batches, axis=0, ddof=1)))


def _checked(
    rows: EnergyRows, coefficients: FloatArray, attenuation_per_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return reflected energy (n_bands, n_materials) and attenuation, both ready for kernels."""
    attenuation = np.ascontiguousarray(attenuation_per_m, dtype=np.float64)
    a = np.asarray(coefficients, dtype=np.float64)
    if attenuation.ndim != 1 or a.shape != (len(rows.materials), attenuation.size):
        raise InputError(
            "absorption, attenuation and rows do not fit together",
            found=f"coefficients of shape {a.shape}, attenuation of shape {attenuation.shape}",
            needed=f"({len(rows.materials)}, n_bands) and (n_bands,)",
        )
    if not np.all((a >= 0.0) & (a <= 1.0)):
        raise InputError(
            "absorption coefficient out of range",
            found=f"values from {a.min():g} to {a.max():g}",
            needed="0 <= a <= 1 (energy, dimensionless)",
        )
    if not np.all((attenuation >= 0.0) & np.isfinite(attenuation)):
        raise InputError(
            "air attenuation out of range",
            found=f"values from {attenuation.min():g} to {attenuation.max():g} per metre",
            needed="0 or more",
        )
    # a copy, so that kernels always see a writable, contiguous array: one compiled form
    return np.array(1.0 - a.T, order="C"), np.array(attenuation)
