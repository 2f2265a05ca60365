"""Boxes with something on a wall that nobody specified."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roomfit.demo.boxes import WALLS, SyntheticBox, box_lattice, pressure_response
from simulated_rooms.patched_box import Patch, patch_hits, patched_response

LENGTHS = (5.2, 4.1, 2.9)
SOURCE, RECEIVER = np.array([1.1, 2.7, 1.3]), np.array([4.0, 1.2, 1.9])
BANDS = 500.0 * 2.0 ** np.arange(2)


def truth(absorption: float = 0.2) -> SyntheticBox:
    return SyntheticBox(LENGTHS, BANDS, np.full((6, 2), absorption), np.zeros(2), 340.0)


def whole(wall: str, absorption: float) -> Patch:
    others = [n for axis, n in enumerate(LENGTHS) if axis != WALLS.index(wall) // 2]
    return Patch(wall, (0.0, 0.0), (others[0], others[1]), np.full(2, absorption))


@pytest.mark.parametrize("wall", WALLS)
def test_a_patch_as_large_as_its_wall_is_the_wall(wall):
    """Every hit of the wall is one of the patch, so that the wall's own absorption is nothing."""
    other = replace(truth(), absorption=np.array([[0.6 if w == wall else 0.2] * 2 for w in WALLS]))
    expected = pressure_response(other, SOURCE, RECEIVER, 0.05, 16_000.0, np.zeros(2))
    found = patched_response(
        truth(), whole(wall, 0.6), SOURCE, RECEIVER, 0.05, 16_000.0, np.zeros(2)
    )
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


def bounced(direction, length_m, patch):
    """Return hits of a patch by a ball that is followed from wall to wall."""
    place, course = RECEIVER.astype(float), direction / np.linalg.norm(direction)
    left, count = length_m, 0
    axis_of, far = divmod(WALLS.index(patch.wall), 2)
    others = [i for i in range(3) if i != axis_of]
    while True:
        with np.errstate(divide="ignore"):
            gap = np.where(course > 0, np.array(LENGTHS) - place, place) / np.abs(course)
        axis = int(np.argmin(gap))
        if gap[axis] >= left:
            return count
        place, left = place + gap[axis] * course, left - gap[axis]
        if axis == axis_of and (course[axis] > 0) == bool(far):
            inside = [
                patch.lower_m[k] <= place[i] <= patch.upper_m[k] for k, i in enumerate(others)
            ]
            count += all(inside)
        place[axis] = LENGTHS[axis] if course[axis] > 0 else 0.0
        course[axis] *= -1.0


@pytest.mark.parametrize("wall", ["west", "north", "ceiling"])
def test_hits_of_a_patch_are_those_of_a_ball_that_bounces_about(wall):
    """The unfolded straight line against a ball followed from the receiver, wall by wall."""
    patch = Patch(wall, (0.4, 0.7), (2.3, 2.2), np.ones(2))
    steps, _, _ = box_lattice(truth(), SOURCE, RECEIVER, 0.06)
    chosen = np.arange(0, steps.shape[1], 7)
    found = patch_hits(LENGTHS, patch, RECEIVER, steps)[chosen]
    expected = [bounced(steps[:, i], float(np.linalg.norm(steps[:, i])), patch) for i in chosen]
    assert found.sum() >= 10
    np.testing.assert_array_equal(found, expected)
