"""Onsets, time zero, and recordings that are no impulse responses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import chirp, fftconvolve

from roomfit.base.errors import InputError
from roomfit.signals.decay import check_is_response
from roomfit.signals.response import (
    ImpulseResponse,
    compare_onset,
    find_onset,
    find_peak,
    same_recordings,
    time_zero_from_direct,
    times_s,
)

RATE_HZ = 48_000.0


def room(at_s: float = 0.01, decay_s: float = 0.8, noise: float = 0.0, seed: int = 1):
    """A click after `at_s`, exact between samples, then a noisy decay; and background noise."""
    rng = np.random.default_rng(seed)
    n = 48_000
    t = np.arange(n) / RATE_HZ - at_s
    f = np.fft.rfftfreq(n, 1 / RATE_HZ)
    # a click with smooth edges of its spectrum, so that it rings little
    click = np.fft.irfft(np.cos(0.5 * np.pi * f / f[-1]) ** 2 * np.exp(-2j * np.pi * f * at_s), n)
    tail = 0.05 * rng.standard_normal(n) * np.exp(-6.91 * t / decay_s) * (t > 0.002)
    pressure = click / click.max() + tail + noise * rng.standard_normal(n)
    return ImpulseResponse(pressure, RATE_HZ)


@given(at_s=st.floats(0.001, 0.1))
def test_the_onset_of_a_click_is_found_between_samples(at_s):
    """The click is sinc(x) / (1 - x^2), a tenth of its peak at x = -1.65 samples.

    The straight line between samples puts that up to half a sample beside.
    """
    onset_s = find_onset(room(at_s))
    assert -2.15 / RATE_HZ < onset_s - at_s < -1.15 / RATE_HZ


@given(at_s=st.floats(0.001, 0.1))
def test_the_peak_of_a_click_is_found_between_samples(at_s):
    """The click is sinc(x) / (1 - x^2): through three of its samples a parabola is .07 off at most.

    What rises for 40 samples begins at its onset.
    """
    response = room(at_s)
    assert find_peak(response, find_onset(response)) == pytest.approx(at_s, abs=0.1 / RATE_HZ)
    late = replace(response, pressure=-0.2 * response.pressure, time_zero_s=0.004)
    assert find_peak(late, find_onset(late)) == pytest.approx(at_s - 0.004, abs=0.1 / RATE_HZ)
    n = np.arange(4800.0)
    slow = ImpulseResponse(n * np.exp(-n / 40.0) * (n > 0), RATE_HZ)
    assert find_peak(slow, find_onset(slow)) == find_onset(slow)


@pytest.mark.parametrize(
    ("share", "least", "most"),
    [(1.0, 0.89, 5.1), (0.8, 0.89, 5.1), (0.5, 4.3, 5.5), (0.4, 6.3, 6.8)],
)
def test_a_click_that_is_cut_off_steeply_is_found_early_by_what_it_rings(share, least, most):
    """At half and below the second side lobe of a sine over its argument lies 17.8 dB down.

    It begins to exceed 20 dB at 2.7 samples over the share; nearer to the Nyquist frequency its
    samples decide, and those of a click midway between two.
    """
    f, n = np.fft.rfftfreq(4096, 1 / RATE_HZ), 4096
    early = []
    for at in 1000.0 + np.linspace(0.0, 1.0, 40, endpoint=False):
        cut = np.exp(-2j * np.pi * f * at / RATE_HZ) * (f <= share * f[-1])
        early.append(at - RATE_HZ * find_onset(ImpulseResponse(np.fft.irfft(cut, n), RATE_HZ)))
    assert least < min(early) and max(early) < most
    if share == 0.4:
        assert np.median(early) == pytest.approx(2.7 / share, rel=0.05)


def test_the_onset_moves_with_the_sound_and_not_with_the_noise():
    """Noise 34 dB below the peak: the onset moves by less than half a sample."""
    clean = find_onset(room(0.02))
    for seed in range(20):
        assert find_onset(room(0.02, noise=0.02, seed=seed)) == pytest.approx(
            clean, abs=0.5 / RATE_HZ
        )


def test_loudness_offset_and_sign_do_not_move_the_onset():
    response = room(0.02)
    onset_s = find_onset(response)
    for pressure in (1e-6 * response.pressure, -3.0 * response.pressure, response.pressure + 0.3):
        assert find_onset(ImpulseResponse(pressure, RATE_HZ)) == pytest.approx(onset_s, abs=1e-6)


def test_time_zero_is_set_so_that_the_direct_sound_arrives_on_time():
    moved = time_zero_from_direct(room(0.05), travel_s=0.0123)
    assert find_onset(moved) == pytest.approx(0.0123, abs=1e-12)
    assert compare_onset(find_onset(moved), 0.0123, 343.0, "x", RATE_HZ) == ()


def recorded(method: str, decay_s: float) -> ImpulseResponse:
    """A sweep or noise of 3 s, as a microphone hears it in a room."""
    n = 144_000
    t = np.arange(n) / RATE_HZ
    excitation = {
        "logarithmic": chirp(t, 20.0, 3.0, 20_000.0, method="logarithmic"),
        "linear": chirp(t, 20.0, 3.0, 20_000.0, method="linear"),
        "noise": np.random.default_rng(8).standard_normal(n),
    }[method]
    observed = fftconvolve(excitation, room(0.01, decay_s).pressure)
    return ImpulseResponse(np.pad(observed, (20_000, 10_000)), RATE_HZ)


@pytest.mark.parametrize("decay_s", [0.3, 2.0])
@pytest.mark.parametrize("method", ["logarithmic", "linear", "noise"])
def test_the_raw_recording_of_an_excitation_is_refused(method, decay_s):
    with pytest.raises(InputError, match="recording of the excitation") as caught:
        check_is_response(recorded(method, decay_s), "LS1 to MP1")
    assert "excitation = " in str(caught.value)


@pytest.mark.parametrize("decay_s", [0.05, 0.3, 1.0, 6.0])
def test_responses_of_dry_and_reverberant_rooms_are_taken(decay_s):
    for seed in range(5):
        check_is_response(room(0.01, decay_s, noise=1e-3, seed=seed))
    # without any direct sound, and with a single echo
    rng = np.random.default_rng(4)
    n = 48_000
    diffuse = rng.standard_normal(n) * np.exp(-6.91 * np.arange(n) / RATE_HZ / decay_s)
    check_is_response(ImpulseResponse(diffuse, RATE_HZ))
    echo = np.zeros(n)
    echo[[100, 400]] = 1.0, 0.9
    check_is_response(ImpulseResponse(echo, RATE_HZ))


@pytest.mark.parametrize("level", [0.1, 1.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_response_with_hum_is_a_response(level, seed):
    """Three lines of the mains, together 20 dB below the peak of the response, and as loud."""
    clean = room(0.01, 0.5, noise=1e-3, seed=seed)
    t = times_s(clean)
    hum = sum(a * np.sin(2 * np.pi * f * t) for f, a in ((50.0, 0.5), (100.0, 0.2), (150.0, 0.3)))
    check_is_response(ImpulseResponse(clean.pressure + level * hum, RATE_HZ))


def test_a_copy_is_found_scaled_shifted_and_cut_and_a_repetition_is_none():
    """A repetition of the same decay has noise of its own, here 54 dB below the peak."""
    first = room(0.01, 0.5, noise=1e-3, seed=1).pressure
    decay = room(0.01, 0.5, seed=1).pressure
    again = decay + 1e-3 * np.random.default_rng(9).standard_normal(decay.size)
    other = room(0.01, 0.5, noise=1e-3, seed=2).pressure
    copies = [-3.0 * first, np.concatenate((np.zeros(500), first)), first[:40_000]]
    assert same_recordings([first, again, other, np.zeros(100)]) == ()
    assert same_recordings([other, first, *copies]) == ((1, 2), (1, 3), (1, 4))
    coarse = np.round(first * 2.0**15) / 2.0**15
    assert same_recordings([first, coarse]) == ((0, 1),)
