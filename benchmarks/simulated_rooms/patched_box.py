"""Boxes with a patch on one wall that the campaign does not specify."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray, IntArray
from roomfit.demo.boxes import (
    DURATION_S,
    NOISE_DB,
    SAMPLING_RATE_HZ,
    WALLS,
    BoxPlan,
    SyntheticBox,
    add_noise,
    box_lattice,
    pressure_of_images,
    pressure_response,
    true_box,
    write_box_campaign,
)


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """A rectangle on a wall with an absorption of its own, such as an open door or a curtain.

    A path strikes it where its straight line, continued over the mirrored boxes, crosses that wall
    within the rectangle. There is no diffraction at its edges.
    """

    wall: str  # west, east, south, north, floor or ceiling
    lower_m: tuple[float, float]  # along the wall's two axes, in the order x, y, z
    upper_m: tuple[float, float]  # the opposite corner
    absorption: FloatArray  # (n_bands,), in the bands of the box; 1 for an opening

    def __post_init__(self) -> None:
        if self.wall not in WALLS:
            raise InputError("no such wall", found=repr(self.wall), needed=", ".join(WALLS))


def patch_area_m2(patch: Patch) -> float:
    """Return the area of a patch."""
    return float(np.prod(np.subtract(patch.upper_m, patch.lower_m)))


def patched_response(
    synthetic: SyntheticBox,
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
    steps, hits, _ = box_lattice(synthetic, source_m, receiver_m, duration_s)
    images, both = parted_hits(synthetic, patch, receiver_m, steps, hits)
    return pressure_of_images(images, both, duration_s, sampling_rate_hz, level_db)


def parted_hits(
    synthetic: SyntheticBox,
    patch: Patch,
    receiver_m: FloatArray,
    steps_m: FloatArray,
    hits: FloatArray,
) -> tuple[tuple[FloatArray, FloatArray], SyntheticBox]:
    """Return lengths and hits of the images of `box_lattice`, and their walls with the patch last.

    Hits have the shape (n_images, 7).
    """
    on_patch = patch_hits(synthetic.lengths_m, patch, receiver_m, steps_m)
    parted = np.column_stack((hits, on_patch)).astype(np.float64)
    parted[:, WALLS.index(patch.wall)] -= on_patch
    both = replace(
        synthetic,
        absorption=np.vstack((synthetic.absorption, patch.absorption)),
        delays_s=(*synthetic.delays_s, 0.0),
    )
    lengths = np.asarray(np.linalg.norm(steps_m, axis=0), dtype=np.float64)
    return (lengths, parted), both


def patch_hits(
    lengths_m: tuple[float, float, float], patch: Patch, receiver_m: FloatArray, steps_m: FloatArray
) -> IntArray:
    """Return how often the path of each image strikes the patch, shape (n_images,).

    Parameters
    ----------
    receiver_m : float array, shape (3,)
    steps_m : float array, shape (3, n_images)
        From the receiver to the images.
    """
    axis, far = divmod(WALLS.index(patch.wall), 2)
    others = [other for other in range(3) if other != axis]
    side, step = lengths_m[axis], steps_m[axis]
    count = np.zeros(step.size, dtype=np.int64)
    reach = int(np.ceil(np.abs(step).max(initial=0.0) / side)) + 2
    for plane in range(-reach, reach + 1):
        if plane % 2 != far:  # even planes are mirrors of the wall at 0, odd ones of the other
            continue
        from_plane = receiver_m[axis] - plane * side
        beyond = receiver_m[axis] + step - plane * side
        met = np.flatnonzero(from_plane * beyond < 0.0)
        if not met.size:
            continue
        share = (plane * side - receiver_m[axis]) / step[met]
        inside = np.ones(met.size, dtype=np.bool_)
        for k, other in enumerate(others):
            length = lengths_m[other]
            # folded from the mirrored boxes into the box itself
            within = np.mod(receiver_m[other] + share * steps_m[other, met], 2.0 * length)
            place = np.where(within > length, 2.0 * length - within, within)
            inside &= (place >= patch.lower_m[k]) & (place <= patch.upper_m[k])
        count[met[inside]] += 1
    return count


def write_patched_box(
    plan: BoxPlan,
    patch: Patch | None,
    folder: Path,
    rng: np.random.Generator,
    position_error_m: float,
) -> Path:
    """Do what `write_measured_box` does, with a patch on a wall and positions as wrong as asked."""
    synthetic, true_at = true_box(plan, position_error_m, rng)
    levels_db = {s: rng.normal(0.0, 3.0, synthetic.centres_hz.size) for s in plan.sources_m}
    responses = {}
    for s, r in [(s, r) for s in plan.sources_m for r in plan.receivers_m]:
        ends = (true_at[s], true_at[r], DURATION_S, SAMPLING_RATE_HZ, levels_db[s])
        pressure = (
            pressure_response(synthetic, *ends)
            if patch is None
            else patched_response(synthetic, patch, *ends)
        )
        responses[s, r] = add_noise(pressure, NOISE_DB, rng)
    return write_box_campaign(plan, folder, responses, position_error_m=position_error_m)
