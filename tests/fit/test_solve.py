"""What the settings of a user become in a fit of pressures."""

from __future__ import annotations

import pytest

import roomfit
from roomfit.fit import solve
from roomfit.settings import Settings


def test_the_speed_of_sound_is_as_uncertain_as_the_settings_or_the_temperature_say():
    air = roomfit.Air(temperature_c=20.0)
    assert solve.prior_speed_sd(air, Settings(speed_of_sound_sd=0.02)) == 0.02
    found = solve.prior_speed_sd(air, Settings(temperature_sd_c=2.0))
    assert found == pytest.approx(2.0 / (2.0 * 293.15))
    assert solve.prior_speed_sd(air, Settings(temperature_sd_c=0.0)) == 1e-6
