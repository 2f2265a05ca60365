"""Noise of recordings that windows and gates leave their traces in."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from roomfit.checks.noise import band_passed


@pytest.mark.parametrize("rate_hz", [8000.0, 44_100.0])
def test_noise_is_sought_through_causal_filters_of_scipy(rate_hz):
    """To rounding, and nothing comes before the sound."""
    x = np.zeros(3001)
    x[1000:] = np.random.default_rng(2).standard_normal(2001)
    peer = sosfilt(butter(4, 500.0, btype="high", fs=rate_hz, output="sos"), x)
    peer = sosfilt(butter(8, 0.25 * rate_hz, fs=rate_hz, output="sos"), peer)
    found = band_passed(x, 500.0, 0.25 * rate_hz, rate_hz)
    np.testing.assert_allclose(found, peer, atol=1e-11)
    assert np.abs(found[:1000]).max() < 1e-11
