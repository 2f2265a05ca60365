"""How pairs that have not been measured yet will be fitted: noise, unknowns and rays."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from roomfit.air import Air, speed_of_sound_m_s
from roomfit.bands import Bands
from roomfit.inversion.expected import (
    ExpectedFit,
    _band_filters,
    _expected_noise,
    _geometry,
    _late_images,
    _unit_gain,
    _with_fewer_rays,
)
from roomfit.materials.priors import uniform_scattering, unknown_material
from roomfit.objective.observation import absorption_block
from roomfit.response.energy import EnergyRows
from roomfit.scene import scene_of, shoebox_room
from roomfit.settings import Settings
from roomfit.signals.filters import statistical_bandwidth_hz
from roomfit.tracing.paths import TraceSettings
from roomfit.tracing.trace import trace

BANDS = Bands("octave", np.array([500.0, 1000.0, 2000.0]))
SCENE = scene_of(
    shoebox_room((4.0, 3.0, 2.5), "wall"),
    {"S": (1.0, 1.0, 1.0), "T": (2.0, 1.0, 1.0)},
    {"P": (3.0, 2.0, 1.0), "R": (3.0, 1.0, 1.5), "Q": (1.0, 2.0, 1.0)},
    [("S", "P"), ("T", "P"), ("T", "Q"), ("T", "R")],
)
PRIOR = unknown_material("wall", 3)


def decay(constant_s: float, n: int = 4000) -> tuple[np.ndarray, EnergyRows]:
    """Return edges of windows of 1 ms, and rows of one path each whose energy falls by exp."""
    edges_s = np.arange(n + 1) * 1e-3
    weight = np.exp(-edges_s[:-1] / constant_s)
    rows = EnergyRows(
        ("wall",), n, np.arange(n + 1), weight, np.zeros((n, 1)), edges_s[:-1], np.full(n, -1)
    )
    return edges_s, rows


@pytest.mark.parametrize(("range_db", "constant_s"), [(30.0, 0.1), (50.0, 0.05), (4.0, 0.1)])
def test_noise_stands_where_the_decay_has_fallen_by_its_range(range_db, constant_s):
    """Of an exponential: the usable end 4 dB before, and its power over 1 s; air takes its part.

    Edges of windows of 1 ms; a range of less than the first 5 dB is read over one window.
    """
    edges_s, rows = decay(constant_s)
    for air_per_m in (0.0, 2.0):
        band: Any = SimpleNamespace(attenuation_per_m=air_per_m)
        own_s = 1.0 / (1.0 / constant_s + air_per_m)  # `length_m` of a row is its time here
        end_s, noise_per_s = _expected_noise(
            band, edges_s, rows, absorption_block((PRIOR,), 0, 0.2), range_db
        )
        fallen_s = own_s * range_db * np.log(10.0) / 10.0
        at = int(np.ceil(fallen_s / 1e-3 - 1e-9)) * 1e-3
        assert end_s == pytest.approx(at - np.log(2.5) * own_s, rel=1e-6)
        whole = 1.0 / (1.0 - np.exp(-1e-3 / own_s))
        assert noise_per_s == pytest.approx(whole * 10.0 ** (-0.1 * range_db) / own_s, rel=1e-6)


def test_a_trace_that_ends_early_is_read_to_its_last_window():
    edges_s, rows = decay(0.1, 100)
    band: Any = SimpleNamespace(attenuation_per_m=0.0)
    block = absorption_block((PRIOR,), 0, 0.2)
    end_s, noise_per_s = _expected_noise(band, edges_s, rows, block, 60.0)
    # energy left from the edges at 99 ms and where 5 dB are gone, of a decay that ends at 100 ms
    left = np.exp(-edges_s / 0.1) - np.exp(-1.0)
    early = int(np.argmax(left <= left[0] * 10.0**-0.5))
    constant_s = (edges_s[99] - edges_s[early]) / np.log(left[early] / left[99])
    assert end_s == pytest.approx(0.099 - np.log(2.5) * constant_s, rel=1e-9)
    whole = left[0] / (1.0 - np.exp(-0.01))
    assert noise_per_s == pytest.approx(whole * 1e-6 / constant_s, rel=1e-9)


def test_arrival_times_of_a_pair_are_uncertain_as_the_settings_say():
    """Six coordinates, the speed, the latency; and the delay of each material, where it is free."""
    late = unknown_material("late", 3)
    for settings, is_free, delays_free in (
        (Settings(), True, Settings().reflection_delays),
        (Settings(positions="fixed"), False, Settings(positions="fixed").reflection_delays),
    ):
        found = _geometry(SCENE, (PRIOR, late), 0.02, settings)
        assert found.labels[:8] == (
            *("source x", "source y", "source z", "receiver x", "receiver y", "receiver z"),
            *("speed", "latency"),
        )
        assert found.labels[8:] == ("delay wall", "delay late")
        np.testing.assert_array_equal(found.sd[:6], 0.02)
        assert np.all(found.sd[6:8] > 0.0) and bool(np.all(found.sd[8:] > 0.0)) == delays_free
        assert found.fitted.tolist() == 8 * [is_free] + 2 * [delays_free]
        assert found.speed_m_s == speed_of_sound_m_s(Air())
        assert found.columns.tolist() == [list(range(10))]
    fit: Any = SimpleNamespace(geometry=_geometry(SCENE, (PRIOR, late), 0.0, Settings()))
    shared = ExpectedFit.shared.fget(fit)
    assert shared.tolist() == [True, False] + 2 * [True] * Settings().reflection_delays


@pytest.mark.parametrize("radius_m", [0.2, 0.5])
def test_all_receivers_of_a_source_catch_four_million_rays_at_most(radius_m):
    """By the mean number of crossings of a sphere; two thousand rays are the least."""
    for n_rays in (1000, 10**8):
        for duration_s in (0.1, 1e5):
            settings = TraceSettings(min(duration_s, 100.0), n_rays, receiver_radius_m=radius_m)
            found = _with_fewer_rays(settings, SCENE)
            length_m = settings.duration_s * speed_of_sound_m_s(Air())
            caught = found.n_rays * np.pi * radius_m**2 * length_m / 30.0 * 3
            if found.n_rays not in (n_rays, 2000):
                assert caught == pytest.approx(4e6, rel=1e-3)
            assert found.n_rays == n_rays or caught <= 4e6 * (1.0 + 1e-9) or found.n_rays == 2000
            affordable = 4e6 * found.n_rays / caught
            assert found.n_rays == min(n_rays, max(int(affordable * (1.0 + 1e-12)), 2000))


def test_each_band_has_the_bandwidth_of_its_own_filter_and_a_level_without_a_prior():
    found = _band_filters(BANDS, np.array([0.1, 0.2, 0.3]))
    assert [(f.band, f.centre_hz, f.attenuation_per_m) for f in found] == [
        *((0, 500.0, 0.1), (1, 1000.0, 0.2), (2, 2000.0, 0.3)),
    ]
    np.testing.assert_allclose([f.bandwidth_hz for f in found], statistical_bandwidth_hz(BANDS))
    gain = _unit_gain()
    assert (gain.name, gain.labels, gain.transform) == ("gain", ("level",), "log")
    assert gain.start.tolist() == [1.0] and gain.fitted.tolist() == [True]
    assert np.isinf(gain.prior_sd).all() and gain.prior_mean.tolist() == [0.0]


def test_late_images_of_one_pair_stand_for_those_of_all(monkeypatch):
    """Every n-th of so many that their energy stays; rays need none."""
    monkeypatch.setattr("roomfit.inversion.expected._LATE_IMAGES", 500)
    settings = TraceSettings(0.25, 0, 1000)
    smooth = uniform_scattering(("wall",), 0.0)
    plan: Any = SimpleNamespace(settings=settings, scattering=smooth)
    fit: Any = SimpleNamespace(scene=SCENE, plan=plan, bands=BANDS)
    early, late = _late_images(fit)
    own = scene_of(SCENE.room, SCENE.sources[:1], SCENE.receivers[:1])
    every = trace(own, settings, plan.scattering).paths
    far = every.length_m > early.duration_s * speed_of_sound_m_s(Air())
    assert early.duration_s == pytest.approx(0.2 + 2.0 * 4.0 / 500.0)
    n = int(far.sum()) // 500
    assert n > 2
    np.testing.assert_array_equal(late.length_m, every.length_m[far][::n])
    share = late.weight_per_m2 / every.weight_per_m2[far][::n]
    np.testing.assert_allclose(share, far.sum() / len(late))
    assert share[0] == pytest.approx(n, rel=0.01)
    plan.settings = TraceSettings(0.25, 1000, 1)
    assert _late_images(fit) == (plan.settings, None)
    plan.settings = TraceSettings(0.02, 0, 1000)
    early, late = _late_images(fit)
    assert early.duration_s == 0.02 and len(late) == 0
