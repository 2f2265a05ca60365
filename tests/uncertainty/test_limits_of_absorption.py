"""Means, bounds and draws of absorption stay within 0 to 1; deviations count in their own sd."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roomfit.base.air import Air
from roomfit.base.bands import bands_between
from roomfit.base.errors import InputError
from roomfit.predict.changes import Change, changed_draws
from roomfit.pressures.geometry import prior_speed_sd
from roomfit.settings import Settings
from roomfit.uncertainty.posterior import AbsorptionPosterior

BANDS = bands_between("octave", 500, 1000)


def test_draws_of_a_factor_stay_between_0_and_1():
    a = np.array([[0.6, 0.9], [0.3, 0.2]])
    covariance = np.stack([0.04 * np.eye(2)] * 2)
    bounds = (0.8 * a, np.minimum(1.1 * a, 1.0))
    known = AbsorptionPosterior(("walls", "floor"), BANDS, a, *bounds, covariance)
    rng = np.random.default_rng(7)
    draws = np.clip(a + 0.05 * rng.standard_normal((200, 2, 2)), 0.01, 0.99)
    change = Change("walls", "factor", (1.5,), (0.8,))
    absorption, drawn, findings = changed_draws(known, draws, (change,), rng)
    np.testing.assert_allclose(absorption, [[0.9, 1.0], [0.3, 0.2]])
    assert drawn.min() == 0.0 and drawn.max() == 1.0  # a factor of -1 and of 3 are drawn
    np.testing.assert_array_equal(drawn[:, 1], draws[:, 1])
    assert [f.about.bands_hz for f in findings] == [(1000.0,)]


# What enters a fit.


def test_the_air_is_known_as_well_as_its_temperature_is():
    """c goes as the root of the temperature: 2 K of 293.15 K are 0.34 %."""
    air, usual = Air(temperature_c=20.0), Settings()
    assert prior_speed_sd(air, usual) == usual.speed_of_sound_sd
    found = prior_speed_sd(air, replace(usual, temperature_sd_c=2.0))
    assert found == pytest.approx(0.5 * 2.0 / 293.15, rel=1e-3)
    assert prior_speed_sd(air, replace(usual, temperature_sd_c=0.0)) == 1e-6


@pytest.mark.parametrize("name", ["absorption", "lower95", "upper95", "draws"])
@pytest.mark.parametrize("value", [-0.01, 1.01])
def test_absorption_outside_0_to_1_is_refused_wherever_it_is_stated(name, value):
    bands = bands_between("octave", 500, 1000)
    given = {n: np.full((1, 2), 0.5) for n in ("absorption", "lower95", "upper95")}
    given |= {"logit_covariance": np.full((2, 1, 1), 0.1), "draws": np.full((8, 1, 2), 0.5)}
    assert AbsorptionPosterior(("wall",), bands, **given).draws.shape == (8, 1, 2)
    given[name] = np.where(np.arange(given[name].size) == 1, value, 0.5).reshape(given[name].shape)
    with pytest.raises(InputError, match="absorption" if name == "absorption" else name):
        AbsorptionPosterior(("wall",), bands, **given)
