"""Corners that are meant to be one point are made one."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from roomfit.typing import FloatArray, IntArray

WELD_TOLERANCE_M = 1e-4
"""Corners nearer than 0.1 mm are one corner.

An absolute length, because what is welded is the rounding of drawing programs (six decimals of a
metre, three of a millimetre), which does not grow with the room, and because it must stay far
below anything that sound can notice (the wavelength at 16 kHz is 21 mm) or a room is drawn with.
"""


def weld(points_m: FloatArray, tolerance_m: float = WELD_TOLERANCE_M) -> IntArray:
    """Return for every point the index of the point that stands for it, shape (n_points,).

    Points nearer than the tolerance belong together, and so do chains of them. The earliest point
    stands for its group, so that coordinates of the file stay as they were written.

    Parameters
    ----------
    points_m : float array, shape (n_points, 3)
    """
    # equal points first: a file that repeats each corner for every face has thousands of pairs
    _, first, inverse = np.unique(points_m, axis=0, return_index=True, return_inverse=True)
    pairs = cKDTree(points_m[first]).query_pairs(tolerance_m, output_type="ndarray")
    n = len(first)
    links = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    n_groups, group = connected_components(links, directed=False)
    earliest = np.full(n_groups, len(points_m))
    np.minimum.at(earliest, group, first)
    return np.asarray(earliest[group[inverse.reshape(-1)]])
