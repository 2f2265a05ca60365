"""Paths sorted into windows and bins, windows of measured responses, and weights drawn anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import roomfit
from roomfit.base.bands import bands_between
from roomfit.fit.measurements import collect_measurements
from roomfit.materials.priors import Scattering, uniform_scattering, unknown_material
from roomfit.model.binned import BinnedPaths, bin_paths, in_band
from roomfit.model.observation import energy_terms
from roomfit.model.scattering import effective_sample_size, scattering_weights
from roomfit.model.weighing import EnergyRows, energy_rows
from roomfit.model.windows import WINDOW_DECAYS, windows_decay_s
from roomfit.room.scene import scene_of, shoebox_room
from roomfit.signals.filters import statistical_bandwidth_hz
from roomfit.tracing.image_sources import trace_images
from roomfit.tracing.paths import Paths
from small_campaign import LENGTHS_M, RATE_HZ, RECEIVERS_M, SOURCE_M, small_responses


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


@pytest.mark.parametrize("centre_hz", [63.0, 500.0, 8000.0])
def test_bins_are_a_sixteenth_of_a_period_or_a_400th_of_their_time(centre_hz):
    """Whole numbers of the finest bins of 0.1 ms, one at least, and none beyond the end."""
    edges_s = np.arange(20_001) * 1e-4
    rows = EnergyRows(
        ("w",), 20_000, np.zeros(20_001), np.zeros(0), np.zeros((0, 1)), np.zeros(0), np.zeros(0)
    )
    found = in_band(BinnedPaths(edges_s, (rows,)), centre_hz)
    assert found.edges_s[0] == 0.0 and found.edges_s[-1] == edges_s[-1]
    assert found.rows[0].n_windows == found.edges_s.size - 1
    steps = np.round(np.diff(found.edges_s) / 1e-4).astype(int)
    period = int(1.0 / (16.0 * centre_hz * 1e-4))
    wanted = np.maximum(max(period, 1), (found.edges_s[:-1] / 0.04 + 1e-9).astype(int))
    np.testing.assert_array_equal(steps[:-1], wanted[:-1])
    assert 0 < steps[-1] <= wanted[-1] and steps.max() == 49


BANDS = bands_between("octave", 500, 1000)


@pytest.fixture(scope="module")
def found():
    room = shoebox_room(LENGTHS_M, {})
    scene = scene_of(room, {"LS1": SOURCE_M}, RECEIVERS_M)
    responses = [roomfit.Measurement("LS1", n, p, RATE_HZ) for n, p in small_responses().items()]
    measured = collect_measurements(scene, responses, BANDS, {})
    paths = trace_images(scene, 20, 0.3, uniform_scattering(room.materials, 0.0))
    binned = bin_paths(scene, BANDS, paths, 0.3)
    priors = tuple(unknown_material(n, len(BANDS)) for n in room.materials)
    start = np.full(len(BANDS), 0.2)
    return [
        made[0] for made in energy_terms(scene, BANDS, priors, measured.responses, binned, start)
    ]


def test_a_window_lasts_a_tenth_of_the_time_since_the_direct_sound_or_what_the_band_resolves(found):
    """That is 1.5 over the bandwidth; the first window begins twice as much before the sound."""
    sound_m_s, at = 343.5, np.array(list(RECEIVERS_M.values()))
    direct_s = np.linalg.norm(at - SOURCE_M, axis=1) / sound_m_s
    for term, bandwidth_hz in zip(found, statistical_bandwidth_hz(BANDS), strict=True):
        least_s = 1.5 / bandwidth_hz
        assert least_s > 1e-3 and len(term.observations) == 2
        for o, own_s in zip(term.observations, direct_s, strict=True):
            edges_s = o.edges_s
            # the speed of sound is that of the room's air, within 0.3 %
            np.testing.assert_allclose(edges_s[0] + 2.0 * least_s, own_s, rtol=3e-3)
            since_s = edges_s[1:-1] - (edges_s[1] - least_s)
            wanted_s = np.maximum(least_s, 0.1 * since_s)
            np.testing.assert_allclose(np.diff(edges_s)[1:], wanted_s, rtol=1e-7)
            assert wanted_s.max() > 1.5 * least_s


def test_a_decay_time_of_windows_is_that_of_a_line_and_none_where_nothing_falls():
    """Windows of many widths of an exponential decay; energy that comes all at the end."""
    edges_s = np.cumsum(np.concatenate([[0.1], np.linspace(0.002, 0.02, 150)]))
    left = 5.0 * 10.0 ** (-6.0 * (edges_s - 0.1) / 0.7)
    energy = -np.diff(left)
    energy[-1] += left[-1]  # nothing is left after the last window
    for name in WINDOW_DECAYS:
        assert windows_decay_s(edges_s, energy, name) == pytest.approx(0.7, rel=1e-6)
    late = np.zeros(energy.size)
    late[-1] = 1.0
    assert np.isnan(windows_decay_s(edges_s, late, "EDT_s"))
    assert np.isnan(windows_decay_s(edges_s, 0.0 * energy, "EDT_s"))
