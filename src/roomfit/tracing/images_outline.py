"""Convex polygons of a plane: about the triangles of a wall, and merged from them."""

from __future__ import annotations

import numpy as np

from roomfit.typing import FloatArray, IntArray

_OUTLINE_CORNERS = 12
# Pieces of a wall beyond which merging would take longer than it saves.
_MERGED_PIECES = 48


def convex_outline(points_m: FloatArray, normal: FloatArray) -> FloatArray:
    """Return a convex polygon that holds points of a plane, counter-clockwise about its normal.

    The convex hull [1]_ where that has few corners, else a rectangle about it.

    References
    ----------
    .. [1] A. M. Andrew, "Another efficient algorithm for convex hulls in two dimensions",
           Information Processing Letters 9, 216-219 (1979).
    """
    axes = _axes(normal)
    flat = points_m @ axes.T
    hull = _hull(flat)
    if len(hull) <= _OUTLINE_CORNERS:
        return np.asarray(points_m[hull])
    (left, low), (right, high) = flat.min(axis=0), flat.max(axis=0)
    rectangle = np.array([[left, low], [right, low], [right, high], [left, high]])
    return np.asarray(rectangle @ axes + np.dot(points_m[0], normal) * normal)


def convex_pieces(
    triangles_m: FloatArray, normal: FloatArray, tolerance_m: float
) -> list[FloatArray]:
    """Return convex polygons that cover exactly what some triangles of a plane cover.

    Two pieces become one where their common hull has no more area than both, again and again.

    Parameters
    ----------
    triangles_m : float array, shape (n_triangles, 3 corners, 3)
        Counter-clockwise about the normal, not overlapping.
    normal : float array, shape (3,)
    tolerance_m : float
        How far a corner may lie off an edge.

    Returns
    -------
    list of float arrays, shape (n_corners, 3)
        Counter-clockwise about the normal; at most 12 corners where merged.
    """
    pieces = list(triangles_m)
    if len(pieces) > _MERGED_PIECES:
        return pieces
    axes = _axes(normal)
    areas = [_area(p @ axes.T) for p in pieces]
    merged = True
    while merged:
        merged = False
        for i in range(len(pieces)):
            for j in range(i + 1, len(pieces)):
                points = np.concatenate((pieces[i], pieces[j]))
                hull = points[_hull(points @ axes.T)]
                around = np.linalg.norm(hull - np.roll(hull, 1, axis=0), axis=1).sum()
                area = _area(hull @ axes.T)
                fits = area <= areas[i] + areas[j] + tolerance_m * around
                if fits and len(hull) <= _OUTLINE_CORNERS:
                    pieces[i], areas[i] = hull, area
                    del pieces[j], areas[j]
                    merged = True
                    break
            if merged:
                break
    return pieces


def _axes(normal: FloatArray) -> FloatArray:
    """Return two unit vectors (2, 3) that make a right-handed system with the normal."""
    axis = np.eye(3)[np.argmin(np.abs(normal))]
    u = np.cross(axis, normal) / np.linalg.norm(np.cross(axis, normal))
    return np.array([u, np.cross(normal, u)])


def _area(flat: FloatArray) -> float:
    x, y = flat.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def _hull(flat: FloatArray) -> list[int]:
    order = np.lexsort((flat[:, 1], flat[:, 0]))
    return _half_hull(flat, order)[:-1] + _half_hull(flat, order[::-1])[:-1]


def _half_hull(flat: FloatArray, order: IntArray) -> list[int]:
    chain: list[int] = []
    for i in order:
        while len(chain) > 1 and not _turns_left(flat[chain[-2]], flat[chain[-1]], flat[i]):
            chain.pop()
        chain.append(int(i))
    return chain


def _turns_left(a: FloatArray, b: FloatArray, c: FloatArray) -> bool:
    return bool((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0.0)
