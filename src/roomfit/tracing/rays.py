"""Rays from every source, caught by spheres around the receivers.

The same seed gives the same bits for any number of threads. A wall or the source may cut a sphere:
what counts is the part of the chord inside the room. Rays that leave through a leak are counted and
dropped. The method is that of M. Vorlaender, "Auralization", Springer 2008, section 11.3.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from roomfit.air import speed_of_sound_m_s
from roomfit.checks import float_array
from roomfit.errors import InputError
from roomfit.geometry.measures import surface_area_m2, volume_m3
from roomfit.materials.scattering import Scattering
from roomfit.scene.room import Room
from roomfit.scene.scene import Scene
from roomfit.tracing.acceleration import Walls, walls_of
from roomfit.tracing.directions import start_directions
from roomfit.tracing.paths import Paths
from roomfit.tracing.ray_blocks import Piece, bytes_per_path, joined, packed, trace_block
from roomfit.tracing.ray_kernels import CHUNK_RAYS, FAINTEST, Job, Tally
from roomfit.tracing.ray_statistics import RayStatistics, ray_statistics
from roomfit.tracing.settings import TraceSettings
from roomfit.tracing.spheres import Spheres, spheres
from roomfit.typing import FloatArray, Progress

MEMORY_LIMIT_BYTES = 4 * 2**30
# A block is what runs between two moves of the progress bar or two chances to interrupt: well
# under a second of work, and little memory.
_BLOCK_FLIGHTS = 2_000_000
_BLOCK_CROSSINGS = 500_000


@dataclass(frozen=True, slots=True, eq=False)
class RayTrace:
    """What rays brought home.

    Attributes
    ----------
    paths : Paths
        In the order of sources, then rays, then time.
    statistics : RayStatistics
    """

    paths: Paths
    statistics: RayStatistics


def trace_rays(
    scene: Scene,
    settings: TraceSettings,
    scattering: Scattering,
    progress: Progress | None = None,
    *,
    receiver_radii_m: ArrayLike | None = None,
    memory_limit_bytes: int = MEMORY_LIMIT_BYTES,
) -> RayTrace:
    """Send rays from every source that a pair needs and record each crossing of its receivers.

    A crossing gives a path. Its length runs to the point of the flight nearest to the centre and
    decides whether it lies within `settings.duration_s`; its weight is the chord over number of
    rays and sphere volume, so that direct sound averages ``1 / (4 pi r**2)`` over the sphere.
    All rays come back, whatever `settings.image_order`.

    Parameters
    ----------
    settings : TraceSettings
        A ray ends at its wall hit number `max_hits`, or when its time is up.
    scattering : Scattering
        One coefficient for each material of the room, in any order.
    receiver_radii_m : array_like, shape (n_receivers,), optional
        Radius of each receiver of the scene instead of `settings.receiver_radius_m`.
    memory_limit_bytes : int
        More, at `path_bytes` a path and 24 bytes a ray, is refused: before the trace where so many
        paths are expected, on the way where so many are found. The peak is that, once again the
        largest array of the paths, and about 100 MB.

    Raises
    ------
    InputError
        Scattering of other materials, or too many paths for the memory.
    """
    radii = _radii(scene, settings, receiver_radii_m)
    coefficients = in_room_order(scattering, scene.room)
    sources = np.unique(scene.pairs[:, 0]).tolist() if settings.n_rays else []
    expected = expected_paths(
        scene, settings, receiver_radii_m=radii, scattering=float(coefficients.max(initial=0.0))
    )
    _check_memory(scene, settings, expected, memory_limit_bytes)
    walls = walls_of(scene.room)
    pieces: list[Piece] = []
    tallies: list[Tally] = []
    found = 0
    for done, source in enumerate(sources):
        for last, piece, tally in _trace_source(
            scene, settings, walls, source, radii, coefficients
        ):
            pieces.append(piece)
            tallies.append(tally)
            found += len(piece.length_m)
            _check_memory(scene, settings, found, memory_limit_bytes)
            if progress is not None:
                progress((done + last / settings.n_rays) / len(sources))
    paths = Paths(
        len(scene.pairs),
        scene.room.materials,
        *joined(pieces, len(coefficients)),
        n_batches=settings.n_batches,
        sampling_scattering=coefficients,
    )
    return RayTrace(paths, ray_statistics(len(sources) * settings.n_rays, tallies))


def _trace_source(
    scene: Scene,
    settings: TraceSettings,
    walls: Walls,
    source: int,
    radii: FloatArray,
    coefficients: FloatArray,
) -> Iterator[tuple[int, Piece, Tally]]:
    """Trace block by block; give the rays done so far and what the block brought."""
    job = Job(
        scene.sources[source].position_m,
        coefficients,
        settings.duration_s * speed_of_sound_m_s(scene.air),
        settings.max_hits,
        settings.seed,
        source,
        settings.estimator == "rain",
    )
    receivers = _spheres(scene, source, radii)
    directions = start_directions(settings, source)
    per_ray = _paths_per_ray(scene.room, receivers.radius_m, job)
    for rays in _blocks(scene.room, per_ray, job, settings.n_rays):
        capacity = int(1.2 * per_ray * CHUNK_RAYS) + 64
        caught, tally = trace_block(walls, receivers, job, directions, rays, capacity)
        yield rays.stop, packed(caught, receivers, directions, settings.n_batches), tally


def expected_paths(
    scene: Scene,
    settings: TraceSettings,
    *,
    receiver_radii_m: ArrayLike | None = None,
    scattering: float = 0.0,
) -> float:
    """Return about how many paths a trace will record, or more where walls differ in scattering.

    In a diffuse field a ray of length L crosses a sphere of radius a in a room of volume V
    ``pi a**2 L / V`` times. Rain brings more paths of less weight.

    Parameters
    ----------
    scattering : float
        The largest of any wall; counts for rain.
    """
    radii = _radii(scene, settings, receiver_radii_m)[scene.pairs[:, 1]]
    length = settings.duration_s * speed_of_sound_m_s(scene.air)
    length = min(length, settings.max_hits * _mean_free_path_m(scene.room))
    rain = scattering if settings.estimator == "rain" else 0.0
    return settings.n_rays * _paths_along(scene.room, radii, length, rain)


def path_bytes(scene: Scene) -> int:
    """Return the memory of one recorded path of a scene in bytes."""
    return bytes_per_path(len(scene.room.materials))


def _check_memory(scene: Scene, settings: TraceSettings, n_paths: float, limit_bytes: int) -> None:
    needed = n_paths * path_bytes(scene) + 24.0 * settings.n_rays
    if needed > limit_bytes:
        raise InputError(
            "the trace would not fit into memory",
            found=f"about {n_paths:.3g} paths, {needed / 2**30:.3g} GiB",
            needed=f"at most {limit_bytes / 2**30:.3g} GiB",
            hint="fewer rays, a smaller receiver radius, a shorter duration or fewer pairs",
        )


def in_room_order(scattering: Scattering, room: Room) -> FloatArray:
    """Return the scattering coefficients in the order of the room's materials.

    Raises
    ------
    InputError
        A material of one is missing in the other.
    """
    if set(scattering.materials) != set(room.materials):
        raise InputError(
            "scattering and room name different materials",
            found=", ".join(scattering.materials),
            needed=", ".join(room.materials),
        )
    order = [scattering.materials.index(m) for m in room.materials]
    return np.array(scattering.coefficients[order])


def _radii(scene: Scene, settings: TraceSettings, receiver_radii_m: ArrayLike | None) -> FloatArray:
    if receiver_radii_m is None:
        return np.full(len(scene.receivers), settings.receiver_radius_m)
    return float_array(
        "radius of each receiver", receiver_radii_m, (len(scene.receivers),), low=1e-3, unit="m"
    )


def _spheres(scene: Scene, source: int, radii: FloatArray) -> Spheres:
    pair = np.flatnonzero(scene.pairs[:, 0] == source)
    receiver = scene.pairs[pair, 1]
    centres = np.array([scene.receivers[r].position_m for r in receiver])
    return spheres(centres, radii[receiver], pair)


def _volume_m3(room: Room) -> float:
    """Return the volume; of the bounding box, where the mesh encloses none."""
    volume = abs(volume_m3(room.mesh))
    box = float(np.prod(np.ptp(room.mesh.vertices_m, axis=0)))
    return volume if volume > 1e-3 * box else max(box, 1e-9)


def _mean_free_path_m(room: Room) -> float:
    return 4.0 * _volume_m3(room) / surface_area_m2(room.mesh)


def _paths_per_ray(room: Room, radii_m: FloatArray, job: Job) -> float:
    rain = float(job.scattering.max(initial=0.0)) if job.rain else 0.0
    return _paths_along(room, radii_m, job.max_length_m, rain)


def _paths_along(room: Room, radii_m: FloatArray, length_m: float, rain: float) -> float:
    """Return how many paths one ray is expected to bring, at most.

    Rain brings the energy of the crossings that it replaces, in paths of at least `FAINTEST` of
    their weight, and never more than one path for a diffuse reflection and a receiver.
    """
    crossings = length_m * np.pi * radii_m**2 / _volume_m3(room)
    drops = np.minimum(crossings / FAINTEST, length_m / _mean_free_path_m(room))
    return float(crossings.sum() + rain * drops.sum())


def _blocks(room: Room, per_ray: float, job: Job, n_rays: int) -> Iterator[range]:
    flights = 1.0 + job.max_length_m / _mean_free_path_m(room)
    rays = min(_BLOCK_FLIGHTS / flights, _BLOCK_CROSSINGS / max(per_ray, 1e-9))
    step = max(int(rays) // CHUNK_RAYS, 1) * CHUNK_RAYS
    for start in range(0, n_rays, step):
        yield range(start, min(start + step, n_rays))
