"""Windows of measured responses, as wide as the filter of their band resolves."""

from __future__ import annotations

import numpy as np
import pytest

import roomfit
from roomfit.base.bands import bands_between
from roomfit.fit.measurements import collect_measurements
from roomfit.materials.priors import uniform_scattering, unknown_material
from roomfit.model.binned import bin_paths
from roomfit.model.observation import energy_terms
from roomfit.model.windows import WINDOW_DECAYS, windows_decay_s
from roomfit.room.scene import scene_of, shoebox_room
from roomfit.signals.filters import statistical_bandwidth_hz
from roomfit.tracing.image_sources import trace_images
from small_campaign import LENGTHS_M, RATE_HZ, RECEIVERS_M, SOURCE_M, small_responses

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
