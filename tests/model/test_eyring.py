"""Decay of a diffuse field: its rate from windows, Eyring's formula and its inverse."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from roomfit.base.logit import Z95, expit, logit
from roomfit.model.eyring import decay_rate_per_s, eyring_absorption, eyring_time_s, schroeder_hz


def windows(rates: tuple[float, ...], step_s: float, until_s: float) -> tuple[np.ndarray, ...]:
    """Return energies and edges of an infinite decay, each rate for a third of the time."""
    edges_s = np.arange(0.0, until_s + 1e-9, step_s)
    rate = np.array(rates)[np.minimum((3 * edges_s[:-1] / until_s).astype(int), len(rates) - 1)]
    left = np.exp(-np.concatenate(([0.0], np.cumsum(rate * step_s))))
    return np.append(-np.diff(left)[:-1], left[-2]), edges_s


def test_the_rate_is_the_slope_between_5_and_25_db_below_the_whole_energy():
    """What comes before and later does not count, both ends do."""
    energy, edges_s = windows((20.0,), 0.01, 1.0)
    assert decay_rate_per_s(energy, edges_s) == pytest.approx(20.0, rel=1e-9)
    # steps of 5 dB: five levels from -5 to -25 are read, one before and one behind are not
    left = 10.0 ** (-0.1 * np.array([0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 90.0]))
    left = left * np.array([1.0, 1 - 1e-9, 1.0, 1.0, 1.0, 1 + 1e-9, 1.0])
    energy = np.append(-np.diff(left), left[-1])
    rate = np.log(10.0) * 0.5 / 0.1
    assert decay_rate_per_s(energy, 0.1 * np.arange(8)) == pytest.approx(rate, rel=1e-6)


def test_a_decay_of_few_windows_is_read_over_all_of_them():
    """Two of them between 5 and 25 dB are too few; one alone has no rate, nor does growth."""
    left = np.array([1.0, 0.9, 0.1, 0.05])
    energy = np.append(-np.diff(left), left[-1])
    slope = np.polyfit(0.1 * np.arange(4), np.log(left), 1)[0]
    assert decay_rate_per_s(energy, 0.1 * np.arange(5)) == pytest.approx(-slope, rel=1e-12)
    two = decay_rate_per_s(np.array([0.75, 0.25]), np.array([0.0, 0.1, 0.2]))
    assert two == pytest.approx(np.log(4.0) / 0.1, rel=1e-12)
    assert decay_rate_per_s(np.array([1.0]), np.array([0.0, 0.1])) == 0.0
    assert decay_rate_per_s(np.array([1.0, 0.0, 0.0]), 0.1 * np.arange(4)) == 0.0
    assert decay_rate_per_s(np.array([0.0, 1.0]), 0.1 * np.arange(3)) == 0.0


@given(st.floats(0.025, 0.97), st.floats(10.0, 1e5), st.floats(0.0, 0.02))
def test_eyrings_time_and_absorption_are_inverse(absorption, volume_m3, air_per_m):
    """By the formula written out, with air; and kept within what a search can move from."""
    surface_m2 = 6.0 * volume_m3 ** (2 / 3)
    room = (volume_m3, surface_m2, 340.0)
    time_s = float(eyring_time_s(np.array(absorption), *room, np.array(air_per_m)))
    lost_m2 = 4.0 * air_per_m * volume_m3 - surface_m2 * np.log(1.0 - absorption)
    assert time_s == pytest.approx(24.0 * np.log(10.0) * volume_m3 / (340.0 * lost_m2), rel=1e-12)
    found = eyring_absorption(6.0 * np.log(10.0) / time_s, *room, air_per_m)
    assert found == pytest.approx(absorption, rel=1e-9)
    assert eyring_absorption(0.0, *room) == 0.02 and eyring_absorption(1e6, *room) == 0.98


def test_a_black_room_counts_as_one_of_999_thousandths():
    black, nearly = (
        eyring_time_s(np.array(a), 30.0, 60.0, 340.0, np.array(0.0)) for a in (1.0, 0.999)
    )
    assert black == nearly < eyring_time_s(np.array(0.998), 30.0, 60.0, 340.0, np.array(0.0))
    assert float(schroeder_hz(np.array(4.0), 100.0)) == pytest.approx(400.0)


def test_the_logit_is_kept_away_from_its_ends_by_a_millionth_unless_told_otherwise():
    ends = logit(np.array([0.0, 1.0, 0.5, 1e-6, 0.2]))
    np.testing.assert_allclose(ends[:2], np.log(1e6) * np.array([-1.0, 1.0]), rtol=1e-6)
    assert ends[2] == 0.0 and ends[3] == ends[0]
    np.testing.assert_allclose(logit(np.array([0.0, 0.25]), 0.1), [-np.log(9.0), -np.log(3.0)])
    x = np.linspace(-20.0, 12.0, 33)
    np.testing.assert_allclose(logit(expit(x), 0.0), x, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(expit(np.array([-800.0, 800.0])), [0.0, 1.0])
    assert pytest.approx(float(norm.ppf(0.975)), rel=1e-12) == Z95
