"""Traced paths weighed anew for another scattering coefficient."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roomfit.errors import InputError
from roomfit.materials.scattering import Scattering
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray


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
    factor = np.ones(len(paths))
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
        diffuse = paths.hits_diffuse[:, m].astype(np.float64)
        specular = paths.hits_specular[:, m].astype(np.float64)
        # s = 0 or 1 leaves paths without the lost kind of hit alone: 0 ** 0 is 1
        factor *= (s / s0) ** diffuse * ((1.0 - s) / (1.0 - s0)) ** specular
    return factor


def with_scattering(paths: Paths, scattering: Scattering) -> Paths:
    """Return the same paths with the weights, and the coefficients, of another scattering."""
    factor = scattering_weights(paths, scattering)
    return replace(
        paths,
        weight_per_m2=paths.weight_per_m2 * factor,
        sampling_scattering=scattering.coefficients.copy(),
    )


def effective_sample_size(factors: FloatArray) -> float:
    """Return how many paths of equal weight are worth as much, Kish's ``(sum f)**2 / sum f**2``.

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
