"""Measuring with sweeps: what is played, the response that comes out, and whether it suffices."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, fftconvolve, sosfiltfilt

from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray
from roomfit.cli.measure import measure_to_folder
from roomfit.files.responses import read_response
from roomfit.files.responses.sweep import (
    SweepPlan,
    excitation,
    response_from_recording,
    response_name,
    sweep,
)
from roomfit.files.schema import ResponseSpec
from roomfit.files.sound_card import SoundCard
from small_campaign import run_command

PLAN = SweepPlan(seconds=2.0, silence_s=1.5, repetitions=3)
RATE_HZ = round(PLAN.sampling_rate_hz)
LATE = 2345  # samples by which the devices delay the sound


def room(decay_s: float = 0.4) -> FloatArray:
    """Return a response: a direct sound 20 dB above a decay of noise."""
    t = np.arange(round(1.2 * RATE_HZ)) / RATE_HZ
    h = 0.002 * np.random.default_rng(1).normal(size=len(t)) * 10.0 ** (-3.0 * t / decay_s)
    h[:100], h[100] = 0.0, 0.02
    return h


def recording(
    plan: SweepPlan = PLAN, response: FloatArray | None = None, noise: float = 1e-5
) -> FloatArray:
    """Return what a microphone records of the sweeps: the room, the delay, and white noise."""
    h = np.concatenate([np.zeros(LATE), room() if response is None else response])
    played = excitation(plan)
    hiss = noise * np.random.default_rng(2).normal(size=len(played))
    return fftconvolve(played, h)[: len(played)] + hiss


def levels_db(x: FloatArray) -> FloatArray:
    """Return the energy in twelfths of an octave from 100 Hz to 8 kHz."""
    n = 2**18
    edges = np.searchsorted(np.fft.rfftfreq(n, 1.0 / RATE_HZ), 100.0 * 2.0 ** (np.arange(77) / 12))
    return 10.0 * np.log10(np.add.reduceat(np.abs(np.fft.rfft(x, n)) ** 2, edges)[:-1])


def test_a_sweep_has_equal_energy_in_every_octave_and_ends_in_silence() -> None:
    x = sweep(PLAN)
    power = np.abs(np.fft.rfft(x)) ** 2
    f = np.fft.rfftfreq(len(x), 1.0 / RATE_HZ)
    octaves = [power[(f >= low) & (f < 2.0 * low)].sum() for low in 62.5 * 2.0 ** np.arange(8)]
    # the fade and the ripple of a sweep that begins at once are less than half a decibel
    assert np.ptp(10.0 * np.log10(octaves)) < 0.5
    assert x[0] == 0.0 and abs(x[-1]) < 1e-3 and abs(np.abs(x).max() - 0.5) < 1e-3


def test_the_response_is_that_of_the_room_within_a_tenth_of_a_decibel() -> None:
    """Also its time: emission is where the sweep began, and the devices are late by a constant."""
    measured = response_from_recording(PLAN, recording())
    h, x = room(), measured.response.pressure
    begin = round(measured.response.time_zero_s * RATE_HZ) + LATE
    np.testing.assert_allclose(levels_db(x), levels_db(h), atol=0.1)
    # but for the octave above 20 kHz, which the sweep has not
    rest = x[begin : begin + len(h)] - h
    assert np.sqrt(np.mean(rest[1000:20000] ** 2)) < 0.5 * np.sqrt(np.mean(h[1000:20000] ** 2))
    assert measured.again == () and measured.n_clipped == 0
    assert measured.noise_dbfs == pytest.approx(-100.0, abs=0.2)
    assert np.all(measured.range_db > 45.0)


def test_repetitions_and_longer_sweeps_lower_the_noise_as_their_number() -> None:
    """Four times as much of either: 6 dB, less the scatter of a level (B T = 5000: .1 dB).

    The soft sweep counts as a quarter.
    """

    def noise_db(plan: SweepPlan) -> float:
        x = response_from_recording(plan, recording(plan, noise=1e-3)).response.pressure
        return float(10.0 * np.log10(np.mean(x[-RATE_HZ // 2 :] ** 2)))

    one = noise_db(replace(PLAN, repetitions=1))
    times = (4 + 0.25) / (1 + 0.25)
    gained = one - noise_db(replace(PLAN, repetitions=4))
    assert gained == pytest.approx(10.0 * np.log10(times), abs=0.4)
    assert one - noise_db(replace(PLAN, repetitions=1, seconds=8.0)) == pytest.approx(6.0, abs=0.4)


def test_what_is_missing_of_the_range_is_what_must_be_louder() -> None:
    faint = response_from_recording(PLAN, 0.01 * recording(noise=0.0) + hiss(2e-4))
    (reason,) = faint.again
    assert "noise hides the decay in" in reason and "4000 Hz" in reason
    short = np.ceil(35.0 - faint.range_db[:6].min()) + 2.5
    louder = 0.01 * 10.0 ** (short / 20.0) * recording(noise=0.0) + hiss(2e-4)
    assert response_from_recording(PLAN, louder).again == ()


def hiss(noise: float) -> FloatArray:
    return noise * np.random.default_rng(3).normal(size=len(excitation(PLAN)))


def faults() -> dict[str, tuple[Callable[[FloatArray], FloatArray], str]]:
    """Return what may happen to a recording, by what is said of it."""
    second = RATE_HZ + round(7.0 * RATE_HZ)  # where the second repetition begins
    at = np.arange(len(excitation(PLAN)))

    def gained(x: FloatArray) -> FloatArray:
        return np.where(at < second, x, 10.0 ** (0.5 / 20.0) * x)

    def knocked(x: FloatArray) -> FloatArray:
        hit = (at >= second + RATE_HZ) & (at < second + 1.1 * RATE_HZ)
        return x + 0.05 * np.random.default_rng(4).normal(size=len(x)) * hit

    def followed(x: FloatArray) -> FloatArray:
        """Return half the decibels of the last 300 ms."""
        n = round(0.3 * RATE_HZ)
        power = fftconvolve(x**2, np.exp(-np.arange(5 * n) / n) / n)[: len(x)]
        return x * np.maximum(power, 1e-9) ** -0.25 * 0.03

    def lowpassed(x: FloatArray) -> FloatArray:
        return sosfiltfilt(butter(12, 3400.0, output="sos", fs=RATE_HZ), x)

    return {
        "gain": (gained, "level changes by 0.5 dB between repetitions"),
        "automatic gain": (followed, "6 dB softer is recorded 3.0 dB softer"),
        "event": (knocked, "repetition 2 differs from the mean 1.0 s after it began"),
        "lost samples": (
            lambda x: np.concatenate([np.delete(x, np.s_[second : second + 128]), np.zeros(128)]),
            "repetitions are 128.0 samples apart",
        ),
        "two clocks": (lambda x: np.interp(at * (1.0 + 5e-5), at, x), "clocks of their own"),
        "converter": (lambda x: np.clip(100.0 * x, -1.0, 1.0), "samples at full scale"),
        "preamplifier": (lambda x: np.clip(x, -3e-3, 3e-3), "peaks of equal height"),
        "gate": (lambda x: np.where(at < RATE_HZ, 0.0, x), "background is digital silence"),
        "telephone": (lowpassed, "nothing arrives above"),
    }


@pytest.mark.parametrize("name", faults())
def test_each_fault_of_a_chain_is_named_with_its_cause(name: str) -> None:
    broken, words = faults()[name]
    reasons = response_from_recording(PLAN, broken(recording())).again
    assert any(words in reason for reason in reasons), reasons
    causes = [reason for reason in reasons if "repetition" in reason]
    assert len(causes) == (name in ("gain", "event", "lost samples", "two clocks")), reasons


@pytest.mark.parametrize(
    ("recorded", "words"),
    [
        (np.zeros(1000), "shorter than what was played"),
        (np.zeros(len(excitation(PLAN))), "silent"),
        (hiss(0.1), "whether the loudspeaker plays"),
        (np.full(len(excitation(PLAN)), np.nan), "recording"),
    ],
)
def test_a_recording_of_no_use_is_refused(recorded: FloatArray, words: str) -> None:
    with pytest.raises(InputError, match=words):
        response_from_recording(PLAN, recorded)


@pytest.mark.parametrize(
    "names", [("", "R"), ("a_b", "R"), ("S", "../R"), (".S", "R"), ("S", "\n")]
)
def test_a_name_that_could_not_be_read_back_is_refused(names: tuple[str, str]) -> None:
    with pytest.raises(InputError, match="name"):
        response_name(*names)


# The command, by a device that is a convolution.


class Backend:
    """What `roomfit measure` uses of the module sounddevice."""

    PortAudioError = type("PortAudioError", (Exception,), {})

    def __init__(self, gain: float = 1.0, status: str = "", fault: str = "") -> None:
        self.gain, self.status, self.fault, self.asked = gain, status, fault, []

    def playrec(self, played: FloatArray, **asked: Any) -> FloatArray:
        self.asked.append(asked)
        if self.fault:
            raise self.PortAudioError(self.fault)
        h = np.concatenate([np.zeros(LATE), room()])
        x = fftconvolve(self.gain * played[:, 0], h)[: len(played)]
        x += 1e-5 * np.random.default_rng(5).normal(size=len(x))
        return x.astype(np.float32)[:, None]

    def get_status(self) -> str:
        return self.status

    def query_devices(self) -> str:
        return "  0 Loop, 1 in, 1 out"


def test_the_response_is_written_whole_and_not_replaced_unasked(tmp_path: Path) -> None:
    backend = Backend()
    card = SoundCard(backend, "Mic", 3)
    measure_to_folder(tmp_path / "ir", "S1", "R1", PLAN, card)
    (file,) = (tmp_path / "ir").iterdir()
    assert file.name == "S1_R1.wav"
    response, _ = read_response(ResponseSpec(file))
    np.testing.assert_allclose(levels_db(response.pressure), levels_db(room()), atol=0.1)
    assert backend.asked[0]["device"] == ("Mic", 3) and backend.asked[0]["samplerate"] == 48_000.0
    before = file.read_bytes()
    with pytest.raises(InputError, match="measured already"):
        measure_to_folder(tmp_path / "ir", "S1", "R1", PLAN, card)
    assert len(backend.asked) == 1  # refused before anything is played
    mute = SoundCard(Backend(gain=0.0))
    with pytest.raises(InputError, match="whether the loudspeaker plays"):
        measure_to_folder(tmp_path / "ir", "S1", "R1", PLAN, mute, again=True)
    assert file.read_bytes() == before
    measure_to_folder(tmp_path / "ir", "S1", "R1", PLAN, SoundCard(Backend(0.5)), again=True)
    assert file.read_bytes() != before and len(list((tmp_path / "ir").iterdir())) == 1


def test_the_command_measures_says_so_and_ends_with_what_it_is_good_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "sounddevice", Backend())
    short = ("--seconds", "2", "--silence", "1.5")
    call = ("measure", str(tmp_path), "--source", "S1", "--receiver", "R1", *short)
    assert run_command(monkeypatch, *call) == 0
    shown = capsys.readouterr().out
    assert "4000 Hz" in shown and "T30" in shown and 'time_zero = "direct"' in shown
    assert run_command(monkeypatch, *call) == 2
    assert "--again" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "sounddevice", Backend(0.001))
    assert run_command(monkeypatch, *call, "--again") == 1
    assert "again: noise hides the decay" in capsys.readouterr().out
    assert run_command(monkeypatch, "measure", "--list") == 0
    assert "Loop" in capsys.readouterr().out
    assert run_command(monkeypatch, "measure", str(tmp_path)) == 2
    assert "--source S1" in capsys.readouterr().err
