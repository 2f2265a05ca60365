"""Blocks of seats absorb with a strip along free edges: closed forms, walls, aisles, refusals."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.base.errors import InputError
from roomfit.base.polygon import Face, Surface
from roomfit.room.audience import audience_area_m2
from roomfit.room.build import build_mesh
from roomfit.room.mesh import Mesh, shoebox_mesh
from roomfit.tracing.enclosure import reached

HALL = shoebox_mesh((20.0, 12.0, 8.0))
BLOCK = [(5, 3), (15, 3), (15, 9), (5, 9)]


def outline(corners, z=0.0):
    return np.array([(x, y, z) for x, y in corners], dtype=np.float64)


def turned(corners, degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return [(10 + c * (x - 10) - s * (y - 6), 6 + s * (x - 10) + c * (y - 6)) for x, y in corners]


@pytest.mark.parametrize("degrees", [0.0, 30.0, 90.0])
@pytest.mark.parametrize("sense", [1, -1])
def test_a_block_that_stands_free_has_a_strip_all_around(degrees, sense):
    """(L + 2 e) (W + 2 e), whichever way it lies and its corners run."""
    own, whole = audience_area_m2(HALL, [outline(turned(BLOCK, degrees)[::sense])], 0.5)
    assert own == pytest.approx(60.0, rel=1e-12)
    assert whole == pytest.approx(11.0 * 7.0, rel=1e-9)
    assert audience_area_m2(HALL, [outline(BLOCK)], 0.0)[1] == pytest.approx(60.0, rel=1e-12)


def test_no_strip_lies_where_a_block_stands_at_a_wall():
    """In a corner of the hall, then 0.2 m from one wall: the strip there is 0.2 m wide."""
    corner = outline([(0, 0), (10, 0), (10, 6), (0, 6)])
    assert audience_area_m2(HALL, [corner], 0.5)[1] == pytest.approx(10.5 * 6.5, rel=1e-9)
    near = outline([(0, 0.2), (10, 0.2), (10, 6.2), (0, 6.2)])
    assert audience_area_m2(HALL, [near], 0.5)[1] == pytest.approx(10.5 * 6.7, rel=1e-9)


def test_the_aisle_between_two_blocks_counts_once():
    """0.6 m wide and 6 m long: half of it to each block, all of it absorbs."""
    left = outline([(2, 3), (8, 3), (8, 9), (2, 9)])
    right = outline([(8.6, 3), (14.6, 3), (14.6, 9), (8.6, 9)])
    both = audience_area_m2(HALL, [left, right], 0.5)[1]
    assert both == pytest.approx(13.6 * 7.0, rel=1e-9)
    far = right + np.array([2.0, 0.0, 0.0])
    assert audience_area_m2(HALL, [left, far], 0.5)[1] == pytest.approx(2 * 7.0 * 7.0, rel=1e-9)


def test_strips_overlap_in_the_notch_of_a_block():
    """An L: area, strip along all of its edges, five corners out and one in."""
    ell = outline([(4, 2), (14, 2), (14, 5), (9, 5), (9, 9), (4, 9)])
    own, whole = audience_area_m2(HALL, [ell], 0.5)
    assert own == pytest.approx(50.0, rel=1e-12)
    assert whole == pytest.approx(50.0 + 0.5 * 34.0 + 4 * 0.25, rel=1e-9)


def test_a_wedge_has_its_strip_cut_where_its_sides_would_meet():
    """A triangle of sides of 6 m moved outwards by e: the area of the larger one."""
    height = 3.0 * np.sqrt(3.0)
    wedge = outline([(7, 3), (13, 3), (10, 3 + height)])
    side = 6.0 + 2.0 * np.sqrt(3.0) * 0.5
    expected = np.sqrt(3.0) / 4.0 * side**2
    assert audience_area_m2(HALL, [wedge], 0.5)[1] == pytest.approx(expected, rel=1e-9)


def test_a_raised_block_ends_at_the_walls_of_its_own_height():
    """On a platform 1 m high, whose own front is no wall to those who sit on it."""
    raised = outline(BLOCK, 1.0)
    assert audience_area_m2(HALL, [raised], 0.5)[1] == pytest.approx(77.0, rel=1e-9)


def hall_with_a_block(height_m: float) -> Mesh:
    """Return the hall with a solid of 10 x 6 m that stands on the floor."""
    low = [(0, 0), (20, 0), (20, 12), (0, 12)]
    walls = outline(low), outline(low, 8.0)
    foot, top = outline(BLOCK), outline(BLOCK, height_m)
    corners = np.concatenate([*walls, foot, top])
    around = [
        (0, 1, 2, 3),
        (4, 5, 6, 7),
        *((k, (k + 1) % 4, 4 + (k + 1) % 4, 4 + k) for k in range(4)),
    ]
    solid = [
        (12, 13, 14, 15),
        *((8 + k, 8 + (k + 1) % 4, 12 + (k + 1) % 4, 12 + k) for k in range(4)),
    ]
    # the floor around the foot
    floor = [(0, 1, 9, 8), (1, 2, 10, 9), (2, 3, 11, 10), (3, 0, 8, 11)]
    faces = [Face(c, Surface("seats")) for c in solid]
    faces += [Face(c, Surface("hall")) for c in [*around[1:], *floor]]
    return reached(build_mesh(corners, faces)[0])[0]


@pytest.mark.parametrize(
    ("mesh", "corners", "words"),
    [
        (hall_with_a_block(0.8), outline(BLOCK), r"no air(.|\n)*drawn as a solid"),
        (HALL, outline([(x + 8, y) for x, y in BLOCK]), "no air"),
        (HALL, outline([(5, 3), (15, 9), (15, 3), (5, 9)]), "no area|crosses itself"),
        (HALL, outline([(5, 3), (15, 3), (10, 3)]), "no area"),
        (HALL, outline([*BLOCK, BLOCK[0]]), "stands twice"),
        (HALL, np.array([(5.0, 3, 0), (15, 3, 0), (15, 3, 2), (5, 3, 2)]), "stands upright"),
    ],
)
def test_outlines_that_are_no_block_in_the_air_are_refused(mesh, corners, words):
    with pytest.raises(InputError, match=words):
        audience_area_m2(mesh, [corners], 0.5)
