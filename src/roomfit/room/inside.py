"""Which points a room encloses, and how far they are from its walls.

One ray or one point against one triangle, in plain float64: slower and simpler than the tracer's
kernels and independent of them, because it checks rooms. Triangles count on both sides, whatever
their orientation.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from roomfit.base.kernels import kernel
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.room.mesh import Mesh, box_of, corners_m, is_double_sided

Vector: TypeAlias = tuple[float, float, float]

MISSED = -1.0
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
def triangle_at(corners_m: FloatArray, i: int) -> tuple[Vector, Vector, Vector]:
    """Return the three corners of triangle i of an (n, 3, 3) array."""
    t = corners_m[i]
    return (
        (t[0, 0], t[0, 1], t[0, 2]),
        (t[1, 0], t[1, 1], t[1, 2]),
        (t[2, 0], t[2, 1], t[2, 2]),
    )


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


@kernel(allocates=False)
def flight_m(corners_m: FloatArray, i: int, start: Vector, direction: Vector) -> float:
    """Return the distance along a unit direction to triangle i, or a negative one for a miss [1]_.

    References
    ----------
    .. [1] T. Moller, B. Trumbore, "Fast, minimum storage ray/triangle intersection", J. Graphics
           Tools 2, 21-28 (1997).
    """
    a, b, c = triangle_at(corners_m, i)
    ab, ac = minus(b, a), minus(c, a)
    h = cross(direction, ac)
    determinant = dot(ab, h)
    if determinant == 0.0:
        return MISSED
    s = minus(start, a)
    u = dot(s, h) / determinant
    if u < 0.0 or u > 1.0:
        return MISSED
    k = cross(s, ab)
    v = dot(direction, k) / determinant
    if v < 0.0 or u + v > 1.0:
        return MISSED
    return dot(ac, k) / determinant


# In general position: no drawn wall is parallel to one of them, and an edge is met by at most a
# few, which the others outvote.
_N_DIRECTIONS = 15
_DIRECTIONS = np.random.default_rng(19).normal(size=(_N_DIRECTIONS, 3))
_DIRECTIONS /= np.linalg.norm(_DIRECTIONS, axis=1)[:, None]


def is_inside(mesh: Mesh, points_m: FloatArray) -> BoolArray:
    """Return for each point whether the room encloses it, shape (n_points,).

    A ray from a point inside crosses the walls an odd number of times. The majority of 15
    directions decides, so that edges, corners and small leaks do no harm. Sheets in the air do
    not count, and orientation does not matter.

    `points_m` has the shape (n_points, 3).
    """
    walls = corners_m(mesh)[~is_double_sided(mesh)]
    points = _rows(points_m)
    box = box_of(mesh)
    if box is not None:  # the kernels take seconds to compile
        own = (points - box.origin_m) @ box.axes.T
        return np.asarray(np.all((own > 0.0) & (own < box.lengths_m), axis=1))
    odd = np.zeros(len(points), dtype=np.int64)
    for direction in _DIRECTIONS:
        first, kept, cell = _shafts(walls, points, direction)
        odd += _odd_crossings(walls, points, cell, first, kept, direction)
    return np.asarray(2 * odd > _N_DIRECTIONS)


def is_in_sight(mesh: Mesh, from_m: FloatArray, to_m: FloatArray) -> bool:
    """Return whether no wall stands between two points of a room.

    Shapes: `from_m, to_m` (3,). An edge that is met counts as a wall; see `flight_m`.
    """
    if box_of(mesh) is not None:
        return True
    a, b, c = np.moveaxis(corners_m(mesh), 1, 0)
    ab, ac, s, way = b - a, c - a, from_m - a, to_m - from_m
    h, k = np.cross(way, ac), np.cross(s, ab)
    determinant = np.sum(ab * h, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):  # walls along the way
        u, v, t = (np.sum(x, axis=-1) / determinant for x in (s * h, way * k, ac * k))
    struck = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0) & (t < 1.0)
    return not np.any(struck & (determinant != 0.0))


def interior_points(mesh: Mesh, n: int, rng: np.random.Generator) -> FloatArray:
    """Return up to n random points inside the room, shape (n_found, 3).

    Fewer are found where less than a fiftieth of the bounding box is inside.
    """
    low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
    found = np.zeros((0, 3))
    for _ in range(10):
        tries = rng.uniform(low, high, (5 * n, 3))
        found = np.concatenate([found, tries[is_inside(mesh, tries)]])
        if len(found) >= n:
            break
    return found[:n]


def distance_to_walls_m(mesh: Mesh, points_m: FloatArray) -> FloatArray:
    """Return the distance of each point from the nearest triangle, sheets included.

    `points_m` has the shape (n_points, 3). The result has the shape (n_points,).
    """
    return nearest_triangles(mesh, points_m)[0]


def nearest_triangles(mesh: Mesh, points_m: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return distance in m and index of the triangle nearest to each point, each (n_points,)."""
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


def _shafts(
    walls_m: FloatArray, points_m: FloatArray, direction: FloatArray
) -> tuple[IntArray, IntArray, IntArray]:
    """Cut space into square shafts along a direction, about as many as there are walls.

    Returns
    -------
    first : int array, shape (n_shafts + 1,)
    walls : int array, shape (n_entries,)
        Shaft k is touched by ``walls[first[k]:first[k + 1]]`` at most.
    shaft : int array, shape (n_points,)
        The shaft of each point, -1 outside of all walls.
    """
    across = np.linalg.svd(direction[None])[2][1:]
    corners = walls_m @ across.T
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    side = int(np.clip(np.sqrt(len(walls_m)), 1, 512))
    scale = side / np.maximum(high - low, 1e-9)
    # a margin of a thousandth of a shaft stays clear of all rounding
    from_cell = np.clip(np.floor((corners.min(axis=1) - low) * scale - 1e-3), 0, side - 1)
    to_cell = np.clip(np.floor((corners.max(axis=1) - low) * scale + 1e-3), 0, side - 1)
    first, walls = _filled(from_cell.astype(np.int64), to_cell.astype(np.int64), side)
    place = np.floor((points_m @ across.T - low) * scale).astype(np.int64)
    # on the outermost edge itself a point may round to the next shaft
    beyond = np.any((place < -1) | (place > side), axis=1)
    place = np.clip(place, 0, side - 1)
    return first, walls, np.where(beyond, -1, place[:, 0] * side + place[:, 1])


@kernel()
def _filled(from_cell: IntArray, to_cell: IntArray, side: int) -> tuple[IntArray, IntArray]:
    """Sort walls into the cells of a grid that their bounding rectangles touch."""
    first = np.zeros(side * side + 1, dtype=np.int64)
    for i in range(len(from_cell)):
        for x in range(from_cell[i, 0], to_cell[i, 0] + 1):
            for y in range(from_cell[i, 1], to_cell[i, 1] + 1):
                first[x * side + y + 1] += 1
    for k in range(side * side):
        first[k + 1] += first[k]
    walls = np.zeros(first[-1], dtype=np.int64)
    filled = first[:-1].copy()
    for i in range(len(from_cell)):
        for x in range(from_cell[i, 0], to_cell[i, 0] + 1):
            for y in range(from_cell[i, 1], to_cell[i, 1] + 1):
                walls[filled[x * side + y]] = i
                filled[x * side + y] += 1
    return first, walls


@kernel()
def _odd_crossings(
    walls_m: FloatArray,
    points_m: FloatArray,
    shaft: IntArray,
    first: IntArray,
    walls: IntArray,
    direction: FloatArray,
) -> IntArray:
    """Return 1 for each point from which an odd number of walls lies in the direction, else 0."""
    odd = np.zeros(len(points_m), dtype=np.int64)
    ahead = (direction[0], direction[1], direction[2])
    for p in range(len(points_m)):
        if shaft[p] < 0:
            continue
        crossings = 0
        for k in range(first[shaft[p]], first[shaft[p] + 1]):
            if flight_m(walls_m, walls[k], row(points_m, p), ahead) > 0.0:
                crossings += 1
        odd[p] = crossings % 2
    return odd
