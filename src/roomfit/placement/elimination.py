"""What one pair tells of the absorption when arrival times are unknown as well.

Information matrices of one band stand for absorptions and gain first, then for the geometry: what
sets arrival times, in multiples of its standard deviations beforehand, so that its prior is the
unit matrix. All bands of a pair share the geometry.
"""

from __future__ import annotations

import numpy as np

from roomfit.typing import BoolArray, FloatArray

# Information about an absorption that keeps an inverse alive where a band hears nothing of it.
_LEAST = 1e-6


def about_geometry(information: FloatArray, first: int) -> FloatArray:
    """Return what one band tells of the geometry when its own absorptions and gain are unknown."""
    own = information[:first, :first] + _LEAST * np.eye(first)
    cross = information[:first, first:]
    return np.asarray(information[first:, first:] - cross.T @ np.linalg.solve(own, cross))


def by_all_pairs(told: FloatArray, shared: BoolArray, n_others: int) -> FloatArray:
    """Return what a pair tells of the geometry, and n others as much of the part that all share."""
    own = ~shared
    cross = told[np.ix_(shared, own)]
    places = told[np.ix_(own, own)] + np.eye(int(own.sum()))
    out = told.copy()
    out[np.ix_(shared, shared)] += n_others * (
        told[np.ix_(shared, shared)] - cross @ np.linalg.solve(places, cross.T)
    )
    return np.asarray(out)


def without_geometry(
    found: list[FloatArray], first: int, shared: BoolArray, n_others: int
) -> FloatArray:
    """Integrate the geometry out of every band's information, under what all bands tell of it.

    Parameters
    ----------
    found : list of float arrays, shape (first + n_geometry, first + n_geometry)
    first : int
    shared : bool array, shape (n_geometry,)
        What all pairs have in common.
    n_others : int
        Other pairs that tell as much of the shared part.
    """
    told = [about_geometry(information, first) for information in found]
    n = told[0].shape[0]
    whole = by_all_pairs(sum(told, np.zeros((n, n))), shared, n_others)
    out = []
    for information, own in zip(found, told, strict=True):
        known = np.eye(n) + whole - own + information[first:, first:]
        cross = information[:first, first:]
        taken = cross @ np.linalg.solve(known, cross.T)
        out.append(information[:first, :first] - 0.5 * (taken + taken.T))
    return np.stack(out)
