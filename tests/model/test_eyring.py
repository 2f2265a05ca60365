"""Decay of a diffuse field: Eyring's formula and its inverse."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roomfit.model.eyring import eyring_absorption, eyring_time_s


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
