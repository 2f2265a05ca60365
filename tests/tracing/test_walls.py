"""Where a ray meets one facet: a wall on its way out of the air, or a sheet from either side."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.tracing.walls import (
    ray_key,
    scattered,
    uniform,
)


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
