"""How far the beginning of a response stands above its noise."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.bands import bands_between
from roomfit.signals.filters import filter_pressure
from roomfit.signals.noise import (
    _BandDecay,
    _judged,
    _masked_from_s,
    _short_decay,
    block_length_s,
    decay_line,
    estimate_noise,
)
from roomfit.signals.response import (
    ImpulseResponse,
    before_rise,
    evidence_of_noise,
    level_before,
)

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


def test_sound_is_masked_from_where_the_mean_of_what_follows_is_twice_the_noise():
    blocks = np.array([0.1, 16.0, 9.0, 3.0, 2.0, 1.0, 2.5, 1.0])
    times = 0.1 * np.arange(8)
    wanted = next(t for i, t in enumerate(times) if blocks[i:].mean() < 2.0)
    assert _masked_from_s(times, blocks, 1.0) == wanted


def test_a_short_decay_runs_from_its_loudest_block_to_twice_the_noise():
    """Noise is the floor, or the median where it is louder; 12 dB above it is loud enough."""
    times = 0.01 * (0.5 + np.arange(9))
    blocks = np.array([1.0, 1.0, 32.0, 12.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    for floor, noise in ((0.25, 1.0), (2.0, 2.0)):
        height, constant_s = _short_decay(times, blocks, floor)
        drowned_s = _masked_from_s(times, blocks, noise)
        assert drowned_s > times[2]
        assert height * np.exp(-times[2] / constant_s) == pytest.approx(32.0)
        assert height * np.exp(-drowned_s / constant_s) == pytest.approx(2.0 * noise)
    assert _short_decay(times, blocks, 2.01) is None
    late = np.array([1.0] * 8 + [16.0])  # louder than all before it to its end
    assert _short_decay(times, late, 1.0) is None


def judged(of_all: float, **given: object) -> tuple[float, ...]:
    """Return what is told of 1 s that falls from 1 by 0.1 s, of blocks of 0.1 s."""
    times = 0.05 + 0.1 * np.arange(10)
    own: dict[str, object] = {
        "spreading_s": 0.02,
        "length_s": 1.0,
        "times": times,
        "blocks": np.exp(-times / 0.1) + 1e-3,
        "line": (1.0, 0.1),
        "crossing_s": 0.1 * np.log(1e3),
        "evidence": 1.0,
    }
    return _judged(_BandDecay(1e-3, 5e-4, **(own | given)), of_all)


def test_the_end_of_a_file_is_judged_by_its_band_or_where_that_is_undecided_by_all():
    """Where it is noise the decay ends at their crossing; where it is cut or still falls, before.

    The tail is the rest of the exponential from there.
    """
    peak_db = 10.0 * np.log10((np.exp(-0.5) + 1e-3) / 1e-3)
    crossing_s = 0.1 * np.log(1e3)
    noise = (1e-3, True, crossing_s, 0.1 * 1e-3, 0.1, peak_db)
    for evidence, alone in ((4.1, 1.0), (4.1, -2.0), (-9.0, 2.1), (4.1, 2.0)):
        assert judged(evidence, evidence=alone) == pytest.approx(noise)
    for evidence, alone in ((4.0, 2.0), (9.0, -2.1)):
        floor, reached, end_s, tail, constant_s, peak = judged(evidence, evidence=alone)
        assert (floor, reached, peak) == (5e-4, False, pytest.approx(peak_db))
        assert end_s == pytest.approx(crossing_s - 0.1 * np.log(2.0))
        used = 0.05 + 0.1 * np.arange(6)
        line = decay_line(used, np.exp(-used / 0.1) + 1e-3, 1e-300, np.inf)
        assert constant_s == line[1] != 0.1
        assert tail == pytest.approx(line[0] * line[1] * np.exp(-end_s / line[1]))
    cut = judged(9.0, crossing_s=0.9)
    assert cut == pytest.approx((5e-4, False, 0.98, 0.1 * np.exp(-9.8), 0.1, peak_db))
    flutter = judged(-9.0, crossing_s=0.9, levels_out=True)
    assert flutter[:2] == (1e-3, True) and flutter[2] == pytest.approx(0.65)
    early = judged(-9.0, crossing_s=0.01, evidence=-3.0)
    assert early[2] == 0.05
    assert judged(9.0, line=None) == (1e-3, True, 0.0, 0.0, 0.0, 0.0)
    assert judged(9.0, line=None, length_s=0.0)[:2] == (1e-3, False)
