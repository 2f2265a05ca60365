"""Traced paths reweighed for another scattering coefficient, band by band."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import prange

from roomfit._numba import kernel
from roomfit.errors import InputError
from roomfit.materials.priors import Scattering
from roomfit.response.energy import EnergyRows, reweighed_rows
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray, IntArray

# Below it a few paths carry all the weight, and the trace is to be made again.
LEAST_EFFECTIVE_FRACTION = 0.1
_SLICES = 8
_FEWEST_IN_SLICE = 32


def scattering_weights(paths: Paths, scattering: Scattering) -> FloatArray:
    """Return the factor on each path's weight that turns the sampled scattering into another.

    A path with d diffuse and n specular hits on a material was drawn with probability
    ``s0**d (1 - s0)**n`` and would be with ``s**d (1 - s)**n``; the factor is their ratio,
    multiplied over materials.

    Parameters
    ----------
    paths : Paths
        Traced with the sampling coefficients s0.
    scattering : Scattering
        The coefficients s wanted, materials in the same order.

    Returns
    -------
    float array, shape (n_paths,)
        Exactly 1 where s = s0. See `effective_sample_size` for how far the factors can be trusted.

    Raises
    ------
    InputError
        Other materials, or another s for a material traced with s0 = 0 or 1: of one kind of
        reflection no path was ever drawn.
    """
    if scattering.materials != paths.materials:
        raise InputError(
            "scattering and paths name different materials",
            found=", ".join(scattering.materials),
            needed=", ".join(paths.materials),
        )
    ratios = np.ones((2, len(paths.materials)))
    sampled = zip(paths.sampling_scattering, scattering.coefficients, strict=True)
    for m, (s0, s) in enumerate(sampled):
        if s == s0:
            continue
        if s0 in (0.0, 1.0):
            raise InputError(
                "scattering cannot be changed after the trace",
                where=f"material {paths.materials[m]!r}",
                found=f"traced with {s0:g}, wanted {s:g}",
                needed="a sampling coefficient between 0 and 1",
                hint="trace again with the coefficient that is wanted",
            )
        ratios[:, m] = s / s0, (1.0 - s) / (1.0 - s0)
    factor = np.empty(len(paths))
    _ratios_to_the_hits(ratios, paths.hits_diffuse, paths.hits_specular, factor)
    return factor


@kernel(parallel=True)
def _ratios_to_the_hits(
    ratios: FloatArray, diffuse: IntArray, specular: IntArray, factor: FloatArray
) -> None:
    """Fill the product over materials of both ratios to the power of the hits; 0 ** 0 is 1."""
    for i in prange(len(factor)):
        product = 1.0
        for m in range(ratios.shape[1]):
            if ratios[0, m] != 1.0:
                product *= ratios[0, m] ** np.int64(diffuse[i, m])
                product *= ratios[1, m] ** np.int64(specular[i, m])
        factor[i] = product


def effective_sample_size(factors: FloatArray) -> float:
    """Return the number of paths of equal weight and equal variance, ``(sum f)**2 / sum f**2``.

    Parameters
    ----------
    factors : float array, shape (n_paths,)
        From `scattering_weights`, of the paths whose energy is to be trusted. 0 for none. Trace
        again when it falls below about a tenth of their number.

    References
    ----------
    .. [1] L. Kish, "Survey Sampling", Wiley (1965).

    Examples
    --------
    Three paths, of which one has lost its weight, are worth two.

    >>> effective_sample_size(np.array([1.0, 1.0, 0.0]))
    2.0
    """
    square = float(np.sum(np.square(factors)))
    return float(np.sum(factors)) ** 2 / square if square > 0.0 else 0.0


def rows_for_band(
    rows: Sequence[EnergyRows], paths: Paths, scattering: Scattering
) -> tuple[tuple[EnergyRows, ...], float]:
    """Return rows with the weights that another scattering gives them, and what they are worth.

    Image paths are thinned by ``((1 - s) / (1 - s0)) ** hits`` and stay exact. What they are worth
    is the least `effective_sample_fraction` of the pairs: trace again, nearer to what is wanted,
    where that is below `LEAST_EFFECTIVE_FRACTION`.

    Parameters
    ----------
    rows : sequence of EnergyRows
        Made from `paths` by `energy_rows`, of any pairs; merged or squared ones cannot be used.
    scattering : Scattering
        What is wanted in this band.

    Raises
    ------
    InputError
        As `scattering_weights`.
    """
    if np.array_equal(scattering.coefficients, paths.sampling_scattering):
        return tuple(rows), 1.0
    factors = scattering_weights(paths, scattering)
    weighed = tuple(reweighed_rows(r, factors) for r in rows)
    share = min(
        (effective_sample_fraction(r, w) for r, w in zip(rows, weighed, strict=True)), default=1.0
    )
    return weighed, share


def effective_sample_fraction(rows: EnergyRows, weighed: EnergyRows) -> float:
    """Return the effective sample size of a pair's rays after reweighing, as a share of before.

    Kish's effective number by the new weights over that by the old ones, in eighths of the rays by
    time, the least of them: weights degenerate with every hit, so that the late part suffers
    first. At most 1.

    Parameters
    ----------
    rows, weighed : EnergyRows
        The same rows with old and new weights.
    """
    rays = np.flatnonzero(rows.batch >= 0)
    n_slices = int(np.clip(len(rays) // _FEWEST_IN_SLICE, 1, _SLICES))
    shares = [
        effective_sample_size(weighed.weight_per_m2[part])
        / max(effective_sample_size(rows.weight_per_m2[part]), 1e-300)
        for part in np.array_split(rays, n_slices)
        if part.size
    ]
    return float(min((1.0, *shares)))
