"""How far the beginning of a response stands above its noise."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.bands import bands_between
from roomfit.signals.filters import filter_pressure
from roomfit.signals.noise import estimate_noise
from roomfit.signals.response import ImpulseResponse

BANDS = bands_between("octave", 500, 2000)
RATE_HZ = 16000


@pytest.mark.parametrize("floor_db", [-30.0, -45.0, -60.0])
def test_the_peak_to_noise_ratio_is_that_of_the_powers_of_decay_and_noise(floor_db):
    """White noise that decays by 60 dB in 1 s, over white noise as far below its beginning.

    The highest block lies above the mean power by its scatter, and the mean of a block below its
    beginning: 3 dB either way, in three bands.
    """
    rng = np.random.default_rng(11)
    time_s = np.arange(int(1.5 * RATE_HZ)) / RATE_HZ
    decay = rng.normal(size=time_s.size) * 10.0 ** (-3.0 * np.maximum(time_s - 0.05, 0.0))
    noise = 10.0 ** (floor_db / 20.0) * rng.normal(size=time_s.size)
    response = ImpulseResponse(np.where(time_s < 0.05, 0.0, decay) + noise, RATE_HZ)
    found = estimate_noise(BANDS, response, filter_pressure(BANDS, response), 0.05)
    np.testing.assert_allclose(found.peak_to_noise_db, -floor_db, atol=3.0)
