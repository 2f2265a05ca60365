"""Rays from every source, caught by spheres around the receivers.

The same seed gives the same bits for any number of threads. A wall or the source may cut a sphere:
what counts is the part of the chord inside the room. Rays that leave through a leak are counted and
dropped. The method is that of M. Vorlaender, "Auralization", Springer 2008, section 11.3.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from roomfit.base.air import speed_of_sound_m_s
from roomfit.base.arguments import float_array
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.kernels import in_threads, kernel
from roomfit.base.typing import BoolArray, FloatArray, IntArray, Progress
from roomfit.materials.priors import Scattering, coefficients_in_order
from roomfit.room.inside import Vector
from roomfit.room.mesh import surface_area_m2, volume_m3
from roomfit.room.scene import Room, Scene
from roomfit.tracing.bvh import WAITING, Walls, next_wall, wall_material, walls_of
from roomfit.tracing.paths import Paths, TraceSettings, path_columns
from roomfit.tracing.walls import after_wall, ray_key

_GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))


def start_directions(settings: TraceSettings, source: int) -> FloatArray:
    """Return the unit vectors in which the rays of one source start, shape (n_rays, 3).

    Ray i belongs to batch ``i % n_batches``. Sources differ in their Sobol points; the Fibonacci
    spiral is the same for all.
    """
    if settings.directions == "fibonacci":
        return fibonacci_directions(settings.n_rays)
    return sobol_directions(settings.n_rays, settings.n_batches, (settings.seed, source))


def fibonacci_directions(n_rays: int) -> FloatArray:
    """Return the Fibonacci sphere: one spiral of points of equal area, shape (n_rays, 3).

    Point i has ``z = 1 - (2 i + 1) / n`` and azimuth ``i`` times the golden angle.
    """
    i = np.arange(n_rays)
    return _on_sphere(1.0 - (2.0 * i + 1.0) / max(n_rays, 1), i * _GOLDEN_ANGLE)


def sobol_directions(n_rays: int, n_batches: int, seed: tuple[int, ...]) -> FloatArray:
    """Return scrambled Sobol points on the sphere, another scramble for each batch.

    Each point alone is uniform on the sphere, so each batch gives an unbiased estimate, and
    batches are independent, so their spread measures the error. A batch takes the first points of
    its sequence: any number will do, but one whose number of rays is a power of two covers the
    sphere most evenly.

    Shape (n_rays, 3).
    """
    directions = np.empty((n_rays, 3))
    for batch in range(min(n_batches, n_rays)):
        rng = np.random.default_rng((*seed, batch)).spawn(1)[0]
        own = directions[batch::n_batches]
        u = _sobol_points(len(own), rng)
        own[:] = _on_sphere(1.0 - 2.0 * u[:, 0], 2.0 * np.pi * u[:, 1])
    return directions


def _sobol_points(n: int, rng: np.random.Generator, bits: int = 30) -> FloatArray:
    """Return scrambled Sobol points of the unit square, shape (n, 2).

    The bits of ``scipy.stats.qmc.Sobol(2, rng=parent)``, `rng` its child: directions of Joe and Kuo
    (2008), random lower triangles and a shift of Matousek (1998). Loading scipy.stats takes
    longer than tracing a small room.
    """
    powers = 1 << np.arange(bits)
    vectors = np.tile(powers[::-1], (2, 1))
    for k in range(1, bits):
        vectors[1, k] = vectors[1, k - 1] ^ (vectors[1, k - 1] >> 1)
    points = rng.integers(0, 2, (2, bits), np.uint32) @ powers[:, None]
    lower = np.tril(rng.integers(0, 2, (2, bits, bits), np.uint32), -1) + np.eye(bits, dtype=int)
    scrambled = powers[::-1] @ (lower @ (vectors[:, None] // powers[::-1, None] % 2) % 2)
    for k in range(max(n - 1, 0).bit_length()):  # of Gray's code, each half mirrors the one before
        points = np.concatenate((points, points[:, ::-1] ^ scrambled[:, k, None]), axis=1)
    return np.asarray(points[:, :n].T * 2.0**-bits)


def _on_sphere(z: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Return unit vectors; equal areas in (z, azimuth) are equal areas on the sphere."""
    across = np.sqrt(np.maximum(0.0, 1.0 - z * z))
    return np.stack((across * np.cos(azimuth), across * np.sin(azimuth), z), axis=1)


_CHUNK_RAYS = 256
# Starts of last flights of escaped rays: kept of each chunk, and reported of all.
ESCAPES_KEPT, _ESCAPES_REPORTED = 4, 8


class Job(NamedTuple):
    """What all rays of one source have in common."""

    start_m: FloatArray  # (3,)
    scattering: FloatArray  # (n_materials,)
    max_length_m: float  # Nothing is recorded that arrives after more than this
    max_hits: int  # A ray ends at the wall hit of this number
    seed: int
    source: int
    centre_m: FloatArray  # (n_spheres, 3), of the receivers
    radius_m: FloatArray  # (n_spheres,)


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
    hits: IntArray  # int64 (n_chunks,), on walls
    escapes: IntArray  # int64 (n_chunks,), rays that met no wall
    escape_from_m: FloatArray  # (n_chunks, ESCAPES_KEPT, 3), start of the last flight of the first


@kernel(allocates=False)
def _chord(job: Job, k: int, o: Vector, d: Vector, flight_m: float) -> tuple[float, float]:
    """Return where a flight comes nearest to the centre of a sphere and its chord within."""
    x = job.centre_m[k, 0] - o[0]
    y = job.centre_m[k, 1] - o[1]
    z = job.centre_m[k, 2] - o[2]
    nearest = x * d[0] + y * d[1] + z * d[2]
    radius = job.radius_m[k]
    square = radius * radius - (x * x + y * y + z * z - nearest * nearest)
    if square <= 0.0:
        return 0.0, 0.0
    half = math.sqrt(square)
    start, end = max(nearest - half, 0.0), min(nearest + half, flight_m)
    return min(max(nearest, 0.0), flight_m), max(end - start, 0.0)


@kernel(allocates=False)
def _trace_chunks(
    first_chunk: int,
    last_chunk: int,
    walls: Walls,
    job: Job,
    directions: FloatArray,
    first_ray: int,
    met: IntArray,
    waiting: IntArray,
    caught: Caught,
) -> None:
    """Trace consecutive rays, each chunk into its own part of `caught`; for threads.

    Shapes: `directions` (n_rays, 3), `met` (2, n_chunks, n_materials), `waiting` (n_chunks, n).
    """
    for chunk in range(first_chunk, last_chunk):
        specular, diffuse = met[0, chunk], met[1, chunk]
        for i in range(chunk * _CHUNK_RAYS, min((chunk + 1) * _CHUNK_RAYS, len(directions))):
            specular[:] = 0
            diffuse[:] = 0
            d = (directions[i, 0], directions[i, 1], directions[i, 2])
            _trace_ray(
                walls, job, d, first_ray + i, chunk, specular, diffuse, waiting[chunk], caught
            )


@kernel(allocates=False)
def _trace_ray(
    walls: Walls,
    job: Job,
    d: Vector,
    ray: int,
    chunk: int,
    specular: IntArray,
    diffuse: IntArray,
    waiting: IntArray,
    caught: Caught,
) -> None:
    """Follow one ray to its end and record every sphere that it crosses."""
    key = ray_key(job.seed, job.source, ray)
    o = (job.start_m[0], job.start_m[1], job.start_m[2])
    travelled, hit, last = 0.0, 0, -1
    while True:
        flight, wall = next_wall(walls, o, d, last, waiting)
        for k in range(len(job.radius_m)):
            nearest, length = _chord(job, k, o, d, flight)
            if length > 0.0 and travelled + nearest <= job.max_length_m:
                i = caught.found[chunk]
                caught.found[chunk] += 1
                if i >= caught.ray.shape[1]:  # no memory is left: counted for the next attempt
                    continue
                caught.sphere[chunk, i] = k
                caught.ray[chunk, i] = ray
                caught.length_m[chunk, i] = travelled + nearest
                caught.chord_m[chunk, i] = length
                for m in range(len(specular)):
                    caught.hits_specular[chunk, i, m] = specular[m]
                    caught.hits_diffuse[chunk, i, m] = diffuse[m]
                for axis in range(3):
                    caught.arrival[chunk, i, axis] = d[axis]
        if wall < 0:
            n = caught.escapes[chunk]
            caught.escapes[chunk] += 1
            if n < ESCAPES_KEPT:
                for axis in range(3):
                    caught.escape_from_m[chunk, n, axis] = o[axis]
            break
        travelled += flight
        if travelled > job.max_length_m:
            break
        hit += 1
        if hit == job.max_hits:
            break
        o = (o[0] + flight * d[0], o[1] + flight * d[1], o[2] + flight * d[2])
        material = wall_material(walls, wall, o)
        last = wall
        normal = (walls.normal[wall, 0], walls.normal[wall, 1], walls.normal[wall, 2])
        d, is_diffuse = after_wall(d, normal, job.scattering[material], key, hit - 1)
        if is_diffuse:
            diffuse[material] += np.uint16(1)
        else:
            specular[material] += np.uint16(1)
    caught.hits[chunk] += hit


def _trace_block(
    walls: Walls, job: Job, directions: FloatArray, rays: range, capacity: int
) -> Caught:
    """Trace some of a source's rays, again where a chunk finds more crossings than `capacity`."""
    n_chunks, n_materials = -(-len(rays) // _CHUNK_RAYS), len(job.scattering)
    own = directions[rays.start : rays.stop]
    while True:
        size = (n_chunks, capacity)
        caught = Caught(
            np.zeros(n_chunks, np.int64),
            np.empty(size, np.int32),
            np.empty(size, np.int64),
            np.empty(size),
            np.empty(size),
            np.empty((*size, n_materials), np.uint16),
            np.empty((*size, n_materials), np.uint16),
            np.empty((*size, 3), np.float32),
            np.zeros(n_chunks, np.int64),
            np.zeros(n_chunks, np.int64),
            np.zeros((n_chunks, ESCAPES_KEPT, 3)),
        )
        met = np.zeros((2, n_chunks, n_materials), np.uint16)
        waiting = np.empty((n_chunks, WAITING), np.int32)
        in_threads(_trace_chunks, n_chunks, walls, job, own, rays.start, met, waiting, caught)
        found = int(caught.found.max(initial=0))
        if found <= capacity:
            return caught
        capacity = found


_MEMORY_LIMIT_BYTES = 4 * 2**30
_TOLERABLE_LEAK = 1e-3
# A block is what runs between two moves of the progress bar or two chances to interrupt: well
# under a second of work, and little memory.
_BLOCK_FLIGHTS, _BLOCK_CROSSINGS = 2_000_000, 500_000


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """Paths of a scene, and what to know about them."""

    # Image paths (batch -1) before rays, these in the order of groups, sources, rays, and time
    paths: Paths
    findings: tuple[Finding, ...] = ()  # `Code.RECEIVER_SPHERE_SHRUNK`, `Code.RAYS_ESCAPED`
    n_hits: int = 0  # of all rays on walls, including those whose paths image paths replace


def trace_rays(
    scene: Scene,
    settings: TraceSettings,
    scattering: Scattering,
    progress: Progress | None = None,
    *,
    receiver_radii_m: ArrayLike | None = None,
    images: list[Paths] | None = None,
) -> Trace:
    """Send rays from every source that a pair needs and record each crossing of its receivers.

    A crossing gives a path. Its length runs to the point of the flight nearest to the centre and
    decides whether it lies within `settings.duration_s`; its weight is the chord over number of
    rays and sphere volume, so that direct sound averages ``1 / (4 pi r**2)`` over the sphere.
    All rays come back, whatever `settings.image_order`, unless image paths are given: the last of
    `images`, which is taken from the list, so that it need not stay in memory while it is joined.

    Shapes: `receiver_radii_m` (n_receivers,).
    """
    radii = _radii(scene, settings, receiver_radii_m)
    coefficients = np.atleast_2d(coefficients_in_order(scattering, scene.room.materials))
    expected = expected_paths(scene, settings, receiver_radii_m=radii)
    _check_memory(scene, settings, expected)
    exact, reach_m = images.pop() if images else None, 0.0
    if exact is not None:  # images replace specular paths as far as they reach
        images_s = settings.duration_s if settings.image_until_s is None else settings.image_until_s
        reach_m = min(images_s, settings.duration_s) * speed_of_sound_m_s(scene.air)
    walls = walls_of(scene.room)
    pieces: list[list[Any]] = []
    every: list[Caught] = []
    n_found = 0
    sources = np.unique(scene.pairs[:, 0]).tolist() if settings.n_rays else []
    parts = [(row, one) for row in _groups(settings, coefficients) for one in sources]
    for done, ((own, s), source) in enumerate(parts):
        for last, piece, caught in _trace_source(scene, own, walls, source, radii, s):
            piece[2] /= len(coefficients)
            if exact is not None:
                _, length_m, _, specular, diffuse, *_ = piece
                late = ~covered_by_images(
                    length_m, specular, diffuse, settings.image_order, reach_m
                )
                piece = [column.take(np.flatnonzero(late), axis=0) for column in piece]
            pieces.append(piece)
            every.append(caught)
            n_found += len(piece[0])
            _check_memory(scene, settings, n_found)
            if progress is not None:
                progress((done + last / own.n_rays) / len(parts))
    of_images = None
    if exact is not None:
        of_images = exact.image_transform
        pieces.insert(0, path_columns(exact))
        exact = None
    paths = _joined(scene, settings, pieces, coefficients)
    if of_images is not None:
        transform = np.zeros((len(paths), 3, 3), np.float32)
        transform[: len(of_images)] = of_images
        paths = replace(paths, image_transform=transform)
    n_hits = sum(int(c.hits.sum()) for c in every)
    return Trace(paths, _leaks(every, n_hits), n_hits)


def _joined(
    scene: Scene, settings: TraceSettings, pieces: list[list[Any]], coefficients: FloatArray
) -> Paths:
    """Return pieces as paths, letting go of each array once it is copied."""
    if not pieces:
        no_hits, nowhere = np.empty((0, coefficients.shape[1]), np.uint16), np.empty((0, 3), "f4")
        nothing, none = np.empty(0), np.empty(0, np.int32)
        pieces = [[none, nothing, nothing, no_hits, no_hits.copy(), nowhere, nowhere.copy(), none]]
    columns: list[Any] = [np.concatenate([p.pop(0) for p in pieces]) for _ in range(len(pieces[0]))]
    columns += [settings.n_batches, coefficients]
    return Paths(len(scene.pairs), scene.room.materials, *columns)


def _leaks(every: list[Caught], n_hits: int) -> tuple[Finding, ...]:
    n_escaped = sum(int(c.escapes.sum()) for c in every)
    if n_escaped == 0:
        return ()
    kept = [c.escape_from_m[np.arange(ESCAPES_KEPT) < c.escapes[:, None]] for c in every]
    from_m = np.concatenate(kept)[:_ESCAPES_REPORTED]
    share = n_escaped / (n_hits + n_escaped)
    place = ", ".join(f"{x:.2f}" for x in from_m[0])
    return (
        Finding(
            Code.RAYS_ESCAPED,
            About(points_m=from_m.tolist()),
            f"{n_escaped} rays left the room through gaps, {100.0 * share:.2g} % of "
            f"their flights, the first one in a flight from ({place}) m: the room is not closed.",
            {"n_escaped": n_escaped, "escape_fraction": share},
            graded="warning" if share < _TOLERABLE_LEAK else "serious",
        ),
    )


def covered_by_images(
    length_m: FloatArray, specular: IntArray, diffuse: IntArray, order: int, reach_m: float
) -> BoolArray:
    """Return which paths images up to an order and a length replace: specular only, and short."""
    near = (specular.sum(axis=1, dtype=np.int64) <= order) & (length_m < reach_m)
    return np.asarray(~diffuse.any(axis=1) & near)


def _groups(
    settings: TraceSettings, coefficients: FloatArray
) -> list[tuple[TraceSettings, FloatArray]]:
    """Return settings and coefficients of every group; the first one keeps the seed."""
    n_rays = -(-settings.n_rays // len(coefficients))
    seeds = [settings.seed] + [
        int(np.random.default_rng((settings.seed, group)).integers(2**62))
        for group in range(1, len(coefficients))
    ]
    return [
        (replace(settings, n_rays=n_rays, seed=seed), row)
        for seed, row in zip(seeds, coefficients, strict=True)
    ]


def _trace_source(
    scene: Scene,
    settings: TraceSettings,
    walls: Walls,
    source: int,
    radii: FloatArray,
    coefficients: FloatArray,
) -> Iterator[tuple[int, list[Any], Caught]]:
    """Trace block by block; give the rays done so far, and the columns of paths of the block."""
    pair = np.flatnonzero(scene.pairs[:, 0] == source)
    receiver = scene.pairs[pair, 1]
    job = Job(
        scene.sources[source].position_m,
        coefficients,
        settings.duration_s * speed_of_sound_m_s(scene.air),
        settings.max_hits,
        settings.seed,
        source,
        np.array([scene.receivers[r].position_m for r in receiver]),
        radii[receiver],
    )
    directions = start_directions(settings, source)
    volume, free_path_m = _volume_and_free_path(scene.room)
    per_ray = float((job.max_length_m * np.pi * job.radius_m**2 / volume).sum())
    flights = 1.0 + job.max_length_m / free_path_m
    at_once = min(_BLOCK_FLIGHTS / flights, _BLOCK_CROSSINGS / max(per_ray, 1e-9))
    step = max(int(at_once) // _CHUNK_RAYS, 1) * _CHUNK_RAYS
    share = 1.0 / (settings.n_rays * 4.0 / 3.0 * np.pi * job.radius_m**3)
    for start in range(0, settings.n_rays, step):
        rays = range(start, min(start + step, settings.n_rays))
        caught = _trace_block(walls, job, directions, rays, int(1.2 * per_ray * _CHUNK_RAYS) + 64)
        filled = np.flatnonzero(np.arange(caught.ray.shape[1]) < caught.found[:, None])
        # of each crossing; rows are taken four times as fast as they are indexed by a mask
        taken: list[Any] = [
            each.reshape(-1, *each.shape[2:]).take(filled, axis=0) for each in caught[1:8]
        ]
        sphere, ray, length_m, chord_m, specular, diffuse, arrival = taken
        columns = [
            pair.astype(np.int32)[sphere],
            length_m,
            chord_m * share[sphere],
            specular,
            diffuse,
            directions.take(ray, axis=0).astype(np.float32),
            arrival,
            (ray % settings.n_batches).astype(np.int32),
        ]
        counts: Any = [caught.found, *[np.empty(0)] * 7, *caught[-3:]]
        yield rays.stop, columns, Caught(*counts)


def expected_paths(
    scene: Scene, settings: TraceSettings, *, receiver_radii_m: ArrayLike | None = None
) -> float:
    """Return about how many paths a trace will record.

    In a diffuse field a ray of length L crosses a sphere of radius a in a room of volume V
    ``pi a**2 L / V`` times.
    """
    radii = _radii(scene, settings, receiver_radii_m)[scene.pairs[:, 1]]
    volume, free_path_m = _volume_and_free_path(scene.room)
    length = settings.duration_s * speed_of_sound_m_s(scene.air)
    length = min(length, settings.max_hits * free_path_m)
    return settings.n_rays * float((length * np.pi * radii**2 / volume).sum())


def path_bytes(scene: Scene) -> int:
    """Return the memory of one recorded path of a scene in bytes."""
    return 48 + 4 * len(scene.room.materials)


def _check_memory(scene: Scene, settings: TraceSettings, n_paths: float) -> None:
    needed = n_paths * path_bytes(scene) + 24.0 * settings.n_rays
    if needed > _MEMORY_LIMIT_BYTES:
        raise InputError(
            "the trace would not fit into memory",
            found=f"about {n_paths:.3g} paths, {needed / 2**30:.3g} GiB",
            needed=f"at most {_MEMORY_LIMIT_BYTES / 2**30:.3g} GiB",
            hint="fewer rays, a smaller receiver radius, a shorter duration or fewer pairs",
        )


def _radii(scene: Scene, settings: TraceSettings, receiver_radii_m: ArrayLike | None) -> FloatArray:
    n = len(scene.receivers)
    if receiver_radii_m is None:
        return np.full(n, settings.receiver_radius_m)
    return float_array("radius of each receiver", receiver_radii_m, (n,), low=1e-3, unit="m")


def _volume_and_free_path(room: Room) -> tuple[float, float]:
    """Return volume, m3, and mean free path, m; of the bounding box of a mesh without volume."""
    volume = abs(volume_m3(room.mesh))
    box = float(np.prod(np.ptp(room.mesh.vertices_m, axis=0)))
    volume = volume if volume > 1e-3 * box else max(box, 1e-9)
    return volume, 4.0 * volume / surface_area_m2(room.mesh)
