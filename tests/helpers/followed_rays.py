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
from roomfit.tracing.bvh import WAITING, Walls, next_wall, wall_material, walls_of
from roomfit.tracing.rays import sobol_directions
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
    free_paths_m : float array, shape (n_free_paths,)
        From one wall to the next, of all rays, in full where time is up within.
    """

    hits: IntArray
    present: BoolArray
    free_paths_m: FloatArray


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

    `position_m`, shape (3,). `times_s`, shape (n_times,): rising. `n_rays`: in the directions of
    one scrambled Sobol set; a power of two is best. `seed`: same seed, same hits, for any number of
    threads.
    """
    times = float_array("times", times_s, (None,), low=0.0, unit="s")
    start = float_array("position", position_m, (3,), low=-1e6, high=1e6, unit="m")
    lengths = np.sort(times) * speed_of_sound_m_s
    coefficients = coefficients_in_order(scattering, room.materials)
    hits = np.zeros((len(lengths), n_rays, len(coefficients)), np.uint16)
    present = np.zeros((len(lengths), n_rays), np.bool_)
    directions = sobol_directions(n_rays, 1, (seed, 0))
    free = _follow(walls_of(room), start, coefficients, seed, directions, lengths, hits, present)
    return FollowedRays(read_only(hits), read_only(present), free)


@kernel()
def _follow(
    walls: Walls,
    start_m: FloatArray,
    scattering: FloatArray,
    seed: int,
    directions: FloatArray,
    lengths_m: FloatArray,
    hits: IntArray,
    present: BoolArray,
) -> FloatArray:
    """Follow each ray; its count so far lives in the row of the next time to come."""
    waiting = np.empty(WAITING, np.int32)
    free = [0.0]
    for ray in range(len(directions)):
        key = ray_key(seed, 0, ray)
        d = (directions[ray, 0], directions[ray, 1], directions[ray, 2])
        o = (start_m[0], start_m[1], start_m[2])
        travelled, hit, due, last = 0.0, 0, 0, -1
        while True:
            flight, wall = next_wall(walls, o, d, last, waiting)
            while due < len(lengths_m) and travelled + flight > lengths_m[due]:
                present[due, ray] = wall >= 0
                if due + 1 < len(lengths_m):
                    for m in range(hits.shape[2]):
                        hits[due + 1, ray, m] = hits[due, ray, m]
                due += 1
            if wall < 0:
                break
            if hit > 0:
                free.append(flight)
            if due == len(lengths_m) or hit == _MAX_HITS:
                break
            travelled += flight
            o = (o[0] + flight * d[0], o[1] + flight * d[1], o[2] + flight * d[2])
            material = wall_material(walls, wall, o)
            hits[due, ray, material] += np.uint16(1)
            normal = (walls.normal[wall, 0], walls.normal[wall, 1], walls.normal[wall, 2])
            d, _ = after_wall(d, normal, scattering[material], key, hit)
            hit, last = hit + 1, wall
    return np.array(free[1:])
