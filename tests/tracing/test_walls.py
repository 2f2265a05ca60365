"""Where a ray meets one facet: a wall on its way out of the air, or a sheet from either side."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.tracing.walls import (
    _facets,
    after_wall,
    facet_distance,
    ray_key,
    scattered,
    uniform,
)

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


def split_mix_64(x: int) -> int:
    """Return the finaliser of SplitMix64 (Steele, Lea and Flood 2014), in whole numbers."""
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9 % 2**64
    x = (x ^ (x >> 27)) * 0x94D049BB133111EB % 2**64
    return x ^ (x >> 31)


def test_draws_of_a_ray_are_split_mix_64_in_steps_of_2_to_the_minus_53():
    """By the published finaliser and increment, from one key for each seed, source and ray."""
    step = 0x9E3779B97F4A7C15
    for seed, source, ray in ((0, 0, 0), (1, 2, 3), (3, 2, 1), (12345, 0, 2**40)):
        key = split_mix_64((seed + step) % 2**64)
        for number in (source, ray):
            key = split_mix_64(key ^ ((number + step) % 2**64))
        found = np.uint64(ray_key(seed, source, ray))
        assert int(found) == key
        for draw in (0, 1, 2, 1000):
            bits = split_mix_64((key + (draw + 1) * step) % 2**64)
            assert uniform(found, draw) == (bits >> 11) / 2**53


def test_walls_scatter_as_often_as_their_coefficient_says_and_by_lamberts_law():
    """Share s of 4000 hits within four standard deviations; the mean cosine of Lambert is 2/3."""
    n, d, normal = 4000, (0.6, 0.0, -0.8), (0.0, 0.0, 1.0)
    for s in (0.0, 0.3, 1.0):
        keys = [np.uint64(ray_key(5, 0, i)) for i in range(n)]
        out = [after_wall(d, normal, s, key, i % 7) for i, key in enumerate(keys)]
        diffuse = np.array([is_diffuse for _, is_diffuse in out])
        assert abs(diffuse.mean() - s) <= 4.0 * np.sqrt(s * (1.0 - s) / n)
        away = np.array([v for v, _ in out])
        np.testing.assert_allclose(np.linalg.norm(away, axis=1), 1.0, rtol=1e-12)
        np.testing.assert_allclose(away[~diffuse], np.tile((0.6, 0.0, 0.8), (sum(~diffuse), 1)))
        if s > 0.0:
            # the cosine has the variance 1/2 - (2/3)^2, and both others have none in the mean
            mean, sd = away[diffuse].mean(axis=0), np.sqrt([0.25, 0.25, 1.0 / 18.0] / diffuse.sum())
            assert np.all(np.abs(mean - (0.0, 0.0, 2.0 / 3.0)) <= 4.0 * sd)


def test_scattered_directions_are_at_their_angle_to_a_wall_of_any_tilt():
    """Unit length, the cosine sqrt(1 - u) to the normal; opposite v are mirrored about it."""
    rng = np.random.default_rng(6)
    for _ in range(200):
        normal, d = (x / np.linalg.norm(x) for x in rng.normal(size=(2, 3)))
        u, v = rng.random(2)
        given = tuple(d.tolist()), tuple(normal.tolist()), float(u)
        ways = [np.array(scattered(given[0], given[1], given[2], w)) for w in (v, v + 0.5)]
        towards = -np.sign(d @ normal) * normal
        for way in ways:
            assert np.linalg.norm(way) == pytest.approx(1.0, rel=1e-12)
            assert way @ towards == pytest.approx(np.sqrt(1.0 - u), rel=1e-9)
        np.testing.assert_allclose(sum(ways), 2.0 * np.sqrt(1.0 - u) * towards, atol=1e-12)
