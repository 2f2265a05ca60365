"""Planes of a beam, and polygons cut by them: which points are inside, and what area is left."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.tracing.beam_clipping import ROWS, clip, sides, without_repeats

APEX = (0.0, 0.0, -2.0)
SQUARE = np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0]])


def rows_of(polygon: np.ndarray) -> np.ndarray:
    filled = np.zeros((ROWS, 3))
    filled[: len(polygon)] = polygon
    return filled


def beam(opening: np.ndarray) -> np.ndarray:
    """Return the planes of the beam from the apex through an opening at z = 0, upwards."""
    planes = np.zeros((ROWS + 1, 4))
    n = sides(APEX, rows_of(opening), len(opening), (0.0, 0.0, -1.0), 0.0, planes, 1e-6)
    return planes[:n]


@pytest.mark.parametrize("turned", range(4))
@pytest.mark.parametrize("way", [1, -1])
def test_the_planes_of_a_beam_hold_what_its_opening_shows(turned, way):
    """A pyramid: one plane an edge and that of the opening, whichever corner comes first.

    At height z it reaches to |x|, |y| = (z + 2) / 2.
    """
    planes = beam(np.roll(SQUARE, turned, axis=0)[::way])
    assert planes.shape == (5, 4)
    np.testing.assert_allclose(np.linalg.norm(planes[:, :3], axis=1), 1.0, rtol=1e-12)
    rng = np.random.default_rng(turned)
    points = rng.uniform((-4.0, -4.0, -1.0), (4.0, 4.0, 4.0), (2000, 3))
    inside = np.all(points @ planes[:, :3].T >= planes[:, 3], axis=1)
    reach = 0.5 * (points[:, 2] + 2.0)
    wanted = (points[:, 2] >= 0.0) & np.all(np.abs(points[:, :2]) <= reach[:, None], axis=1)
    np.testing.assert_array_equal(inside, wanted)
    assert 100 < inside.sum() < 1900


def area_m2(polygon: np.ndarray) -> float:
    x, y = polygon[:, 0], polygon[:, 1]
    return abs(0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)))


@pytest.mark.parametrize(
    ("half_m", "at_m", "wanted_m2"),
    [
        (0.5, 0.0, 1.0),  # within the beam
        (10.0, 0.0, 16.0),  # wider than the beam, 4 m across at z = 2
        (1.0, 2.0, 2.0),  # half of it beyond one side
        (1.0, 9.0, 0.0),
    ],
)
def test_a_wall_in_a_beam_keeps_the_part_that_is_lit(half_m, at_m, wanted_m2):
    """Squares at z = 2, along x; a corner of the beam cuts the second to the beam's own."""
    planes = np.zeros((ROWS + 1, 4))
    planes[:5] = beam(SQUARE)
    wall = rows_of(SQUARE * half_m + (at_m, 0.0, 2.0))
    n = clip(wall, 4, planes, 0, 5, 0.0, np.zeros((ROWS, 3)))
    assert area_m2(wall[:n]) == pytest.approx(wanted_m2, abs=1e-9)
    assert n == (4 if wanted_m2 else 0)


def test_only_the_planes_that_are_named_cut():
    planes = np.zeros((ROWS + 1, 4))
    planes[:5] = beam(SQUARE)
    wall = rows_of(SQUARE * 10.0 + (0.0, 0.0, 2.0))
    assert clip(wall, 4, planes, 0, 1, 0.0, np.zeros((ROWS, 3))) == 4
    assert area_m2(wall[:4]) == pytest.approx(400.0)
    below = rows_of(SQUARE - (0.0, 0.0, 0.1))
    assert clip(below, 4, planes, 0, 1, 0.0, np.zeros((ROWS, 3))) == 0
    assert clip(below, 4, planes, 0, 1, -0.2, np.zeros((ROWS, 3))) == 4


@pytest.mark.parametrize("repeated", range(4))
@pytest.mark.parametrize(("off_m", "stays"), [(0.0, 4), (0.9e-8, 4), (1.1e-8, 5)])
def test_corners_that_stand_where_the_one_before_stands_are_dropped(repeated, off_m, stays):
    """The first of both stays, with the last before the first; a hundredth of the margin apart."""
    polygon = np.insert(SQUARE, repeated + 1, SQUARE[repeated] + (0.0, 0.0, off_m), axis=0)
    rows = rows_of(polygon)
    assert without_repeats(rows, 5, 1e-6) == stays
    np.testing.assert_array_equal(rows[:stays], SQUARE if stays == 4 else polygon)
    # by a distance that counts as one place, where that is more
    assert without_repeats(rows_of(polygon), 5, 1e-6, 1e-4) == 4


@pytest.mark.parametrize("times", [(2, 2), (1, 3), (4,), (1, 1, 1)])
def test_a_polygon_of_fewer_than_three_corners_is_none(times):
    polygon = np.repeat(SQUARE[: len(times)], times, axis=0)
    assert without_repeats(rows_of(polygon), len(polygon), 1e-6) == (3 if len(times) == 3 else 0)
