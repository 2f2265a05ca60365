"""What sets arrival times, as one block of unknowns: places, speed of sound, latency, wall delays.

The free numbers are multiples of the standard deviations told beforehand, so that the prior of the
lowest band is the unit normal law; a joint prior carries what a band has found to the next.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.objective.parameters import Block
from roomfit.response.coherent import Times
from roomfit.typing import BoolArray, FloatArray, IntArray

GEOMETRY = "geometry"


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """The unknowns of arrival times and where each observation finds its own.

    Attributes
    ----------
    labels : tuple of str
        "source LS1 x", ..., "speed of sound", "latency LS1", "delay felt", ...
    sd : float array, shape (n,)
        Standard deviations beforehand: m, 1 (of ln c), s and s; 0 says that an entry is known.
    fitted : bool array, shape (n,)
        Which entries may move; one that may not still blurs the coherence by its deviation.
    speed_m_s : float
        Speed of sound beforehand.
    columns : int array, shape (n_observations, 8 + n_materials)
        Entries of source (3), receiver (3), ln c, latency and delays of each observation.
    origin : float array, shape (n,), or None
        Free numbers of the places at which the paths were traced; None for the told ones.
    """

    labels: tuple[str, ...]
    sd: FloatArray
    fitted: BoolArray
    speed_m_s: float
    columns: IntArray
    origin: FloatArray | None = None


def geometry_block(geometry: Geometry) -> Block:
    """Return the block of free numbers, zero at the told geometry, with a unit normal prior."""
    n = len(geometry.labels)
    return Block(
        GEOMETRY,
        geometry.labels,
        "identity",
        np.zeros(n),
        geometry.fitted & (geometry.sd > 0.0),
        np.zeros(n),
        np.ones(n),
        np.full(n, -1e6),
        np.full(n, 1e6),
    )


def times_of(geometry: Geometry, values: FloatArray) -> Times:
    """Return places, speed, latency and delays of the free numbers, shape (n,)."""
    own = (geometry.sd * values)[geometry.columns]
    traced = 0.0 if geometry.origin is None else geometry.sd * geometry.origin
    places = (geometry.sd * values - traced)[geometry.columns[:, :6]]
    return Times(
        np.ascontiguousarray(places),
        float(geometry.speed_m_s * np.exp(own[0, 6])),
        np.ascontiguousarray(own[:, 7]),
        np.ascontiguousarray(own[0, 8:]),
    )


def local_roots(geometry: Geometry, covariance: FloatArray) -> FloatArray:
    """Return a root of each observation's covariance in physical units.

    Parameters
    ----------
    covariance : float array, shape (n, n)
        Of the free numbers.

    Returns
    -------
    float array, shape (n_observations, 8 + n_materials, n)
        Times its transpose: the covariance of the observation's own entries.
    """
    values, vectors = np.linalg.eigh(covariance)
    root = geometry.sd[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return np.ascontiguousarray(root[geometry.columns])


def whole_covariance(geometry: Geometry, fitted: FloatArray | None = None) -> FloatArray:
    """Return the covariance of all free numbers; those that are held keep their unit variance.

    Parameters
    ----------
    fitted : float array, shape (n_fitted, n_fitted), optional
        Covariance of the fitted entries; left out: the unit normal prior.
    """
    n = geometry.sd.size
    out = np.eye(n)
    if fitted is not None:
        free = np.flatnonzero(geometry.fitted & (geometry.sd > 0.0))
        out[np.ix_(free, free)] = fitted
    return out
