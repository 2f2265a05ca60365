"""Powers of responses about frequencies, from emission to a time after it."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.signals.loudspeaker import _powers, source_magnitude
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


def colour_of(gains: np.ndarray, schroeder_hz: float = 0.0) -> np.ndarray:
    """Return the level of a source whose responses add an echo of 1 ms of so much each."""
    flat = [impulses(0.01)] * len(gains)
    echoes = [impulses(0.01).pressure + g * impulses(0.011).pressure for g in gains]
    heard = [ImpulseResponse(p, RATE_HZ) for p in echoes]
    found = source_magnitude(heard, flat, [0.5] * len(gains), 125.0, schroeder_hz)
    np.testing.assert_allclose(found.frequencies_hz, 125.0 * 2.0 ** (0.5 * np.arange(10)))
    return found.level_db


def power_db(gain: float) -> np.ndarray:
    """Return 1 + g^2 + 2 g cos(2 pi f 1 ms) in dB, averaged over half an octave either way."""
    nodes_hz = 125.0 * 2.0 ** (0.5 * np.arange(10))
    (found,) = _powers(
        [ImpulseResponse(impulses(0.01).pressure + gain * impulses(0.011).pressure, RATE_HZ)],
        [0.5],
        nodes_hz,
    )
    return 10.0 * np.log10(found)


def test_the_level_is_that_of_all_responses_where_they_agree():
    """About its mean; a fourth-order fade takes half of it away where single modes decide."""
    wanted = power_db(0.6) - power_db(0.6).mean()
    np.testing.assert_allclose(colour_of(np.full(3, 0.6)), wanted, atol=1e-6)
    faded = colour_of(np.full(4, 0.6), schroeder_hz=250.0)
    share = 1.0 / (1.0 + 16.0 * 2.0 ** (-2.0 * np.arange(10)))
    assert share[2] == 0.5
    np.testing.assert_allclose(faded, share * wanted, atol=1e-6)
    assert not np.any(colour_of(np.full(2, 0.6)))
    # an rms of 1 dB is the least that counts
    rms = {g: float(np.std(power_db(g))) for g in (0.19, 0.2, 0.21, 0.22, 0.23, 0.24, 0.25)}
    assert min(rms.values()) < 1.0 < max(rms.values())
    for gain, of_all in rms.items():
        assert np.any(colour_of(np.full(3, gain))) == (of_all >= 1.0)


def test_the_level_is_shrunk_by_how_much_responses_disagree():
    """Towards zero about a mean of weights by precision; twice the chance of it counts for none."""
    gains = np.array([0.3, 0.6, 0.9, 0.5])
    each = np.stack([power_db(g) for g in gains])
    level = 10.0 * np.log10(np.mean(10.0 ** (0.1 * each), axis=0))
    chance = np.sum((each - each.mean(axis=0)) ** 2, axis=0) / (4 * 3)
    level -= np.sum(level / chance) / np.sum(1.0 / chance)
    real = np.mean(level**2) - 2.0 * np.mean(chance)
    np.testing.assert_allclose(colour_of(gains), level * real / (real + chance), atol=1e-9)
