"""The compiled loop over rays, walls and receivers.

Receivers are spheres that catch rays, sorted into a grid where there are many.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roomfit.base.kernels import kernel
from roomfit.base.typing import FloatArray, IntArray
from roomfit.room.inside import Vector
from roomfit.tracing.bvh import Walls, next_wall, wall_material
from roomfit.tracing.walls import after_wall, ray_key

# Up to so many spheres it is quicker to try each one than to walk through a grid (measured).
_TRY_EACH = 24
_CELLS_PER_SPHERE = 0.5
# Spheres are entered into the grid this much larger, so that rounding hides none from a cell.
_MARGIN_M = 1e-6


class Spheres(NamedTuple):
    """The receivers of one source, and a grid of boxes around them."""

    centre_m: FloatArray  # (n_spheres, 3)
    radius_m: FloatArray  # (n_spheres,)
    pair: IntArray  # int32 (n_spheres,), of the scene
    low_m: FloatArray  # (3,), lowest corner of the grid
    cell_m: FloatArray  # (3,), lengths of a cell
    cells: IntArray  # int64 (3,), along each axis; 1, 1, 1 where every sphere is tried in turn
    first: IntArray  # int64 (n_cells + 1,), spheres of cell c: ``members[first[c]:first[c + 1]]``
    members: IntArray  # int32, by cell, z fastest


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
    """Return where a flight comes nearest to the centre of a sphere and its chord within."""
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
def cell_at(x: float, low_m: float, cell_m: float, n: int) -> int:
    """Return the cell along one axis in which a coordinate lies, the nearest one if outside."""
    return int(min(max(math.floor((x - low_m) / cell_m), 0), n - 1))


@kernel(allocates=False)
def leaves_cell(o: float, d: float, cell: int, low_m: float, cell_m: float) -> float:
    """Return the distance at which a ray passes the wall of its cell across one axis, in metres."""
    if d == 0.0:
        return math.inf
    wall = cell + 1 if d > 0.0 else cell
    return (low_m + wall * cell_m - o) / d


CHUNK_RAYS = 256
ESCAPES_KEPT = 4


class Job(NamedTuple):
    """What all rays of one source have in common."""

    start_m: FloatArray  # (3,)
    scattering: FloatArray  # (n_materials,)
    max_length_m: float  # Nothing is recorded that arrives after more than this
    max_hits: int  # A ray ends at the wall hit of this number
    seed: int
    source: int


class Caught(NamedTuple):
    """Memory for what each chunk of rays records; the first axis of every array is the chunk."""

    found: IntArray  # int64 (n_chunks,), crossings, more than `capacity` where not all fitted
    sphere: IntArray  # int32 (n_chunks, capacity)
    ray: IntArray  # int64 (n_chunks, capacity)
    length_m: FloatArray  # (n_chunks, capacity), of the path
    chord_m: FloatArray  # (n_chunks, capacity)
    hits_specular: IntArray  # uint16 (n_chunks, capacity, n_materials)
    hits_diffuse: IntArray  # uint16 (n_chunks, capacity, n_materials)
    arrival: FloatArray  # float32 (n_chunks, capacity, 3)


class Tally(NamedTuple):
    """Further counts of each chunk; the first axis is the chunk."""

    hits: IntArray  # int64 (n_chunks,)
    escapes: IntArray  # int64 (n_chunks,)
    free_paths: IntArray  # int64 (n_chunks,)
    sum_m: FloatArray  # (n_chunks,), of the free paths
    sum_m2: FloatArray  # (n_chunks,), of their squares
    escape_from_m: FloatArray  # (n_chunks, ESCAPES_KEPT, 3), start of the last flight of the first


@kernel(allocates=False)
def trace_chunks(
    first_chunk: int,
    last_chunk: int,
    walls: Walls,
    spheres: Spheres,
    job: Job,
    directions: FloatArray,
    first_ray: int,
    met: IntArray,
    caught: Caught,
    tally: Tally,
) -> None:
    """Trace consecutive rays, each chunk into its own part of `caught` and `tally`; for threads.

    Shapes: `directions` (n_rays, 3), `met` (2, n_chunks, n_materials).
    """
    for chunk in range(first_chunk, last_chunk):
        specular, diffuse = met[0, chunk], met[1, chunk]
        for i in range(chunk * CHUNK_RAYS, min((chunk + 1) * CHUNK_RAYS, len(directions))):
            specular[:] = 0
            diffuse[:] = 0
            d = (directions[i, 0], directions[i, 1], directions[i, 2])
            hits, free_paths, sum_m, sum_m2 = _trace_ray(
                walls, spheres, job, d, first_ray + i, chunk, specular, diffuse, caught, tally
            )
            tally.hits[chunk] += hits
            tally.free_paths[chunk] += free_paths
            tally.sum_m[chunk] += sum_m
            tally.sum_m2[chunk] += sum_m2


@kernel(allocates=False)
def _trace_ray(
    walls: Walls,
    spheres: Spheres,
    job: Job,
    d: Vector,
    ray: int,
    chunk: int,
    specular: IntArray,
    diffuse: IntArray,
    caught: Caught,
    tally: Tally,
) -> tuple[int, int, float, float]:
    """Follow one ray to its end; return its hits, free paths, their sum and sum of squares."""
    key = ray_key(job.seed, job.source, ray)
    try_each = len(spheres.first) == 2
    o = (job.start_m[0], job.start_m[1], job.start_m[2])
    travelled, hit, sum_m, sum_m2 = 0.0, 0, 0.0, 0.0
    last = -1
    while True:
        flight, wall = next_wall(walls, o, d, last)
        if try_each:
            for k in range(len(spheres.radius_m)):
                nearest, length = chord(spheres, k, o, d, flight)
                if length > 0.0 and travelled + nearest <= job.max_length_m:
                    arrived = travelled + nearest
                    _record(caught, chunk, k, ray, arrived, length, specular, diffuse, d)
        else:
            _catch_in_grid(
                spheres, job, o, d, flight, travelled, ray, chunk, specular, diffuse, caught
            )
        if wall < 0:
            note_escape(o, chunk, tally)
            return hit, max(hit - 1, 0), sum_m, sum_m2
        if hit > 0:  # the way from the source to the first wall is no free path
            sum_m += flight
            sum_m2 += flight * flight
        travelled += flight
        if travelled > job.max_length_m:
            return hit, hit, sum_m, sum_m2
        hit += 1
        if hit == job.max_hits:
            return hit, hit - 1, sum_m, sum_m2
        o = (o[0] + flight * d[0], o[1] + flight * d[1], o[2] + flight * d[2])
        material = wall_material(walls, wall, o)
        last = wall
        normal = (walls.normal[wall, 0], walls.normal[wall, 1], walls.normal[wall, 2])
        d, is_diffuse = after_wall(d, normal, job.scattering[material], key, hit - 1)
        if is_diffuse:
            diffuse[material] += np.uint16(1)
        else:
            specular[material] += np.uint16(1)


@kernel(allocates=False, inlined=True)
def _catch_in_grid(
    spheres: Spheres,
    job: Job,
    o: Vector,
    d: Vector,
    flight: float,
    travelled: float,
    ray: int,
    chunk: int,
    specular: IntArray,
    diffuse: IntArray,
    caught: Caught,
) -> None:
    """Walk through the cells along a flight and record every sphere that it crosses.

    A sphere in several cells is counted in the one in which the flight comes nearest to its
    centre; the cells' stretches of the flight meet without gap or overlap.
    """
    start, end = enters_grid(spheres, o, d, flight)
    if start > end:
        return
    low, size, cells = spheres.low_m, spheres.cell_m, spheres.cells
    x = cell_at(o[0] + start * d[0], low[0], size[0], cells[0])
    y = cell_at(o[1] + start * d[1], low[1], size[1], cells[1])
    z = cell_at(o[2] + start * d[2], low[2], size[2], cells[2])
    to_x = leaves_cell(o[0], d[0], x, low[0], size[0])
    to_y = leaves_cell(o[1], d[1], y, low[1], size[1])
    to_z = leaves_cell(o[2], d[2], z, low[2], size[2])
    entered = -np.inf
    while True:
        left = min(to_x, to_y, to_z)
        cell = (x * cells[1] + y) * cells[2] + z
        for i in range(spheres.first[cell], spheres.first[cell + 1]):
            k = int(np.int64(spheres.members[i]))
            nearest, length = chord(spheres, k, o, d, flight)
            if length > 0.0 and entered <= nearest < left:
                arrived = travelled + nearest
                if arrived <= job.max_length_m:
                    _record(caught, chunk, k, ray, arrived, length, specular, diffuse, d)
        if left > end:
            return
        entered = left
        if left == to_x:
            x += 1 if d[0] > 0.0 else -1
            if x < 0 or x == cells[0]:
                return
            to_x = leaves_cell(o[0], d[0], x, low[0], size[0])
        elif left == to_y:
            y += 1 if d[1] > 0.0 else -1
            if y < 0 or y == cells[1]:
                return
            to_y = leaves_cell(o[1], d[1], y, low[1], size[1])
        else:
            z += 1 if d[2] > 0.0 else -1
            if z < 0 or z == cells[2]:
                return
            to_z = leaves_cell(o[2], d[2], z, low[2], size[2])


@kernel(allocates=False)
def _record(
    caught: Caught,
    chunk: int,
    sphere: int,
    ray: int,
    length_m: float,
    chord_m: float,
    specular: IntArray,
    diffuse: IntArray,
    d: Vector,
) -> None:
    """Record a crossing, or only count it where the memory is full."""
    i = caught.found[chunk]
    caught.found[chunk] += 1
    if i >= caught.ray.shape[1]:
        return
    caught.sphere[chunk, i] = sphere
    caught.ray[chunk, i] = ray
    caught.length_m[chunk, i] = length_m
    caught.chord_m[chunk, i] = chord_m
    for m in range(len(specular)):
        caught.hits_specular[chunk, i, m] = specular[m]
        caught.hits_diffuse[chunk, i, m] = diffuse[m]
    for axis in range(3):
        caught.arrival[chunk, i, axis] = d[axis]


@kernel(allocates=False)
def note_escape(o: Vector, chunk: int, tally: Tally) -> None:
    """Count a ray that met no wall; keep where the first ones came from."""
    n = tally.escapes[chunk]
    tally.escapes[chunk] += 1
    if n < ESCAPES_KEPT:
        for axis in range(3):
            tally.escape_from_m[chunk, n, axis] = o[axis]
