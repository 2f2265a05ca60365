"""Paths sorted into windows, and weighed anew for another scattering."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roomfit.materials.priors import Scattering
from roomfit.model.scattering import effective_sample_size, scattering_weights
from roomfit.model.weighing import energy_rows
from roomfit.tracing.paths import Paths


def random_paths(seed: int, n: int = 500, sampling: tuple[float, ...] = (0.3, 0.6)) -> Paths:
    """Return paths of three pairs with every column drawn at random."""
    rng = np.random.default_rng(seed)
    m = len(sampling)
    return Paths(
        3,
        tuple(f"material {i}" for i in range(m)),
        rng.integers(0, 3, n).astype(np.int32),
        rng.uniform(0.0, 50.0, n),
        rng.random(n),
        rng.poisson(1.0, (n, m)).astype(np.uint16),
        rng.poisson(1.0, (n, m)).astype(np.uint16),
        np.zeros((n, 3), dtype=np.float32),
        np.zeros((n, 3), dtype=np.float32),
        rng.integers(-1, 4, n).astype(np.int32),
        4,
        np.array([sampling]),
    )


def test_every_path_of_the_pair_stands_in_the_window_of_its_time() -> None:
    """Written out path by path, the order of paths kept within a window."""
    paths = random_paths(1)
    edges, c = np.array([0.01, 0.02, 0.05, 0.051, 0.1]), 340.0
    rows = energy_rows(paths, 1, edges, c)
    for w in range(4):
        expected = [
            i
            for i in range(len(paths))
            if paths.pair[i] == 1 and edges[w] <= paths.length_m[i] / c < edges[w + 1]
        ]
        own = slice(rows.offsets[w], rows.offsets[w + 1])
        np.testing.assert_array_equal(rows.length_m[own], paths.length_m[expected])
        np.testing.assert_array_equal(rows.weight_per_m2[own], paths.weight_per_m2[expected])
        np.testing.assert_array_equal(
            rows.hits[own], (paths.hits_specular + paths.hits_diffuse)[expected]
        )
        np.testing.assert_array_equal(rows.batch[own], paths.batch[expected])
    assert rows.n_batches == 4


def test_a_time_on_an_edge_belongs_to_the_later_window() -> None:
    """So that neighbouring windows never share a path."""
    paths = random_paths(2, n=1)
    paths = replace(paths, pair=np.zeros(1, dtype=np.int32), length_m=np.array([10.0]))
    rows = energy_rows(paths, 0, np.array([0.0, 0.1, 0.2]), 100.0)
    assert np.diff(rows.offsets).tolist() == [0, 1]


def test_the_factor_is_the_ratio_of_the_probabilities() -> None:
    """Hit by hit."""
    paths = random_paths(4)
    s0, s = (0.3, 0.6), (0.1, 0.9)
    expected = np.ones(len(paths))
    for i, m in np.ndindex(paths.hits_diffuse.shape):
        for _ in range(paths.hits_diffuse[i, m]):
            expected[i] *= s[m] / s0[m]
        for _ in range(paths.hits_specular[i, m]):
            expected[i] *= (1.0 - s[m]) / (1.0 - s0[m])
    factor = scattering_weights(paths, Scattering(paths.materials, np.array(s)))
    np.testing.assert_allclose(factor, expected, rtol=1e-13)  # some 10 factors rounded once each


def test_the_mean_factor_of_drawn_hits_is_one() -> None:
    """Importance sampling: 40,000 paths of three hits drawn at s0 = 0.4, weighed for s = 0.3.

    Standard error of the mean 0.001; four of it, false alarms once in 16,000 seeds.
    """
    rng = np.random.default_rng(9)
    n = 40_000
    paths = random_paths(9, n=n, sampling=(0.4,))
    diffuse = rng.binomial(3, 0.4, (n, 1)).astype(np.uint16)
    paths = replace(paths, hits_diffuse=diffuse, hits_specular=3 - diffuse)
    factor = scattering_weights(paths, Scattering(paths.materials, np.array([0.3])))
    error = np.std(factor) / np.sqrt(n)
    assert abs(np.mean(factor) - 1.0) < 4.0 * error
    # Kish: n / (1 + var f), and 1 + var f = (s**2 / s0 + (1 - s)**2 / (1 - s0))**3
    second = (0.3**2 / 0.4 + 0.7**2 / 0.6) ** 3
    np.testing.assert_allclose(effective_sample_size(factor), n / second, rtol=0.01)
