"""Which points a room encloses, and how far they are from its walls.

One point against one triangle, in plain float64: slower and simpler than the tracer's kernels and
independent of them, because it checks rooms.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from roomfit.base.kernels import kernel
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.room.mesh import Mesh, corners_m, is_double_sided

Vector: TypeAlias = tuple[float, float, float]

_PAIRS_AT_ONCE = 100_000


@kernel(allocates=False)
def minus(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel(allocates=False)
def dot(a: Vector, b: Vector) -> float:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel(allocates=False)
def cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel(allocates=False)
def along(start: Vector, direction: Vector, distance: float) -> Vector:
    """Return start + distance * direction."""
    return (
        start[0] + distance * direction[0],
        start[1] + distance * direction[1],
        start[2] + distance * direction[2],
    )


@kernel(allocates=False)
def row(table: FloatArray, i: int) -> Vector:
    """Return row i of an (n, 3) array."""
    return table[i, 0], table[i, 1], table[i, 2]


@kernel(allocates=False, inlined=True)
def put(table: FloatArray, i: int, x: Vector) -> None:
    """Write a vector to row i of an (n, 3) array."""
    table[i, 0], table[i, 1], table[i, 2] = x


@kernel(allocates=False)
def corner(corners_m: FloatArray, i: int, k: int) -> Vector:
    """Return corner k of triangle i of an (n, 3, 3) array."""
    return corners_m[i, k, 0], corners_m[i, k, 1], corners_m[i, k, 2]


@kernel(allocates=False)
def deepest(
    corners_m: FloatArray, first: int, stop: int, normal: Vector, x: Vector, least_m: float
) -> int:
    """Return in which of some triangles of a plane a point of it lies deepest, or -1.

    At least `least_m` from all sides, negative outside, of triangles counter-clockwise about the
    normal, from `first` to before `stop` of an (n, 3, 3) array.
    """
    found = -1
    for i in range(first, stop):
        depth = math.inf
        for k in range(3):
            a, b = corner(corners_m, i, k), corner(corners_m, i, (k + 1) % 3)
            side = minus(b, a)
            area = dot(cross(side, minus(x, a)), normal)
            depth = min(depth, area / math.sqrt(dot(side, side)))
            if depth <= least_m:
                break
        if depth > least_m:
            least_m, found = depth, i
    return found


def is_inside(mesh: Mesh, points_m: FloatArray) -> BoolArray:
    """Return for each point whether the room encloses it, shape (n_points,).

    From a point inside the walls fill the whole solid angle, from one outside none of it: fronts
    and backs cancel [1]_. Small leaks do no harm, and sheets in the air do not count.

    `points_m` has the shape (n_points, 3).

    References
    ----------
    .. [1] A. van Oosterom, J. Strackee, "The solid angle of a plane triangle", IEEE Trans. Biomed.
           Eng. 30, 125-126 (1983).
    """
    walls = corners_m(mesh)[~is_double_sided(mesh)]
    points = _rows(points_m)
    turns = np.zeros(len(points))
    step = max(1, _PAIRS_AT_ONCE // max(len(walls), 1))
    for k in range(0, len(points), step):
        a, b, c = np.moveaxis(walls[None] - points[k : k + step, None, None], 2, 0)
        na, nb, nc = (np.linalg.norm(x, axis=2) for x in (a, b, c))
        ab, bc, ca = (np.sum(x * y, axis=2) for x, y in ((a, b), (b, c), (c, a)))
        spat = np.sum(a * np.cross(b, c), axis=2)
        turns[k : k + step] = np.arctan2(spat, na * nb * nc + ab * nc + bc * na + ca * nb).sum(1)
    return np.asarray(np.abs(turns) > np.pi)


def is_in_sight(mesh: Mesh, from_m: FloatArray, to_m: FloatArray) -> bool:
    """Return whether no wall stands between two points of a room.

    Shapes: `from_m, to_m` (3,). An edge that is met counts as a wall.
    """
    return bool(to_walls_m(corners_m(mesh), from_m[None], to_m - from_m)[0] >= 1.0)


def to_walls_m(walls_m: FloatArray, starts_m: FloatArray, direction: FloatArray) -> FloatArray:
    """Return from points the way to the nearest triangle, in units of a vector, (n_points,)."""
    a = walls_m[:, 0]
    ab, ac = walls_m[:, 1] - a, walls_m[:, 2] - a
    h = np.cross(direction, ac)
    determinant = np.sum(ab * h, axis=1)
    met = np.abs(determinant) > 1e-12
    a, ab, ac, h, determinant = (x[met] for x in (a, ab, ac, h, determinant))
    s = starts_m[:, None] - a
    k = np.cross(s, ab)
    u = np.sum(s * h, axis=2) / determinant
    v = k @ direction / determinant
    t = np.sum(k * ac, axis=2) / determinant
    hit = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0)
    return np.asarray(np.where(hit, t, np.inf).min(axis=1, initial=np.inf))


def nearest_triangles(mesh: Mesh, points_m: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return distance in m and index of the triangle nearest to each point, each (n_points,).

    Sheets are included. `points_m` has the shape (n_points, 3).
    """
    corners, points = corners_m(mesh), _rows(points_m)
    squares, triangle = np.zeros(len(points)), np.zeros(len(points), dtype=np.int64)
    step = max(1, _PAIRS_AT_ONCE // len(corners))
    for k in range(0, len(points), step):
        every = _squares_m2(corners, points[k : k + step])
        triangle[k : k + step] = np.argmin(every, axis=1)
        squares[k : k + step] = every.min(axis=1)
    return np.sqrt(squares), triangle


def _squares_m2(corners_m: FloatArray, points_m: FloatArray) -> FloatArray:
    """Return the squared distance of every point from every triangle, (n_points, n_triangles).

    The foot of the perpendicular lies within the triangle, or else a side is nearest.
    """
    sides = np.roll(corners_m, -1, axis=1) - corners_m
    normal = np.cross(sides[:, 0], sides[:, 1])
    to = points_m[:, None, None] - corners_m
    squares, square = np.sum(sides**2, axis=2), np.sum(normal**2, axis=1)
    share = np.clip(np.sum(to * sides, axis=3) / np.where(squares > 0.0, squares, 1.0), 0.0, 1.0)
    to_side = np.sum((to - share[..., None] * sides) ** 2, axis=3).min(axis=2)
    is_above = np.all(np.sum(to * np.cross(normal[:, None], sides), axis=3) >= 0.0, axis=2)
    height = np.sum(to[:, :, 0] * normal, axis=2) ** 2 / np.where(square > 0.0, square, 1.0)
    return np.asarray(np.where(is_above & (square > 0.0), height, to_side))


def _rows(points_m: FloatArray) -> FloatArray:
    return np.ascontiguousarray(points_m, dtype=np.float64).reshape(-1, 3)
