"""What was measured beside what is predicted: speech at the levels of the pair itself."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import roomfit
from roomfit.bands import bands_between
from roomfit.prediction.tables import ObservedPair, _interval, with_sti
from roomfit.signals.decay import echogram_decay_curve
from roomfit.signals.iso3382 import VALUE_NAMES
from roomfit.signals.speech import speech_transmission

OCTAVES = bands_between("octave", 125, 8000)
NOTHING = np.full((len(VALUE_NAMES), 7), np.nan)


def observed(receiver: str, decay_s: float | None) -> ObservedPair:
    curve = None
    if decay_s is not None:
        edges_s = 1e-3 * np.arange(2001)
        energy = -np.diff(10.0 ** (-6.0 * edges_s / decay_s))
        curve = echogram_decay_curve(OCTAVES, np.tile(energy, (7, 1)), edges_s, 0.0)
    return ObservedPair("S", receiver, "fit", NOTHING, 0.0 * NOTHING, curve)


def test_speech_is_heard_at_the_level_that_is_predicted_of_its_own_pair():
    """Of two receivers the one where G is 30 dB lower hears noise; a table has no response.

    Without levels a decay of 0.5 s gives the index of its closed form.
    """
    scene = roomfit.scene_of(
        roomfit.shoebox_room((6.0, 5.0, 3.0), {}),
        {"S": (1.5, 1.2, 1.5)},
        {"near": (2.0, 3.5, 1.2), "far": (5.0, 4.0, 1.2)},
    )
    numbers = [
        SimpleNamespace(values=np.vstack([NOTHING[:-1], np.full(7, strength_db)]))
        for strength_db in (10.0, -20.0)
    ]
    pairs = [observed("far", 0.5), observed("near", 0.5), observed("near", None)]
    speech_db = np.stack([np.full(7, 60.0), np.full(7, 35.0)])
    far, near, table = with_sti(scene, OCTAVES, pairs, numbers, speech_db)
    modulations_hz = 10.0 ** (np.arange(-2, 12) / 10.0)
    exact = 1.0 / np.sqrt(1.0 + (2.0 * np.pi * modulations_hz * 0.5 / np.log(1e6)) ** 2)
    quiet = float(speech_transmission(np.tile(exact, (7, 1))))
    # speech of 70 dB masks itself a little
    assert quiet - 0.06 < near.sti < quiet
    assert far.sti < near.sti - 0.2
    assert np.isnan(table.sti) and (far.receiver, near.receiver) == ("far", "near")
    # without levels both places are alike
    levels = [o.sti for o in with_sti(scene, OCTAVES, pairs[:2], numbers, None)]
    assert levels[0] == pytest.approx(levels[1]) and levels[0] == pytest.approx(quiet, abs=0.01)
    few = bands_between("octave", 250, 4000)
    assert with_sti(scene, few, pairs, numbers, None) == tuple(pairs)


@pytest.mark.parametrize(
    ("name", "least", "most"),
    [
        ("STI", 0.0, 1.0),
        ("D50_percent", 0.0, 100.0),
        ("C80_dB", -np.inf, np.inf),
    ],
)
def test_an_interval_holds_its_estimate_and_ends_where_a_parameter_must(name, least, most):
    """Of draws about both ends: noise of a standard deviation 3 widens a normal law of 4 to 5."""
    rng = np.random.default_rng(4)
    for middle in (0.0, 1.0, 100.0):
        draws = middle + 4.0 * rng.standard_normal((40_000, 1))
        low, high = _interval(name, np.array([middle]), draws, np.array([3.0]))
        ends = middle - 1.96 * 5.0, middle + 1.96 * 5.0
        # the quantile of 40,000 normal draws has a standard deviation of 0.013 of theirs
        assert low == pytest.approx(np.clip(ends[0], least, most), abs=0.3)
        assert high == pytest.approx(np.clip(ends[1], least, most), abs=0.3)
    low, high = _interval(name, np.array([0.9]), np.full((9, 1), 0.5), np.zeros(1))
    assert (low[0], high[0]) == (0.5, 0.9)


def test_decay_times_are_widened_by_factors_and_never_end_at_zero():
    """A law of .3 in logarithms and a relative rest of .4, whose logarithm has sqrt(ln 1.16)."""
    draws = np.exp(0.3 * np.random.default_rng(4).standard_normal((40_000, 1)))
    low, high = _interval("T20_s", np.array([1.0]), draws, np.array([0.4]))
    sd = np.hypot(0.3, np.sqrt(np.log(1.16)))
    np.testing.assert_allclose(np.log([low[0], high[0]]), [-1.96 * sd, 1.96 * sd], atol=0.02)
    low, high = _interval("EDT_s", np.array([0.9]), np.full((9, 1), 0.5), np.zeros(1))
    assert (low[0], high[0]) == (0.5, 0.9)
