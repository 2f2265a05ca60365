"""Decay of a diffuse field: Eyring's formula and its inverse."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from roomfit.base.logit import Z95, expit, logit
from roomfit.model.eyring import eyring_absorption, eyring_time_s, schroeder_hz


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


@given(absorption=st.floats(0.03, 0.97), m=st.floats(0.0, 0.05))
def test_eyrings_rate_gives_eyrings_absorption_back(absorption: float, m: float) -> None:
    """T = 55.26 V / (c (4 m V - S ln(1 - a))), the textbook form, to its four digits."""
    volume, surface, c = 622.5, 464.6, 341.0
    t60 = 55.26 * volume / (c * (4.0 * m * volume - surface * np.log1p(-absorption)))
    found = eyring_absorption(6.0 * np.log(10.0) / t60, volume, surface, c, m)
    assert found == pytest.approx(absorption, rel=1e-3)
    # and the same formula solved for the time
    time_s = eyring_time_s(np.array(absorption), volume, surface, c, np.array(m))
    assert time_s == pytest.approx(t60, rel=1e-4)
