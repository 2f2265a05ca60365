"""Which points a room encloses, and how far they are from its walls."""

from __future__ import annotations

import numpy as np

from roomfit.compiled import kernel
from roomfit.geometry.kernels import flight_m, row, square_distance_m2
from roomfit.geometry.mesh import Mesh, corners_m, is_double_sided
from roomfit.typing import BoolArray, FloatArray, IntArray

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

    Parameters
    ----------
    points_m : float array, shape (n_points, 3)
    """
    walls = corners_m(mesh)[~is_double_sided(mesh)]
    odd = _odd_crossings(walls, _rows(points_m), _DIRECTIONS)
    return np.asarray(2 * odd > _N_DIRECTIONS)


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

    Parameters
    ----------
    points_m : float array, shape (n_points, 3)

    Returns
    -------
    float array, shape (n_points,)
    """
    return nearest_triangles(mesh, points_m)[0]


def nearest_triangles(mesh: Mesh, points_m: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return distance in m and index of the triangle nearest to each point, each (n_points,)."""
    squares, triangle = _nearest(corners_m(mesh), _rows(points_m))
    return np.sqrt(squares), triangle


def _rows(points_m: FloatArray) -> FloatArray:
    return np.ascontiguousarray(points_m, dtype=np.float64).reshape(-1, 3)


@kernel()
def _odd_crossings(walls_m: FloatArray, points_m: FloatArray, directions: FloatArray) -> IntArray:
    """Count for each point the directions in which an odd number of walls is crossed."""
    odd = np.zeros(len(points_m), dtype=np.int64)
    for p in range(len(points_m)):
        for d in range(len(directions)):
            crossings = 0
            for i in range(len(walls_m)):
                if flight_m(walls_m, i, row(points_m, p), row(directions, d)) > 0.0:
                    crossings += 1
            odd[p] += crossings % 2
    return odd


@kernel()
def _nearest(corners_m: FloatArray, points_m: FloatArray) -> tuple[FloatArray, IntArray]:
    squares = np.full(len(points_m), np.inf)
    triangle = np.zeros(len(points_m), dtype=np.int64)
    for p in range(len(points_m)):
        for i in range(len(corners_m)):
            square = square_distance_m2(corners_m, i, row(points_m, p))
            if square < squares[p]:
                squares[p], triangle[p] = square, i
    return squares, triangle
