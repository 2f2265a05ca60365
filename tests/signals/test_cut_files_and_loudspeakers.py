"""Files that are cut while the room rings, and loudspeakers that colour what they play."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.base.bands import bands_between
from roomfit.base.errors import InputError
from roomfit.signals.filters import filter_pressure
from roomfit.signals.loudspeaker import SourceMagnitude, equalise, power_gain, source_magnitude
from roomfit.signals.noise import NoiseEstimate, estimate_noise
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


def test_noise_before_the_sound_stands_for_that_of_a_cut_file():
    """Noise 50 dB down in a file cut at -36 dB: at 2 and 4 kHz the 20 ms before tell its level."""
    late = ringing(0.32, 10.0**-2.5, 1)
    found = noise_of(late)
    alone = filter_pressure(BANDS, ringing(0.32, 0.0, 1))
    whole = filter_pressure(BANDS, late)
    noise = np.mean((whole - alone) ** 2, axis=1)
    # 16 and 33 independent values: 1.1 and 0.8 dB, three of those
    assert np.all(np.abs(10.0 * np.log10(found.floor[4:] / noise[4:])) < 3.3)


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


def test_colour_is_causal():
    """A loudspeaker of least phase plays nothing before the signal."""
    click = ImpulseResponse(np.eye(1, 8000, 2000)[0], RATE_HZ)
    played = coloured(click, COLOUR).pressure
    assert np.sum(played[:2000] ** 2) < 1e-6 * np.sum(played**2)


def test_power_is_multiplied_by_the_gain_specified():
    """A tone's power after taking colour out, against the gain at its frequency."""
    t = np.arange(16_000) / RATE_HZ
    tone = ImpulseResponse(np.sin(2 * np.pi * 700.0 * t) * np.hanning(t.size), RATE_HZ)
    ratio = np.sum(equalise(tone, COLOUR).pressure ** 2) / np.sum(tone.pressure**2)
    assert ratio == pytest.approx(power_gain(COLOUR, np.array([700.0]))[0], rel=1e-2)


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


def test_colour_is_told_every_half_octave_up_to_045_of_the_sampling_rate():
    """Both ends belong to it, where the highest is a whole number of steps above the lowest."""
    highest = 0.45 * RATE_HZ
    echo = ImpulseResponse(np.eye(1, 800).ravel(), RATE_HZ)
    for lowest, n in ((highest / 16.0, 9), (highest / 15.9, 8), (highest, 1)):
        nodes = source_magnitude([echo] * 3, [echo] * 3, [0.05] * 3, lowest, 0.0).frequencies_hz
        np.testing.assert_allclose(nodes, lowest * np.sqrt(2.0) ** np.arange(n), rtol=1e-12)


def test_chance_is_not_taken_for_colour():
    """Rooms of which the model knows nothing but the mean: what differs by chance is left alone."""
    rng = np.random.default_rng(6)
    observed, expected = (
        [ImpulseResponse(rng.standard_normal(1600), RATE_HZ) for _ in range(4)] for _ in range(2)
    )
    found = source_magnitude(observed, expected, [0.1] * 4, 62.5, 0.0)
    assert np.max(np.abs(found.level_db)) < 1.0


def test_two_responses_tell_no_colour():
    """With fewer than three nothing can be said of chance, and nothing is done."""
    rng = np.random.default_rng(7)
    two = [ImpulseResponse(rng.standard_normal(1600), RATE_HZ) for _ in range(2)]
    assert not np.any(source_magnitude(two, two[::-1], [0.1] * 2, 62.5, 0.0).level_db)


def test_of_frequencies_that_no_file_holds_no_colour_is_told():
    """Half of the rate is 8 kHz: from 16 kHz on there is no power to be compared, 0 of 0."""
    echo = ImpulseResponse(np.eye(1, 800).ravel(), RATE_HZ)
    with np.errstate(all="raise"):
        found = source_magnitude([echo] * 3, [echo] * 3, [0.05] * 3, RATE_HZ, 0.0)
    assert found.level_db.tolist() == [0.0]


def test_different_rates_are_refused():
    a, b = (ImpulseResponse(np.ones(100), rate) for rate in (8000.0, 16_000.0))
    with pytest.raises(InputError, match="sampling rate"):
        source_magnitude([a], [b], [0.1], 62.5, 0.0)
