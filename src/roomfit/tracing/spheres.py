"""Receivers as spheres that catch rays, sorted into a grid where there are many."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roomfit.compiled import kernel
from roomfit.tracing.bounce import Vector
from roomfit.typing import FloatArray, IntArray

# Up to so many spheres it is quicker to try each one than to walk through a grid (measured).
_TRY_EACH = 24
_CELLS_PER_SPHERE = 0.5
# Spheres are entered into the grid this much larger, so that rounding hides none from a cell.
_MARGIN_M = 1e-6


class Spheres(NamedTuple):
    """The receivers of one source, and a grid of boxes around them.

    Attributes
    ----------
    centre_m : float array, shape (n_spheres, 3)
    radius_m : float array, shape (n_spheres,)
    pair : int32 array, shape (n_spheres,)
        Pair of the scene that each stands for.
    low_m, cell_m : float arrays, shape (3,)
        Lowest corner of the grid, and lengths of a cell.
    cells : int64 array, shape (3,)
        Number of cells along each axis; 1, 1, 1 where every sphere is tried in turn.
    first : int64 array, shape (n_cells + 1,)
        Cell c holds the spheres ``members[first[c]:first[c + 1]]``; z runs fastest.
    members : int32 array
    """

    centre_m: FloatArray
    radius_m: FloatArray
    pair: IntArray
    low_m: FloatArray
    cell_m: FloatArray
    cells: IntArray
    first: IntArray
    members: IntArray


def spheres(centre_m: FloatArray, radius_m: FloatArray, pair: IntArray) -> Spheres:
    """Return the spheres with a grid of about one cell for every two, if they are many."""
    n = len(radius_m)
    reach = radius_m[:, None] + _MARGIN_M
    low, high = (centre_m - reach).min(axis=0), (centre_m + reach).max(axis=0)
    cells = np.ones(3, dtype=np.int64)
    if n > _TRY_EACH:
        edge = np.cbrt(np.prod(high - low) / (_CELLS_PER_SPHERE * n))
        cells = np.clip(np.ceil((high - low) / edge), 1, 1024).astype(np.int64)
    cell = (high - low) / cells
    lowest = np.floor((centre_m - reach - low) / cell).clip(0, cells - 1).astype(np.int64)
    highest = np.floor((centre_m + reach - low) / cell).clip(0, cells - 1).astype(np.int64)
    lists: list[list[int]] = [[] for _ in range(int(np.prod(cells)))]
    for k in range(n):
        spans = [range(a, b + 1) for a, b in zip(lowest[k], highest[k], strict=True)]
        for x in spans[0]:
            for y in spans[1]:
                for z in spans[2]:
                    lists[int((x * cells[1] + y) * cells[2] + z)].append(k)
    first = np.concatenate(([0], np.cumsum([len(members) for members in lists])))
    members = np.array([k for members in lists for k in members], dtype=np.int32)
    return Spheres(
        centre_m, radius_m, pair.astype(np.int32), low, cell, cells, first.astype(np.int64), members
    )


@kernel(allocates=False)
def chord(spheres: Spheres, k: int, o: Vector, d: Vector, flight_m: float) -> tuple[float, float]:
    """Return where a flight comes nearest to the centre of a sphere and its chord within.

    Parameters
    ----------
    o, d : vector
        Start and unit direction.
    flight_m : float
        Length of the flight.

    Returns
    -------
    tuple of float
        Distance from the start to the point of the flight nearest to the centre, and the length
        inside the sphere, both in metres; the length is 0 for a miss. Both ends of the flight may
        lie inside.
    """
    x = spheres.centre_m[k, 0] - o[0]
    y = spheres.centre_m[k, 1] - o[1]
    z = spheres.centre_m[k, 2] - o[2]
    nearest = x * d[0] + y * d[1] + z * d[2]
    radius = spheres.radius_m[k]
    square = radius * radius - (x * x + y * y + z * z - nearest * nearest)
    if square <= 0.0:
        return 0.0, 0.0
    half = math.sqrt(square)
    start, end = max(nearest - half, 0.0), min(nearest + half, flight_m)
    return min(max(nearest, 0.0), flight_m), max(end - start, 0.0)


@kernel(allocates=False)
def enters_grid(spheres: Spheres, o: Vector, d: Vector, flight_m: float) -> tuple[float, float]:
    """Return where a flight enters and leaves the grid, in metres; swapped for a miss."""
    start, end = 0.0, flight_m
    for axis in range(3):
        low = spheres.low_m[axis]
        high = low + spheres.cell_m[axis] * spheres.cells[axis]
        if d[axis] == 0.0:
            if o[axis] < low or o[axis] > high:
                return 1.0, 0.0
            continue
        a, b = (low - o[axis]) / d[axis], (high - o[axis]) / d[axis]
        start, end = max(start, min(a, b)), min(end, max(a, b))
    return start, end


@kernel(allocates=False)
def cell_at(spheres: Spheres, x: float, axis: int) -> int:
    """Return the cell along one axis in which a coordinate lies, the nearest one if outside."""
    cell = math.floor((x - spheres.low_m[axis]) / spheres.cell_m[axis])
    return int(min(max(cell, 0), spheres.cells[axis] - 1))


@kernel(allocates=False)
def leaves_cell(spheres: Spheres, cell: int, axis: int, o: float, d: float) -> float:
    """Return the distance at which a ray passes the wall of its cell across one axis, in metres."""
    if d == 0.0:
        return math.inf
    wall = cell + 1 if d > 0.0 else cell
    return float((spheres.low_m[axis] + wall * spheres.cell_m[axis] - o) / d)
