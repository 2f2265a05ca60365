"""Powers of responses about frequencies, from emission to a time after it."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.signals.loudspeaker import _powers
from roomfit.signals.response import ImpulseResponse

RATE_HZ = 8000
NODES_HZ = 125.0 * 2.0 ** (np.arange(10) / 3.0)


def impulses(*at_s: float, begins_s: float = 0.0) -> ImpulseResponse:
    """Return unit impulses at times after emission in a file that begins that much before it."""
    pressure = np.zeros(int((0.8 + begins_s) * RATE_HZ))
    for t in at_s:
        pressure[round((t + begins_s) * RATE_HZ)] = 1.0
    return ImpulseResponse(pressure, RATE_HZ, begins_s)


@pytest.mark.parametrize("begins_s", [0.0, 0.25])
def test_an_impulse_has_power_one_at_all_frequencies_wherever_its_file_begins(begins_s):
    """One after the end does not count, and every response has an end of its own."""
    responses = [impulses(0.01, 0.5, begins_s=begins_s), impulses(0.3, begins_s=begins_s)]
    found = _powers(responses, [0.2, 0.4], NODES_HZ)
    np.testing.assert_allclose(found, 1.0, rtol=1e-9)
    (silent,) = _powers([impulses(0.3, begins_s=begins_s)], [0.2], NODES_HZ)
    assert np.all(silent <= 1e-300)


def test_two_impulses_a_millisecond_apart_have_the_comb_of_their_distance():
    """4 cos^2(pi f t), averaged over half an octave either way, equal octaves alike."""
    (found,) = _powers([impulses(0.01, 0.011)], [0.5], NODES_HZ)
    octaves = np.linspace(-0.5, 0.5, 20_001)
    weight = np.cos(np.pi * octaves) ** 2
    f = NODES_HZ[:, None] * 2.0**octaves
    wanted = np.average(4.0 * np.cos(np.pi * f * 0.001) ** 2, axis=1, weights=weight)
    np.testing.assert_allclose(found, wanted, atol=0.02)
    assert np.ptp(wanted) > 2.0


def test_a_response_fades_over_ten_milliseconds_before_its_end():
    """An impulse in the middle of the fade has half its pressure, a quarter of its power."""
    (found,) = _powers([impulses(0.195)], [0.2], NODES_HZ)
    np.testing.assert_allclose(found, 0.25, rtol=1e-6)
