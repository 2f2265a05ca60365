"""Rays from every source, caught by spheres around the receivers.

The same seed gives the same bits for any number of threads. A wall or the source may cut a sphere:
what counts is the part of the chord inside the room. Rays that leave through a leak are counted and
dropped. The method is that of M. Vorlaender, "Auralization", Springer 2008, section 11.3. Rays are
traced block by block and packed into path arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roomfit.base.air import speed_of_sound_m_s
from roomfit.base.arguments import float_array, read_only
from roomfit.base.errors import InputError
from roomfit.base.findings import Finding
from roomfit.base.kernels import in_threads
from roomfit.base.typing import BoolArray, FloatArray, IntArray, Progress
from roomfit.materials.priors import Scattering, coefficients_in_order
from roomfit.room.mesh import surface_area_m2, volume_m3
from roomfit.room.scene import Room, Scene
from roomfit.tracing.bvh import Walls, walls_of
from roomfit.tracing.paths import Paths, TraceSettings
from roomfit.tracing.ray_kernels import (
    CHUNK_RAYS,
    ESCAPES_KEPT,
    Caught,
    Job,
    Spheres,
    Tally,
    spheres,
    trace_chunks,
)

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


Float32Array: TypeAlias = np.ndarray[tuple[int, int], np.dtype[np.float32]]


class Piece(NamedTuple):
    """Part of the arrays of `Paths`, in their order; the first axis is the path."""

    pair: IntArray
    length_m: FloatArray
    weight_per_m2: FloatArray
    hits_specular: IntArray
    hits_diffuse: IntArray
    departure: Float32Array
    arrival: Float32Array
    batch: IntArray


def new_tally(n_chunks: int) -> Tally:
    """Return zeroed counters for so many chunks."""
    return Tally(
        np.zeros(n_chunks, np.int64),
        np.zeros(n_chunks, np.int64),
        np.zeros(n_chunks, np.int64),
        np.zeros(n_chunks),
        np.zeros(n_chunks),
        np.zeros((n_chunks, ESCAPES_KEPT, 3)),
    )


def _trace_block(
    walls: Walls, spheres: Spheres, job: Job, directions: FloatArray, rays: range, capacity: int
) -> tuple[Caught, Tally]:
    """Trace some of a source's rays, again where a chunk finds more crossings than `capacity`."""
    n_chunks = -(-len(rays) // CHUNK_RAYS)
    own = directions[rays.start : rays.stop]
    while True:
        caught, tally = _new_caught(n_chunks, capacity, len(job.scattering)), new_tally(n_chunks)
        met = np.zeros((2, n_chunks, len(job.scattering)), np.uint16)
        in_threads(trace_chunks, n_chunks, walls, spheres, job, own, rays.start, met, caught, tally)
        found = int(caught.found.max(initial=0))
        if found <= capacity:
            return caught, tally
        capacity = found


def _packed(caught: Caught, spheres: Spheres, directions: FloatArray, n_batches: int) -> Piece:
    """Return the recorded crossings of a block as paths, in the order of chunks."""
    filled = np.arange(caught.ray.shape[1]) < caught.found[:, None]
    ray, sphere = caught.ray[filled], caught.sphere[filled]
    share = 1.0 / (len(directions) * 4.0 / 3.0 * np.pi * spheres.radius_m**3)
    return Piece(
        spheres.pair[sphere],
        caught.length_m[filled],
        caught.chord_m[filled] * share[sphere],
        caught.hits_specular[filled],
        caught.hits_diffuse[filled],
        directions[ray].astype(np.float32),
        np.asarray(caught.arrival[filled], dtype=np.float32),
        (ray % n_batches).astype(np.int32),
    )


def _joined(pieces: list[Piece], n_materials: int) -> Piece:
    """Join pieces array by array, emptying the list and letting go of each array once copied."""
    no_hits, nowhere = np.empty((0, n_materials), np.uint16), np.empty((0, 3), np.float32)
    nothing, none = np.empty(0), np.empty(0, np.int32)
    no_paths = Piece(none, nothing, nothing, no_hits, no_hits, nowhere, nowhere, none)
    columns = [list(column) for column in zip(no_paths, *pieces, strict=True)]
    pieces.clear()
    arrays = []
    for column in columns:
        arrays.append(np.concatenate(column))
        column.clear()
    return Piece(*arrays)


def _new_caught(n_chunks: int, capacity: int, n_materials: int) -> Caught:
    size = (n_chunks, capacity)
    return Caught(
        np.zeros(n_chunks, np.int64),
        np.empty(size, np.int32),
        np.empty(size, np.int64),
        np.empty(size),
        np.empty(size),
        np.empty((*size, n_materials), np.uint16),
        np.empty((*size, n_materials), np.uint16),
        np.empty((*size, 3), np.float32),
    )


_ESCAPES_REPORTED = 8


@dataclass(frozen=True, slots=True, eq=False)
class RayStatistics:
    """Counts of a trace.

    Free paths run from one wall to the next. Each that begins before a ray's time is up counts in
    full, even where it ends later: counting only those that fit would favour short ones.
    """

    n_rays: int  # of all sources
    n_hits: int  # of walls
    n_escaped: int  # met no wall and were dropped
    n_free_paths: int
    mean_free_path_m: float  # 0 without free paths
    relative_variance: float  # Of the free paths, over their squared mean: Kuttruff's gamma squared
    escapes_from_m: FloatArray  # (n, 3), where the first escaped rays began their last flight

    @property
    def escape_fraction(self) -> float:
        """Share of flights that met no wall."""
        return self.n_escaped / max(self.n_hits + self.n_escaped, 1)


def ray_statistics(n_rays: int, tallies: Sequence[Tally]) -> RayStatistics:
    """Return the sum of all chunks of all blocks."""
    hits = sum(int(t.hits.sum()) for t in tallies)
    escapes = sum(int(t.escapes.sum()) for t in tallies)
    n = sum(int(t.free_paths.sum()) for t in tallies)
    mean = sum(float(t.sum_m.sum()) for t in tallies) / max(n, 1)
    square = sum(float(t.sum_m2.sum()) for t in tallies) / max(n, 1)
    kept = [np.arange(ESCAPES_KEPT) < t.escapes[:, None] for t in tallies]
    starts = [t.escape_from_m[k] for t, k in zip(tallies, kept, strict=True)]
    return RayStatistics(
        n_rays,
        hits,
        escapes,
        n,
        mean,
        max(square / mean**2 - 1.0, 0.0) if mean > 0.0 else 0.0,
        read_only(np.concatenate([np.empty((0, 3)), *starts])[:_ESCAPES_REPORTED].copy()),
    )


MEMORY_LIMIT_BYTES = 4 * 2**30
# A block is what runs between two moves of the progress bar or two chances to interrupt: well
# under a second of work, and little memory.
_BLOCK_FLIGHTS = 2_000_000
_BLOCK_CROSSINGS = 500_000


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """Paths of a scene, and what to know about them."""

    # Image paths (batch -1) before rays, these in the order of groups, sources, rays, and time
    paths: Paths
    statistics: RayStatistics  # Of all rays, including those whose paths image paths replace
    findings: tuple[Finding, ...] = ()  # `Code.RECEIVER_SPHERE_SHRUNK`, `Code.RAYS_ESCAPED`


def trace_rays(
    scene: Scene,
    settings: TraceSettings,
    scattering: Scattering,
    progress: Progress | None = None,
    *,
    receiver_radii_m: ArrayLike | None = None,
    memory_limit_bytes: int = MEMORY_LIMIT_BYTES,
    images: Callable[[], Paths] | None = None,
) -> Trace:
    """Send rays from every source that a pair needs and record each crossing of its receivers.

    A crossing gives a path. Its length runs to the point of the flight nearest to the centre and
    decides whether it lies within `settings.duration_s`; its weight is the chord over number of
    rays and sphere volume, so that direct sound averages ``1 / (4 pi r**2)`` over the sphere.
    All rays come back, whatever `settings.image_order`, unless image paths are given.

    Shapes: `receiver_radii_m` (n_receivers,).
    """
    exact = None if images is None else images()
    radii = _radii(scene, settings, receiver_radii_m)
    coefficients = np.atleast_2d(coefficients_in_order(scattering, scene.room.materials))
    expected = expected_paths(scene, settings, receiver_radii_m=radii)
    _check_memory(scene, settings, expected, memory_limit_bytes)
    reach: tuple[int, float] | None = None  # up to which images replace specular paths
    if exact is not None:
        images_s = settings.duration_s if settings.image_until_s is None else settings.image_until_s
        reach_s = min(images_s, settings.duration_s)
        reach = settings.image_order, reach_s * speed_of_sound_m_s(scene.air)
    pieces, statistics = _recorded(
        scene, settings, radii, coefficients, reach, memory_limit_bytes, progress
    )
    if exact is not None and not pieces:
        alone = replace(exact, n_batches=settings.n_batches, sampling_scattering=coefficients)
        return Trace(alone, statistics)
    of_images = None
    if exact is not None:
        pieces.insert(0, Piece(**{name: getattr(exact, name) for name in Piece._fields}))
        of_images, exact = exact.image_transform, None
    return Trace(_as_paths(scene, settings, pieces, coefficients, of_images), statistics)


def _recorded(
    scene: Scene,
    settings: TraceSettings,
    radii: FloatArray,
    coefficients: FloatArray,
    reach: tuple[int, float] | None,
    memory_limit_bytes: int,
    progress: Progress | None,
) -> tuple[list[Piece], RayStatistics]:
    """Return the paths of rays from all sources, without those within the `reach` of images."""
    walls = walls_of(scene.room)
    pieces: list[Piece] = []
    tallies: list[Tally] = []
    found = 0
    sources = np.unique(scene.pairs[:, 0]).tolist() if settings.n_rays else []
    parts = [(row, one) for row in _groups(settings, coefficients) for one in sources]
    for done, ((own, s), source) in enumerate(parts):
        for last, piece, tally in _trace_source(scene, own, walls, source, radii, s):
            piece.weight_per_m2[:] /= len(coefficients)
            if reach is not None:
                late = ~covered_by_images(piece, *reach)
                piece = Piece._make([column[late] for column in piece])
            pieces.append(piece)
            tallies.append(tally)
            found += len(piece.length_m)
            _check_memory(scene, settings, found, memory_limit_bytes)
            if progress is not None:
                progress((done + last / own.n_rays) / len(parts))
    return pieces, ray_statistics(sum(own.n_rays for (own, _), _ in parts), tallies)


def _as_paths(
    scene: Scene,
    settings: TraceSettings,
    pieces: list[Piece],
    coefficients: FloatArray,
    of_images: NDArray[np.float32] | None,
) -> Paths:
    """Return pieces as paths, emptying the list; `of_images` are the transforms of the first."""
    joined = _joined(pieces, coefficients.shape[1])
    transform = None
    if of_images is not None:
        transform = np.zeros((len(joined.length_m), 3, 3), np.float32)
        transform[: len(of_images)] = of_images
    return Paths(
        len(scene.pairs),
        scene.room.materials,
        *joined,
        n_batches=settings.n_batches,
        sampling_scattering=coefficients,
        image_transform=transform,
    )


def covered_by_images(paths: Paths | Piece, image_order: int, reach_m: float = np.inf) -> BoolArray:
    """Return which paths images up to an order and a length replace: specular only, and short."""
    specular = paths.hits_specular.sum(axis=1, dtype=np.int64)
    near = (specular <= image_order) & (paths.length_m < reach_m)
    return np.asarray(~paths.hits_diffuse.any(axis=1) & near)


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
) -> Iterator[tuple[int, Piece, Tally]]:
    """Trace block by block; give the rays done so far, and paths and counts of the block."""
    job = Job(
        scene.sources[source].position_m,
        coefficients,
        settings.duration_s * speed_of_sound_m_s(scene.air),
        settings.max_hits,
        settings.seed,
        source,
    )
    pair = np.flatnonzero(scene.pairs[:, 0] == source)
    receiver = scene.pairs[pair, 1]
    centres = np.array([scene.receivers[r].position_m for r in receiver])
    receivers = spheres(centres, radii[receiver], pair)
    directions = start_directions(settings, source)
    size = _size(scene.room)
    per_ray = _paths_along(size, receivers.radius_m, job.max_length_m)
    for rays in _blocks(size, per_ray, job, settings.n_rays):
        capacity = int(1.2 * per_ray * CHUNK_RAYS) + 64
        caught, tally = _trace_block(walls, receivers, job, directions, rays, capacity)
        yield rays.stop, _packed(caught, receivers, directions, settings.n_batches), tally


def expected_paths(
    scene: Scene,
    settings: TraceSettings,
    *,
    receiver_radii_m: ArrayLike | None = None,
) -> float:
    """Return about how many paths a trace will record.

    In a diffuse field a ray of length L crosses a sphere of radius a in a room of volume V
    ``pi a**2 L / V`` times.
    """
    radii = _radii(scene, settings, receiver_radii_m)[scene.pairs[:, 1]]
    length = settings.duration_s * speed_of_sound_m_s(scene.air)
    size = _size(scene.room)
    length = min(length, settings.max_hits * size.mean_free_path_m)
    return settings.n_rays * _paths_along(size, radii, length)


def path_bytes(scene: Scene) -> int:
    """Return the memory of one recorded path of a scene in bytes."""
    return 48 + 4 * len(scene.room.materials)


def _check_memory(scene: Scene, settings: TraceSettings, n_paths: float, limit_bytes: int) -> None:
    needed = n_paths * path_bytes(scene) + 24.0 * settings.n_rays
    if needed > limit_bytes:
        raise InputError(
            "the trace would not fit into memory",
            found=f"about {n_paths:.3g} paths, {needed / 2**30:.3g} GiB",
            needed=f"at most {limit_bytes / 2**30:.3g} GiB",
            hint="fewer rays, a smaller receiver radius, a shorter duration or fewer pairs",
        )


def _radii(scene: Scene, settings: TraceSettings, receiver_radii_m: ArrayLike | None) -> FloatArray:
    if receiver_radii_m is None:
        return np.full(len(scene.receivers), settings.receiver_radius_m)
    return float_array(
        "radius of each receiver", receiver_radii_m, (len(scene.receivers),), low=1e-3, unit="m"
    )


class _Size(NamedTuple):
    """Of a room; where its mesh encloses nothing, of the bounding box."""

    volume_m3: float
    mean_free_path_m: float


def _size(room: Room) -> _Size:
    volume = abs(volume_m3(room.mesh))
    box = float(np.prod(np.ptp(room.mesh.vertices_m, axis=0)))
    volume = volume if volume > 1e-3 * box else max(box, 1e-9)
    return _Size(volume, 4.0 * volume / surface_area_m2(room.mesh))


def _paths_along(size: _Size, radii_m: FloatArray, length_m: float) -> float:
    """Return how many paths one ray is expected to give."""
    return float((length_m * np.pi * radii_m**2 / size.volume_m3).sum())


def _blocks(size: _Size, per_ray: float, job: Job, n_rays: int) -> Iterator[range]:
    flights = 1.0 + job.max_length_m / size.mean_free_path_m
    rays = min(_BLOCK_FLIGHTS / flights, _BLOCK_CROSSINGS / max(per_ray, 1e-9))
    step = max(int(rays) // CHUNK_RAYS, 1) * CHUNK_RAYS
    for start in range(0, n_rays, step):
        yield range(start, min(start + step, n_rays))
