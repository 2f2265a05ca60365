"""The walls of any room as mirrors for image sources: coplanar triangles merged to one each.

Their outlines and what may stand in a path's way are convex polygons of a plane, made about the
triangles of a wall or merged from them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roomfit.base.kernels import kernel
from roomfit.base.polygon import plane_axes
from roomfit.base.typing import FloatArray, IntArray
from roomfit.room.inside import Vector, corner, dot, row
from roomfit.room.mesh import area_vectors_m2, corners_m, is_double_sided
from roomfit.room.scene import Room

_OUTLINE_CORNERS = 12


def convex_outline(points_m: FloatArray, normal: FloatArray) -> FloatArray:
    """Return a convex polygon that contains points of a plane, counter-clockwise about its normal.

    The convex hull [1]_ where that has few corners, else a rectangle about it.

    References
    ----------
    .. [1] A. M. Andrew, "Another efficient algorithm for convex hulls in two dimensions",
           Information Processing Letters 9, 216-219 (1979).
    """
    axes = plane_axes(normal)
    flat = points_m @ axes.T
    order = np.lexsort((flat[:, 1], flat[:, 0]))
    hull = np.empty(2 * len(flat) + 1, dtype=np.int64)
    hull = hull[: _hull_of(flat, order, len(order), hull)]
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

    Shape (n_corners, 3). Shapes: `triangles_m` (n_triangles, 3 corners, 3), `normal` (3,).
    """
    points = np.asarray(triangles_m, dtype=np.float64).reshape(-1, 3)
    index, corners = _merge(points @ plane_axes(normal).T, tolerance_m)
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
    """Return whether a hull has few corners and covers no more than two pieces of such an area."""
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


# Share of the room's size within which a point lies in a plane: 20 micrometres in a hall, above
# the rounding of files in single precision and far below a wavelength.
FLATNESS = 1e-6
# Shares of the size that decide on paths must be far smaller: within a hundredth of a millimetre
# of some edge comes one in ten thousand of the paths with twenty hits.
_MARGIN = 1e-8
_EDGE = 1e-9


class Walls(NamedTuple):
    """Mirrors: planes seen from the air side, each with the triangles that lie in it.

    A double-sided sheet belongs to two walls of opposite normal.
    """

    tolerance_m: float  # Points so close to a plane lie in it, images so close together are one
    margin_m: float  # By which beams are too wide: above the rounding of images of high order
    edge_m: float  # So far beyond its edge a wall still reflects, and obstructs nothing
    normal: FloatArray  # (n_walls, 3), unit normal out of the air
    offset_m: FloatArray  # (n_walls,), ``normal . x`` of the plane's points
    first_piece: IntArray  # int64 (n_walls + 1,), where the pieces of each wall begin, and the end
    piece_m: FloatArray  # (n_pieces, 3 corners, 3), counter-clockwise about the wall's normal
    piece_triangle: IntArray  # int64 (n_pieces,), index of the triangle in the mesh
    first_corner: IntArray  # int64 (n_walls + 1,), where the corners of each outline begin
    outline_m: FloatArray  # (n_corners, 3), a convex polygon about each wall's pieces


class Blockers(NamedTuple):
    """Convex polygons that may stand between two points of the room, largest first.

    Walls with the whole room in front of them are left out: a convex room has no blockers.
    """

    wall: IntArray  # int64 (n_blockers,), in whose plane each lies: it hides no point of that wall
    first_corner: IntArray  # int64 (n_blockers + 1,)
    corner_m: FloatArray  # (n_corners, 3), counter-clockwise about the wall's normal


def mirrors_of(room: Room) -> tuple[Walls, Blockers]:
    """Return the mirrors of a room and what can hide one point of it from another.

    Coplanar triangles that face the same way are one mirror, of whatever materials they are.
    Triangles without area are left out.
    """
    mesh = room.mesh
    vectors = area_vectors_m2(mesh)
    areas = np.linalg.norm(vectors, axis=1)
    kept = np.flatnonzero(areas > 0.0)
    corners = corners_m(mesh)[kept]
    normals = vectors[kept] / areas[kept, None]
    sheet = is_double_sided(mesh)[kept]
    # the back of every sheet stands behind all fronts
    piece = np.concatenate([np.arange(len(kept)), np.flatnonzero(sheet)])
    turned = np.arange(len(piece)) >= len(kept)
    piece_m = np.where(turned[:, None, None], corners[piece][:, ::-1], corners[piece])
    piece_normal = np.where(turned[:, None], -normals[piece], normals[piece])
    size = float(np.linalg.norm(np.ptp(corners.reshape(-1, 3), axis=0)))
    largest_first = np.argsort(-areas[kept][piece], kind="stable")
    owner, normal, offset = _group(piece_m, piece_normal, largest_first, FLATNESS * size)
    order = np.argsort(owner, kind="stable")
    first = np.searchsorted(owner[order], np.arange(len(normal) + 1))
    outlines = [
        convex_outline(piece_m[order[a:b]].reshape(-1, 3), n)
        for a, b, n in zip(first[:-1], first[1:], normal, strict=True)
    ]
    blocking = [
        convex_pieces(piece_m[order[a:b]], n, FLATNESS * size)
        if (corners @ n).max() > o + FLATNESS * size
        else []
        for a, b, n, o in zip(first[:-1], first[1:], normal, offset, strict=True)
    ]
    walls = Walls(
        FLATNESS * size,
        _MARGIN * size,
        _EDGE * size,
        normal,
        offset,
        first.astype(np.int64),
        np.ascontiguousarray(piece_m[order]),
        kept[piece[order]].astype(np.int64),
        _starts(outlines),
        np.concatenate(outlines),
    )
    return walls, _as_blockers(blocking)


def _as_blockers(blocking: list[list[FloatArray]]) -> Blockers:
    pieces = [(w, piece) for w, own in enumerate(blocking) for piece in own]
    pieces.sort(key=lambda piece: -float(np.ptp(piece[1], axis=0).max()))
    return Blockers(
        np.array([w for w, _ in pieces], dtype=np.int64),
        _starts([p for _, p in pieces]),
        np.concatenate([np.zeros((0, 3)), *(p for _, p in pieces)]),
    )


def _starts(polygons: list[FloatArray]) -> IntArray:
    return np.concatenate(([0], np.cumsum([len(p) for p in polygons]))).astype(np.int64)


@kernel()
def _lies_in(
    piece_m: FloatArray, i: int, normal: Vector, offset_m: float, tolerance_m: float
) -> bool:
    farthest = 0.0
    for k in range(3):
        farthest = max(farthest, abs(dot(normal, corner(piece_m, i, k)) - offset_m))
    return farthest <= tolerance_m


@kernel()
def _group(
    piece_m: FloatArray, piece_normal: FloatArray, order: IntArray, tolerance_m: float
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Give each piece to the first wall whose plane contains its corners, or start a new one."""
    n = len(order)
    owner = np.full(n, -1, dtype=np.int64)
    normal = np.empty((n, 3))
    offset = np.empty(n)
    n_walls = 0
    for i in order:
        facing = row(piece_normal, i)
        for w in range(n_walls):
            if dot(row(normal, w), facing) > 0.5 and _lies_in(
                piece_m, i, row(normal, w), offset[w], tolerance_m
            ):
                owner[i] = w
                break
        if owner[i] < 0:
            owner[i] = n_walls
            normal[n_walls] = piece_normal[i]
            offset[n_walls] = np.dot(piece_normal[i], piece_m[i, 0])
            n_walls += 1
    return owner, normal[:n_walls].copy(), offset[:n_walls].copy()
