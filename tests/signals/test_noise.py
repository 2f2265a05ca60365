"""How far the beginning of a response stands above its noise."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.base.bands import bands_between
from roomfit.signals.filters import filter_pressure
from roomfit.signals.noise import (
    before_rise,
    block_length_s,
    decay_line,
    estimate_noise,
    evidence_of_noise,
    level_before,
)
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


@pytest.mark.filterwarnings("error")
def test_sound_that_begins_late_over_digital_silence_has_a_decay_or_none_but_no_infinite_one():
    """1 s at a time constant of 1 ms is a height of exp(1000), which no number holds."""
    times = (np.arange(150) + 0.5) * 0.01
    for constant_s in (0.0001, 0.001, 0.003, 0.1):
        for begins_s in (0.0, 0.3, 1.0):
            since_s = np.maximum(times - begins_s, 0.0)
            blocks = np.where(times > begins_s, np.exp(-since_s / constant_s), 0.0)
            line = decay_line(times, np.maximum(blocks, 1e-300), 1e-300, np.inf)
            if line is None:
                assert begins_s > 500.0 * constant_s
            else:
                assert np.isfinite(line).all() and begins_s < 700.0 * constant_s
                assert line[1] == pytest.approx(constant_s, rel=1e-3)
                expected = begins_s / constant_s
                assert np.log(line[0]) == pytest.approx(expected, rel=2e-3, abs=1e-3)


def test_blocks_that_do_not_fall_have_no_decay():
    """Equal ones, whose logarithms have a slope of 0 to the last digit; none at all; falling."""
    times = 0.01 * (0.5 + np.arange(8))
    assert decay_line(times, np.full(8, 1.125), 0.125, np.inf) is None
    assert decay_line(times[:0], np.zeros(0), 0.125, np.inf) is None
    line = decay_line(times, 3.0 * np.exp(-times / 0.02) + 1e-9, 1e-9, np.inf)
    np.testing.assert_allclose(line, (3.0, 0.02), rtol=1e-6)


def test_the_end_of_a_file_is_left_out_from_6_db_above_its_quietest_tenth_on():
    """Or above as much as holds 16 independent values; the file then ends with that part."""
    energy = np.ones(100)
    energy[40:50], energy[90:] = 0.5, 2.0
    assert before_rise(energy, 1e4) is energy  # just 6 dB
    energy[90:] = 2.01
    assert before_rise(energy, 1e4).size == 50
    # of four parts the quietest and first has 22.5 to 32.6 of the last: 1.6 dB
    assert before_rise(energy, 64.0) is energy
    energy[90:] = 8.0
    assert before_rise(energy, 64.0).size == 50
    assert before_rise(energy, 16.0) is energy and before_rise(energy, 8.0) is energy
    assert before_rise(energy[:9], 1e4).size == 9


def test_the_level_before_a_sound_leaves_out_the_file_s_beginning_and_what_rings_before_it():
    """One and four times the inverse bandwidth; less than eight times in between is too short."""
    energy = np.full(130, 100.0)
    energy[10:90] = np.arange(80.0)
    assert level_before(energy, 1000.0, 100.0) == 39.5
    assert level_before(energy[:-1], 1000.0, 100.0) == 0.0
    assert level_before(energy[:30], 1000.0, 100.0) == 0.0


@pytest.mark.parametrize(("late", "sign"), [(1.0, 1.0), (np.exp(-0.5), 0.0), (np.exp(-1.0), -1.0)])
def test_equal_halves_are_as_much_evidence_of_noise_as_those_of_half_the_decay_are_against_it(
    late, sign
):
    """0.2 s at 100 Hz: 20 values; half the rate of 0.05 s falls by 1 from half to half."""
    energy = 3.0 * np.concatenate([np.ones(100), np.full(100, late), [99.0]])
    assert evidence_of_noise(energy, 1000.0, 100.0, 0.05) == pytest.approx(sign * 20.0 / 8.0)
    assert evidence_of_noise(energy[:200], 1000.0, 10.0, 0.05) == pytest.approx(sign * 2.0 / 8.0)
    assert evidence_of_noise(energy[:199], 1000.0, 10.0, 0.05) == 0.0
    for silent in (slice(0, 100), slice(100, 200)):
        heard = energy.copy()
        heard[silent] = 0.0
        assert evidence_of_noise(heard, 1000.0, 100.0, 0.05) == 0.0


def test_blocks_hold_four_independent_values_and_short_files_eight_blocks():
    assert block_length_s(100.0, 10.0) == 0.04
    assert block_length_s(1000.0, 10.0) == 0.01
    assert block_length_s(10.0, 1.6) == 0.2
