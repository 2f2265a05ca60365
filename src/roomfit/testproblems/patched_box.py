"""Image sources of a box with something on one of its walls that nobody was told of.

An open door, a curtain, a window: a rectangle with an absorption of its own. A path strikes it
where its straight line, unfolded over the mirrored boxes, crosses that wall within the rectangle.
Nothing bends around its edges: a door of 2 m2 is treated as rays see it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from roomfit.errors import InputError
from roomfit.testproblems.pressure_box import WALLS, BoxTruth, box_lattice, pressure_of_images
from roomfit.typing import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """A rectangle on a wall.

    Attributes
    ----------
    wall : str
        west, east, south, north, floor or ceiling.
    lower_m, upper_m : tuples of two floats
        Opposite corners along the wall's two axes, in the order x, y, z without the wall's own.
    absorption : float array, shape (n_bands,)
        In the bands of the room's truth; 1 for an opening.
    """

    wall: str
    lower_m: tuple[float, float]
    upper_m: tuple[float, float]
    absorption: FloatArray

    def __post_init__(self) -> None:
        if self.wall not in WALLS:
            raise InputError("no such wall", found=repr(self.wall), needed=", ".join(WALLS))


def patch_area_m2(patch: Patch) -> float:
    """Return the area of a patch."""
    return float(np.prod(np.subtract(patch.upper_m, patch.lower_m)))


def patched_response(
    truth: BoxTruth,
    patch: Patch,
    source_m: FloatArray,
    receiver_m: FloatArray,
    duration_s: float,
    sampling_rate_hz: float,
    level_db: FloatArray,
) -> FloatArray:
    """Return the sound pressure at the receiver as `pressure_response` does, patch included.

    The patch takes part of its wall's hits and adds no delay.
    """
    steps, hits, _ = box_lattice(truth, source_m, receiver_m, duration_s)
    on_patch = patch_hits(truth.lengths_m, patch, receiver_m, steps)
    wall = WALLS.index(patch.wall)
    parted = np.column_stack((hits, on_patch)).astype(np.float64)
    parted[:, wall] -= on_patch
    both = replace(
        truth,
        absorption=np.vstack((truth.absorption, patch.absorption)),
        delays_s=(*truth.delays_s, 0.0),
    )
    lengths = np.asarray(np.linalg.norm(steps, axis=0), dtype=np.float64)
    return pressure_of_images((lengths, parted), both, duration_s, sampling_rate_hz, level_db)


def patch_hits(
    lengths_m: tuple[float, float, float],
    patch: Patch,
    receiver_m: FloatArray,
    steps_m: FloatArray,
) -> IntArray:
    """Return how often the path of each image strikes the patch.

    Parameters
    ----------
    lengths_m : tuple of three floats
    patch : Patch
    receiver_m : float array, shape (3,)
    steps_m : float array, shape (3, n_images)
        From the receiver to the images.

    Returns
    -------
    int array, shape (n_images,)
    """
    axis, far = divmod(WALLS.index(patch.wall), 2)
    others = [other for other in range(3) if other != axis]
    side, step = lengths_m[axis], steps_m[axis]
    count = np.zeros(step.size, dtype=np.int64)
    reach = int(np.ceil(np.abs(step).max(initial=0.0) / side)) + 2
    for plane in range(-reach, reach + 1):
        if plane % 2 != far:  # even planes are mirrors of the wall at 0, odd ones of the other
            continue
        met = np.flatnonzero(_between(receiver_m[axis], step, plane * side))
        if not met.size:
            continue
        share = (plane * side - receiver_m[axis]) / step[met]
        inside = np.ones(met.size, dtype=np.bool_)
        for k, other in enumerate(others):
            place = _folded(receiver_m[other] + share * steps_m[other, met], lengths_m[other])
            inside &= (place >= patch.lower_m[k]) & (place <= patch.upper_m[k])
        count[met[inside]] += 1
    return count


def _between(start: float, step: FloatArray, plane: float) -> BoolArray:
    """Whether lines of given steps cross a plane."""
    return np.asarray((start - plane) * (start + step - plane) < 0.0)


def _folded(place: FloatArray, length: float) -> FloatArray:
    """Return where a point of the mirrored boxes lies in the box itself."""
    within = np.mod(place, 2.0 * length)
    return np.asarray(np.where(within > length, 2.0 * length - within, within))
