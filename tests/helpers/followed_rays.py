"""What the walls have done to rays by given times, wherever the rays are then: no receivers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from roomfit.base.arguments import float_array, read_only
from roomfit.base.kernels import kernel
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.materials.priors import Scattering, coefficients_in_order
from roomfit.room.scene import Room
from roomfit.tracing.bvh import Walls, next_wall, wall_material, walls_of
from roomfit.tracing.ray_kernels import Job, Tally, note_escape
from roomfit.tracing.rays import (
    RayStatistics,
    new_tally,
    ray_statistics,
    sobol_directions,
)
from roomfit.tracing.walls import after_wall, ray_key

_MAX_HITS = 65_535


@dataclass(frozen=True, slots=True, eq=False)
class FollowedRays:
    """Wall hits of every ray by given times.

    The energy in the room at time t, of a unit sent out, is the mean over the rays present of the
    product over materials of ``(1 - a) ** hits``.

    Attributes
    ----------
    hits : uint16 array, shape (n_times, n_rays, n_materials)
        Those of an escaped ray stay what they were.
    present : bool array, shape (n_times, n_rays)
        False from the flight on in which a ray leaves through a leak.
    statistics : RayStatistics
    """

    hits: IntArray
    present: BoolArray
    statistics: RayStatistics


def follow_rays(
    room: Room,
    position_m: ArrayLike,
    speed_of_sound_m_s: float,
    times_s: ArrayLike,
    n_rays: int,
    scattering: Scattering,
    seed: int = 1,
) -> FollowedRays:
    """Send rays from one point and count how often each has struck each material by given times.

    Parameters
    ----------
    position_m : array_like, shape (3,)
    times_s : array_like, shape (n_times,)
        Rising.
    n_rays : int
        In the directions of one scrambled Sobol set; a power of two is best.
    seed : int
        Same seed, same hits, for any number of threads.
    """
    times = float_array("times", times_s, (None,), low=0.0, unit="s")
    start = float_array("position", position_m, (3,), low=-1e6, high=1e6, unit="m")
    lengths = np.sort(times) * speed_of_sound_m_s
    coefficients = coefficients_in_order(scattering, room.materials)
    job = Job(start, coefficients, float(lengths.max(initial=0.0)), _MAX_HITS, seed, 0)
    hits = np.zeros((len(lengths), n_rays, len(coefficients)), np.uint16)
    present = np.zeros((len(lengths), n_rays), np.bool_)
    tally = new_tally(n_rays)
    directions = sobol_directions(n_rays, 1, (seed, 0))
    _follow(walls_of(room), job, directions, lengths, hits, present, tally)
    return FollowedRays(read_only(hits), read_only(present), ray_statistics(n_rays, [tally]))


@kernel()
def _follow(
    walls: Walls,
    job: Job,
    directions: FloatArray,
    lengths_m: FloatArray,
    hits: IntArray,
    present: BoolArray,
    tally: Tally,
) -> None:
    for ray in range(len(directions)):
        _follow_ray(walls, job, directions, lengths_m, ray, hits, present, tally)


@kernel(allocates=False)
def _follow_ray(
    walls: Walls,
    job: Job,
    directions: FloatArray,
    lengths_m: FloatArray,
    ray: int,
    hits: IntArray,
    present: BoolArray,
    tally: Tally,
) -> None:
    """Follow one ray; its count so far lives in the row of the next time to come."""
    key = ray_key(job.seed, job.source, ray)
    d = (directions[ray, 0], directions[ray, 1], directions[ray, 2])
    o = (job.start_m[0], job.start_m[1], job.start_m[2])
    travelled, hit, due, last = 0.0, 0, 0, -1
    while True:
        flight, wall = next_wall(walls, o, d, last)
        while due < len(lengths_m) and travelled + flight > lengths_m[due]:
            present[due, ray] = wall >= 0
            if due + 1 < len(lengths_m):
                for m in range(hits.shape[2]):
                    hits[due + 1, ray, m] = hits[due, ray, m]
            due += 1
        if wall < 0:
            note_escape(o, ray, tally)
            return
        if hit > 0:
            tally.free_paths[ray] += 1
            tally.sum_m[ray] += flight
            tally.sum_m2[ray] += flight * flight
        if due == len(lengths_m) or hit == job.max_hits:
            return
        travelled += flight
        tally.hits[ray] += 1
        o = (o[0] + flight * d[0], o[1] + flight * d[1], o[2] + flight * d[2])
        material = wall_material(walls, wall, o)
        hits[due, ray, material] += np.uint16(1)
        normal = (walls.normal[wall, 0], walls.normal[wall, 1], walls.normal[wall, 2])
        d, _ = after_wall(d, normal, job.scattering[material], key, hit)
        hit, last = hit + 1, wall
