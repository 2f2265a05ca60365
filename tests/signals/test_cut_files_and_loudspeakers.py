"""Files that are cut while the room rings, and loudspeakers that colour what they play."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.base.bands import bands_between
from roomfit.signals.filters import filter_pressure
from roomfit.signals.loudspeaker import SourceMagnitude, equalise, power_gain, source_magnitude
from roomfit.signals.noise import NoiseEstimate, decay_line, estimate_noise
from roomfit.signals.response import ImpulseResponse

RATE_HZ = 16_000.0
DECAY_S = 0.5
BANDS = bands_between("octave", 125, 4000)


def ringing(length_s: float, noise: float, seed: int) -> ImpulseResponse:
    """Return noise that falls by 60 dB in half a second from 20 ms on, in steady noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(length_s * RATE_HZ)) / RATE_HZ
    falling = np.where(t < 0.02, 0.0, np.exp(-6.0 * np.log(10.0) / DECAY_S * 0.5 * (t - 0.02)))
    return ImpulseResponse(
        rng.standard_normal(t.size) * falling + noise * rng.standard_normal(t.size), RATE_HZ
    )


def noise_of(response: ImpulseResponse) -> NoiseEstimate:
    return estimate_noise(BANDS, response, filter_pressure(BANDS, response), 0.02)


@pytest.mark.parametrize("seed", range(4))
def test_a_decay_that_is_cut_is_not_taken_for_noise(seed):
    """30 dB down at the cut, steady noise 70 dB down: the floor is far below the end of the file.

    The end of the file lies 36 dB below the beginning; a floor below a tenth of that cannot be the
    decay itself. Seeds fixed; 80 others passed as well.
    """
    found = noise_of(ringing(0.32, 10.0**-3.5, seed))
    share = filter_pressure(BANDS, ringing(0.32, 0.0, seed))[:, -800:]
    assert np.mean(found.reached) <= 1 / 6
    low = found.floor < 0.1 * np.mean(share**2, axis=1)
    assert np.mean(low) >= 5 / 6


@pytest.mark.parametrize("seed", range(4))
def test_noise_that_follows_a_decay_is_found(seed):
    """A second of steady noise 40 dB down: its level within 1.5 dB from 500 Hz up, and reached.

    At 500 Hz the file's last half second holds 190 independent values, 0.3 dB: five of those.
    """
    found = noise_of(ringing(1.0, 0.01, seed))
    alone = filter_pressure(
        BANDS, ImpulseResponse(ringing(1.0, 0.01, seed).pressure[8000:], RATE_HZ)
    )
    assert found.reached.all()
    level = 10.0 * np.log10(found.floor / np.mean(alone[:, 1000:-1000] ** 2, axis=1))
    assert np.all(np.abs(level[2:]) < 1.5)


def coloured(response: ImpulseResponse, colour: SourceMagnitude) -> ImpulseResponse:
    """Return what a loudspeaker of a colour would play: the inverse of taking it out."""
    return equalise(response, SourceMagnitude(colour.frequencies_hz, -colour.level_db))


COLOUR = SourceMagnitude(
    62.5 * 2.0 ** np.arange(0, 7), np.array([-3.0, 4.0, -1.0, 2.0, -4.0, 3.0, -1.0])
)


def test_taking_colour_out_undoes_it():
    """A click coloured and uncoloured is the click again, to 1e-4 of its height."""
    click = ImpulseResponse(np.eye(1, 8000, 2000)[0], RATE_HZ, 0.1)
    back = equalise(coloured(click, COLOUR), COLOUR)
    np.testing.assert_allclose(back.pressure, click.pressure, atol=1e-4)
    assert back.time_zero_s == click.time_zero_s


def test_colour_is_heard_beside_what_the_room_does():
    """Eight rooms of random echoes: the common colour is found within 1.5 dB from 250 Hz on.

    The echoes are known, so that only the octave-wide average blurs the corners of the colour:
    by about a dB where the colour turns by 6 dB within an octave.
    """
    rng = np.random.default_rng(5)
    rooms = []
    for _ in range(8):
        p = np.zeros(4000)
        p[320:] = rng.standard_normal(3680) * np.exp(-np.arange(3680) / 800.0)
        rooms.append(ImpulseResponse(p, RATE_HZ))
    observed = [coloured(r, COLOUR) for r in rooms]
    found = source_magnitude(observed, rooms, [0.2] * 8, 62.5, 0.0)
    f = 62.5 * 2.0 ** np.arange(2, 6)
    want = -10.0 * np.log10(power_gain(COLOUR, f))
    got = -10.0 * np.log10(power_gain(found, f))
    np.testing.assert_allclose(got - got.mean(), want - want.mean(), atol=1.5)


def test_chance_is_not_taken_for_colour():
    """Rooms of which the model knows nothing but the mean: what differs by chance is left alone."""
    rng = np.random.default_rng(6)
    observed, expected = (
        [ImpulseResponse(rng.standard_normal(1600), RATE_HZ) for _ in range(4)] for _ in range(2)
    )
    found = source_magnitude(observed, expected, [0.1] * 4, 62.5, 0.0)
    assert np.max(np.abs(found.level_db)) < 1.0


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
