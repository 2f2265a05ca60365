"""Convex polygons of a plane: about the triangles of a wall, and merged from them."""

from __future__ import annotations

import math

import numpy as np

from roomfit.compiled import kernel
from roomfit.typing import FloatArray, IntArray

_OUTLINE_CORNERS = 12


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
    points = np.asarray(triangles_m, dtype=np.float64).reshape(-1, 3)
    index, corners = _merge(points @ _axes(normal).T, tolerance_m)
    return [points[own[:n]] for own, n in zip(index, corners, strict=True)]


@kernel()
def _merge(flat: FloatArray, tolerance_m: float) -> tuple[IntArray, IntArray]:
    """Merge triangles, three rows of `flat` each; return the rows that are corners of each piece.

    Only pieces whose surrounding rectangles touch are tried, each again after it has grown.
    """
    n = len(flat) // 3
    index = np.zeros((n, _OUTLINE_CORNERS), dtype=np.int64)
    corners = np.full(n, 3)
    box = np.empty((n, 4))
    area = np.empty(n)
    for i in range(n):
        for k in range(3):
            index[i, k] = 3 * i + k
        _measure(flat, index[i], 3, box[i], area, i)
    waiting = np.arange(n)[::-1].copy()
    top = n
    both = np.empty(2 * _OUTLINE_CORNERS, dtype=np.int64)
    hull = np.empty(2 * _OUTLINE_CORNERS + 1, dtype=np.int64)
    while top > 0:
        i = waiting[top - 1]
        top -= 1
        j = 0
        while j < n and corners[i] > 0:
            if j == i or corners[j] == 0 or not _touch(box[i], box[j], tolerance_m):
                j += 1
                continue
            for k in range(corners[i]):
                both[k] = index[i, k]
            for k in range(corners[j]):
                both[corners[i] + k] = index[j, k]
            m = _hull_of(flat, both, corners[i] + corners[j], hull)
            if not _fits(flat, hull, m, area[i] + area[j], tolerance_m):
                j += 1
                continue
            # the piece of the lower number stays, and looks about itself again
            kept, gone = min(i, j), max(i, j)
            index[kept, :m] = hull[:m]
            corners[kept], corners[gone] = m, 0
            _measure(flat, index[kept], m, box[kept], area, kept)
            i, j = kept, 0
    left = corners > 0
    return index[left], corners[left]


@kernel(allocates=False)
def _measure(
    flat: FloatArray, own: IntArray, n: int, box: FloatArray, area: FloatArray, i: int
) -> None:
    """Write the rectangle about a polygon (left, low, right, high) and its area."""
    box[0] = box[2] = flat[own[0], 0]
    box[1] = box[3] = flat[own[0], 1]
    for k in range(1, n):
        box[0] = min(box[0], flat[own[k], 0])
        box[1] = min(box[1], flat[own[k], 1])
        box[2] = max(box[2], flat[own[k], 0])
        box[3] = max(box[3], flat[own[k], 1])
    area[i] = _area_of(flat, own, n)


@kernel(allocates=False)
def _touch(a: FloatArray, b: FloatArray, tolerance_m: float) -> bool:
    return bool(
        a[0] <= b[2] + tolerance_m
        and b[0] <= a[2] + tolerance_m
        and a[1] <= b[3] + tolerance_m
        and b[1] <= a[3] + tolerance_m
    )


@kernel(allocates=False)
def _fits(flat: FloatArray, hull: IntArray, m: int, area: float, tolerance_m: float) -> bool:
    """Return whether a hull has few corners and holds no more than two pieces of such an area."""
    if m > _OUTLINE_CORNERS:
        return False
    around = 0.0
    for k in range(m):
        a, b = hull[k], hull[(k + 1) % m]
        around += math.hypot(flat[b, 0] - flat[a, 0], flat[b, 1] - flat[a, 1])
    return bool(_area_of(flat, hull, m) <= area + tolerance_m * around)


@kernel(allocates=False)
def _area_of(flat: FloatArray, own: IntArray, n: int) -> float:
    # about a corner of its own, so that the size of the room does not round it away
    x, y = flat[own[0], 0], flat[own[0], 1]
    twice = 0.0
    for k in range(1, n - 1):
        a, b = own[k], own[k + 1]
        twice += (flat[a, 0] - x) * (flat[b, 1] - y) - (flat[b, 0] - x) * (flat[a, 1] - y)
    return 0.5 * twice


@kernel(allocates=False)
def _hull_of(flat: FloatArray, own: IntArray, n: int, hull: IntArray) -> int:
    """Write the convex hull of a few points, sorting them; return its corners."""
    for k in range(1, n):
        point, at = own[k], k
        while at > 0 and _is_before(flat, point, own[at - 1]):
            own[at] = own[at - 1]
            at -= 1
        own[at] = point
    m = 0
    for k in range(n):
        m = _add(flat, hull, m, 0, own[k])
    below = m - 1
    for k in range(n - 2, -1, -1):
        m = _add(flat, hull, m, below, own[k])
    return m - 1


@kernel(allocates=False)
def _add(flat: FloatArray, hull: IntArray, m: int, least: int, point: int) -> int:
    """Append a point to a chain of left turns that starts at `least`; return its new length."""
    while m - least > 1:
        a, b = hull[m - 2], hull[m - 1]
        turn = (flat[b, 0] - flat[a, 0]) * (flat[point, 1] - flat[a, 1]) - (
            flat[b, 1] - flat[a, 1]
        ) * (flat[point, 0] - flat[a, 0])
        if turn > 0.0:
            break
        m -= 1
    hull[m] = point
    return m + 1


@kernel(allocates=False)
def _is_before(flat: FloatArray, a: int, b: int) -> bool:
    if flat[a, 0] != flat[b, 0]:
        return bool(flat[a, 0] < flat[b, 0])
    return bool(flat[a, 1] < flat[b, 1])


def _axes(normal: FloatArray) -> FloatArray:
    """Return two unit vectors (2, 3) that make a right-handed system with the normal."""
    axis = np.eye(3)[np.argmin(np.abs(normal))]
    u = np.cross(axis, normal) / np.linalg.norm(np.cross(axis, normal))
    return np.array([u, np.cross(normal, u)])


def _hull(flat: FloatArray) -> IntArray:
    order = np.lexsort((flat[:, 1], flat[:, 0]))
    hull = np.empty(2 * len(flat) + 1, dtype=np.int64)
    return hull[: _hull_of(flat, order, len(order), hull)]
