"""Where a ray meets one facet: a wall on its way out of the air, or a sheet from either side."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.tracing.walls import _facets, facet_distance

NONE = (0.0, 0.0, 0.0)
UP = (0.0, 0.0, 1.0)


def distance(o, d, left=NONE, *, sheet=False, triangle=False, limit=10.0) -> float:
    """Return that to a unit square in the plane z = 0, or half of it, whose normal points up."""
    first, second, third = (np.array([p]) for p in ((0.0, 0, 0), (1.0, 0, 0), (0.0, 1, 0)))
    flags = np.array([triangle]), np.array([sheet])
    table = _facets(first, second, third, *flags, np.zeros(1, dtype=np.int64)).table
    way = np.array(d, dtype=np.float64) / np.linalg.norm(d)
    return facet_distance(table, 0, tuple(map(float, o)), tuple(way.tolist()), left, limit)


@pytest.mark.parametrize("sheet", [False, True])
@pytest.mark.parametrize("d", [(0.0, 0, 1), (0.2, 0.1, 1), (0.3, -0.2, 0.4)])
def test_a_facet_is_met_where_the_ray_crosses_its_plane(sheet, d):
    """From both sides, by the third coordinate of the way."""
    for side in (1.0, -1.0):
        at = np.array([0.45, 0.4, 0.0])
        way = np.array(d) * (1.0, 1.0, side)
        wanted = 0.5 * np.linalg.norm(d) / d[2]
        start = at - wanted * way / np.linalg.norm(d)
        assert distance(start, way, sheet=sheet) == pytest.approx(wanted, rel=1e-12)
        assert distance(start, way, sheet=sheet, limit=0.99 * wanted) == np.inf
        assert distance(start, -way, sheet=sheet) == np.inf


@pytest.mark.parametrize("d", [(0.0, 0, 1), (0.6, 0.2, 0.3)])
@pytest.mark.parametrize(
    ("height_m", "left", "sheet", "wanted"),
    [
        (5e-10, NONE, False, 0.0),  # rounding has put the start a little behind the wall
        (5e-10, NONE, True, np.inf),  # a sheet is met only from clear of it
        (1e-6, NONE, False, np.inf),  # the start is outside
        (5e-10, UP, False, np.inf),  # it has just left this very plane
        (5e-10, (1.0, 0.0, 0.0), False, 0.0),  # it has left another wall, at their edge
    ],
)
def test_a_wall_is_met_from_a_little_behind_it_unless_it_was_just_left(
    d, height_m, left, sheet, wanted
):
    assert distance((0.3, 0.3, height_m), d, left, sheet=sheet) == wanted


def test_from_behind_a_facet_is_met_only_from_clear_of_its_plane():
    assert distance((0.3, 0.3, 1e-6), (0.0, 0, -1)) == pytest.approx(1e-6)
    assert distance((0.3, 0.3, 5e-10), (0.0, 0, -1)) == np.inf


def test_a_triangle_is_half_of_its_parallelogram():
    """With 2,000 points on a square of twice its size."""
    rng = np.random.default_rng(1)
    for x, y in rng.uniform(-0.5, 1.5, (2000, 2)):
        square, triangle = (
            distance((x, y, -1.0), (0.0, 0, 1), triangle=t) < np.inf for t in (False, True)
        )
        assert square == (0.0 <= x <= 1.0 and 0.0 <= y <= 1.0)
        assert triangle == (square and x + y <= 1.0)
