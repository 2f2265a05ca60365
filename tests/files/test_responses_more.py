"""Exports of REW and recorded sweeps: known responses come back, damaged files are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyfar
import pytest
import scipy.io
import scipy.signal
import soundfile

from roomfit.base.errors import InputError
from roomfit.base.findings import Code
from roomfit.files.responses import read_response
from roomfit.files.responses.recordings import band_of, regularised_quotient
from roomfit.files.schema import ResponseSpec
from roomfit.signals.response import ImpulseResponse, times_s

RATE_HZ = 24000

# The lines that REW 5.31 writes above the samples; 5.40 adds the data offset.
REW = """* Impulse Response data saved by REW V5.31.3
* IR is {normalised}
* IR window has {window}been applied
* IR is {phase}the min phase version
* Source: Scarlett 2i2, 1, volume: no control
* Dated: May 24, 2025 10:52:53 PM
* Measurement: hall L1
* Excitation: 512k Log Swept Sine, 1 sweep at -10.0 dBFS using a loopback as a timing reference
* Response measured over: 20,1 to 19.052,7 Hz
{peak_value!r} // Peak value before normalisation
{peak_index} // Peak index
{length} // Response length
{interval!r} // Sample interval (seconds)
{start!r} // Start time (seconds)
120.0 // Data offset (dB)
* Data start
"""


def decay(n: int = 6000, delay: int = 120, seed: int = 1) -> np.ndarray:
    """A room's response: direct sound, then a decaying noise."""
    rng = np.random.default_rng(seed)
    late = 0.1 * rng.standard_normal(n) * np.exp(-np.arange(n) / 500.0)
    late[0] = 0.9
    return np.concatenate([np.zeros(delay), late])


def rew_text(samples: np.ndarray, start_s: float, **changes: object) -> str:
    peak = int(np.argmax(np.abs(samples)))
    entries = {
        "normalised": "not normalised",
        "window": "not ",
        "phase": "not ",
        "peak_value": float(samples[peak]),
        "peak_index": peak,
        "length": len(samples),
        "interval": 1.0 / RATE_HZ,
        "start": start_s,
        **changes,
    }
    return REW.format(**entries) + "\n".join(repr(float(v)) for v in samples) + "\n"


def written(folder: Path, text: str | bytes, name: str = "hall.txt") -> Path:
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def codes(findings) -> list[str]:
    return [finding.code for finding in findings]


def test_samples_rate_and_clock_of_an_export_come_back(tmp_path):
    """To the last bit; REW's zero 0.25 s into the file is the time of emission."""
    samples = np.concatenate([np.zeros(RATE_HZ // 4), decay()])
    path = written(tmp_path, rew_text(samples, -0.25))
    response, findings = read_response(ResponseSpec(path))
    np.testing.assert_array_equal(response.pressure, samples)
    assert response.sampling_rate_hz == RATE_HZ
    assert findings == ()
    arrival_s = times_s(response)[np.argmax(np.abs(samples))]
    assert arrival_s == pytest.approx(120 / RATE_HZ, abs=1e-12)
    later, _ = read_response(ResponseSpec(path, latency_s=0.002))
    assert later.time_zero_s == pytest.approx(0.252, abs=1e-12)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: "\ufeff" + text,
        lambda text: text.replace("* Data start\n", "\n").replace("* ", ""),
        lambda text: text.replace("120.0 // Data offset (dB)\n", ""),
        lambda text: text.replace("// Sample interval", " //  sample interval"),
        lambda text: text + "\n\n",
    ],
)
def test_other_versions_of_the_layout_are_read_alike(tmp_path, change):
    """Line ends, byte order mark, no stars and no announcement (V5.19), no offset (V5.31)."""
    samples = decay()
    response, _ = read_response(ResponseSpec(written(tmp_path, change(rew_text(samples, -0.001)))))
    np.testing.assert_array_equal(response.pressure, samples)
    assert response.time_zero_s == 0.001


def test_a_normalised_export_gets_its_level_back(tmp_path):
    """Samples over their peak, with the peak in the header, are the samples again."""
    samples = 0.0034 * decay()
    peak = float(np.abs(samples).max())
    text = rew_text(samples / peak, -0.25, normalised="normalised", peak_value=peak)
    response, findings = read_response(ResponseSpec(written(tmp_path, text)))
    np.testing.assert_allclose(response.pressure, samples, rtol=1e-14, atol=0)
    assert findings == ()
    lost = rew_text(samples / peak, -0.25, normalised="normalised", peak_value=0.0)
    assert codes(read_response(ResponseSpec(written(tmp_path, lost)))[1]) == [Code.LEVEL_UNKNOWN]


def test_a_zero_at_the_peak_and_a_window_are_reported(tmp_path):
    text = rew_text(decay(), -120 / RATE_HZ, window="")
    path = written(tmp_path, text)
    assert codes(read_response(ResponseSpec(path))[1]) == [
        Code.WINDOW_APPLIED,
        Code.TIME_ZERO_AT_PEAK,
    ]
    assert codes(read_response(ResponseSpec(path, time_zero="direct"))[1]) == [Code.WINDOW_APPLIED]


def longer(text: str) -> str:
    return text + "0.1\n"


def cut(text: str) -> str:
    return text[: text.rindex("\n", 0, -60) + 1]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (cut, "cut off"),
        (longer, "too long"),
        (lambda t: t.replace("* Data start\n0.0\n", "* Data start\nnan\n"), "finite number"),
        (lambda t: t.replace("* Data start\n0.0\n", "* Data start\n0.1 0.2\n"), "not one"),
        (lambda t: t.replace(f"{1.0 / RATE_HZ!r} //", "0.0 //"), "out of range"),
        (lambda t: t.replace(f"{1.0 / RATE_HZ!r} //", "nan //"), "not one"),
        (lambda t: t.replace("Response length", "Length"), "not complete"),
        (lambda t: t.replace("is not the min phase", "is the min phase"), "minimum-phase"),
        (lambda t: t.replace("Impulse Response data", "Measurement data"), "REW exported"),
        (lambda t: t[:400], "not complete"),
        (lambda t: t.replace("Dated", "Dat\0ed"), "REW exported"),
    ],
)
def test_an_export_that_is_not_whole_is_refused(tmp_path, change, words):
    path = written(tmp_path, change(rew_text(decay(), -0.25)))
    with pytest.raises(InputError, match=words) as caught:
        read_response(ResponseSpec(path))
    assert "hall.txt" in str(caught.value)


# ---------------------------------------------------------------------------------------- sweeps

BAND_HZ = (80.0, 9000.0)


def sweep(n: int = 3 * RATE_HZ) -> np.ndarray:
    signal = pyfar.signals.exponential_sweep_time(n, BAND_HZ, sampling_rate=RATE_HZ)
    return 0.5 * np.asarray(signal.time[0])


LINEAR = pyfar.signals.linear_sweep_time(2 * RATE_HZ, (200, 6000), sampling_rate=RATE_HZ).time[0]


def wav(path: Path, samples: np.ndarray, subtype: str = "DOUBLE", rate: int = RATE_HZ) -> Path:
    soundfile.write(path, samples, rate, subtype=subtype)
    return path


def recorded(played: np.ndarray, response: np.ndarray) -> np.ndarray:
    return scipy.signal.fftconvolve(played, response)


def in_band(pressure: np.ndarray) -> np.ndarray:
    """Octaves 250 Hz to 4 kHz by a filter that is not the reader's."""
    sos = scipy.signal.butter(4, [177.0, 5657.0], "bandpass", fs=RATE_HZ, output="sos")
    return scipy.signal.sosfiltfilt(sos, np.concatenate([pressure, np.zeros(4000)]))


def after_zero(response: ImpulseResponse) -> np.ndarray:
    return response.pressure[np.argmin(np.abs(times_s(response))) :]


def error_db(response: ImpulseResponse, true: np.ndarray) -> float:
    """Energy of the difference over the energy of the truth, in the band."""
    early = int(np.argmin(np.abs(times_s(response))))
    found, true = response.pressure, np.concatenate([np.zeros(early), true])
    n = min(len(found), len(true))
    difference = in_band(found[:n]) - in_band(true[:n])
    return float(10 * np.log10(np.sum(difference**2) / np.sum(in_band(true[:n]) ** 2)))


def test_a_recorded_sweep_gives_the_known_response(tmp_path):
    """Rounding is at -300 dB; what the filter rings beyond its cut ends is measured at -84."""
    played, true = sweep(), decay()
    take = wav(tmp_path / "take.wav", recorded(played, true))
    spec = ResponseSpec(take, excitation=wav(tmp_path / "sweep.wav", played))
    response, findings = read_response(spec)
    assert times_s(response)[0] == pytest.approx(-0.02, abs=1e-12)
    assert response.sampling_rate_hz == RATE_HZ
    assert error_db(response, true) < -75
    assert codes(findings) == [Code.DECONVOLVED]
    # the decay goes on 6119 samples after the last sound of the sweep, give or take its fade-out
    assert len(after_zero(response)) == pytest.approx(len(true), abs=100)


def test_noise_in_the_recording_stays_as_small_as_theory_says(tmp_path):
    """White noise of power s2 comes out with the mean of s2 / |X|2 over the band.

    The estimate of a variance from n independent samples scatters by sqrt(2 / n); band-limited
    noise of 0.25 s holds about 2 * 5480 Hz * 0.25 s = 2740: 2.7 %, and 15 % is beyond five of it.
    """
    played, true = sweep(), decay()
    clean = np.concatenate([recorded(played, true), np.zeros(RATE_HZ)])
    rng = np.random.default_rng(20240607)
    noise = 1e-3 * rng.standard_normal(len(clean))
    excitation = wav(tmp_path / "sweep.wav", played)
    results = []
    for name, samples in (("clean", clean), ("noisy", clean + noise)):
        take = wav(tmp_path / f"{name}.wav", samples)
        results.append(after_zero(read_response(ResponseSpec(take, excitation=excitation))[0]))
    tail = slice(RATE_HZ // 2, RATE_HZ // 2 + RATE_HZ // 4)
    found = np.var((in_band(results[1]) - in_band(results[0]))[tail])
    n = 2**18
    power = np.abs(np.fft.rfft(played, n)) ** 2
    sos = scipy.signal.butter(4, [177.0, 5657.0], "bandpass", fs=RATE_HZ, output="sos")
    hz = np.fft.rfftfreq(n, 1 / RATE_HZ)
    gain = np.abs(scipy.signal.sosfreqz(sos, hz[1:], fs=RATE_HZ)[1]) ** 4  # forth and back
    inside = (hz[1:] > 90) & (hz[1:] < 8900)
    expected = 1e-6 * np.sum((gain / power[1:])[inside]) / len(hz)
    assert found == pytest.approx(expected, rel=0.15)


def test_distortion_lands_before_time_zero_and_is_cut_away(tmp_path):
    """A square term at -20 dB: kept, it would disturb at about that level; cut, it is gone.

    The second harmonic runs ahead of the response by T ln 2 / ln(f2 / f1) = 0.44 s.
    """
    played, true = sweep(), decay(3000)
    bent = played + 0.2 * played**2
    take = wav(tmp_path / "take.wav", recorded(bent, true))
    spec = ResponseSpec(take, excitation=wav(tmp_path / "sweep.wav", played))
    response, _ = read_response(spec)
    assert error_db(response, true) < -45
    circle = np.fft.irfft(
        np.fft.rfft(recorded(bent, true), 2**18)
        * np.conj(np.fft.rfft(played, 2**18))
        / (np.abs(np.fft.rfft(played, 2**18)) ** 2 + 1e-3),
    )
    lead = int(3 * np.log(2) / np.log(BAND_HZ[1] / BAND_HZ[0]) * RATE_HZ)
    ahead = np.sum(circle[-lead - 200 : -lead + 2000] ** 2)
    assert ahead > 1e-4 * np.sum(circle[:6000] ** 2)


@pytest.mark.parametrize(
    ("begins", "ends"), [(0, 2 * RATE_HZ), (-900, 6500), (2300, 6500), (2380, 2 * RATE_HZ)]
)
def test_a_recording_that_has_the_sweep_and_its_decay_needs_no_silence(tmp_path, begins, ends):
    """Whenever it began, before the playback or in the silence before the sweep, in samples.

    And wherever it ended after the sweep. With latency and a clock of its own as at any time.
    """
    played, true = sweep(), decay()
    padded = np.concatenate([np.zeros(2400), played, np.zeros(2 * RATE_HZ)])
    whole = np.concatenate([np.zeros(900), recorded(padded, true)])
    take = whole[900 + begins : 900 + 2400 + len(played) + ends]
    spec = ResponseSpec(
        wav(tmp_path / "take.wav", take),
        excitation=wav(tmp_path / "sweep.wav", padded),
        latency_s=-begins / RATE_HZ,
    )
    response, _ = read_response(spec)
    assert error_db(response, true) < -75


@pytest.mark.parametrize(
    ("begins", "ends", "words"),
    [(3000, RATE_HZ, "began after the excitation"), (-9000, -3000, "ends before the decay")],
)
def test_a_recording_without_all_of_the_sweep_is_refused(tmp_path, begins, ends, words):
    played = sweep()
    whole = np.concatenate([np.zeros(9000), recorded(played, decay()), np.zeros(RATE_HZ)])
    take = wav(tmp_path / "take.wav", whole[9000 + begins : 9000 + len(played) + ends])
    excitation = wav(tmp_path / "sweep.wav", played)
    with pytest.raises(InputError, match=words):
        read_response(ResponseSpec(take, excitation=excitation))


def test_a_loopback_in_another_channel_takes_the_latency_out(tmp_path):
    played, true = sweep(), decay()
    room = np.concatenate([np.zeros(700), recorded(played, true), np.zeros(RATE_HZ)])
    loop = np.concatenate([np.zeros(700), 0.8 * played])
    both = np.stack([room, np.pad(loop, (0, len(room) - len(loop)))], axis=1)
    path = wav(tmp_path / "both.wav", both)
    spec = ResponseSpec(path, channel=0, excitation=path, excitation_channel=1)
    response, _ = read_response(spec)
    assert error_db(response, true / 0.8) < -75


@pytest.mark.parametrize(
    ("signal", "low_hz", "high_hz", "leak"),
    [
        (sweep(), *BAND_HZ, 1 / 4),
        (LINEAR, 200, 6000, 1 / 2),
        (np.random.default_rng(3).standard_normal(RATE_HZ), 10, RATE_HZ / 2, 1.0),
    ],
)
def test_the_band_of_an_excitation_is_the_one_it_was_made_for(signal, low_hz, high_hz, leak):
    """Within a twelfth of an octave at the upper end, and what each leaks at the lower.

    A sweep that runs through r hertz a second smears its ends by about sqrt(r): the exponential
    one by sqrt(80 ln(9000 / 80) / 3) = 11 Hz, a fifth of an octave at 80 Hz, the linear one by
    sqrt(2900) = 54 Hz, almost half an octave at 200 Hz. Noise has a line or two in each band
    below 20 Hz, where one may well be 15 dB low.
    """
    low, high = band_of(signal, RATE_HZ)
    assert abs(np.log2(low / low_hz)) <= leak
    assert abs(np.log2(high / high_hz)) <= 1 / 12


def test_a_loopback_that_rolls_off_gives_what_it_has_down_to_15_db_and_no_more():
    """Two poles at 500 Hz: 12 dB down at 250 Hz, and beyond the band at 125 Hz, 24 dB down.

    The quotient of a loopback by itself is 1 wherever it has energy: here to 0.5 dB, the width of
    a cross-fade, and noise 60 dB below the sweep does not change that.
    """
    highpass = scipy.signal.butter(2, 500.0, "high", fs=RATE_HZ, output="sos")
    rolled = scipy.signal.sosfilt(highpass, sweep())
    low, high = band_of(rolled, RATE_HZ)
    assert 125.0 < low < 250.0 and abs(np.log2(high / BAND_HZ[1])) <= 1 / 12
    noise = 1e-3 * np.random.default_rng(5).normal(size=len(rolled))
    quotient = regularised_quotient(rolled + noise, rolled, RATE_HZ, (low, high))
    gain_db = 20.0 * np.log10(np.abs(np.fft.rfft(quotient)))
    f = np.fft.rfftfreq(len(quotient), 1.0 / RATE_HZ)
    own = {at: float(gain_db[(f > 0.97 * at) & (f < 1.03 * at)].mean()) for at in (250, 1000, 80)}
    assert own[250] == pytest.approx(own[1000], abs=0.5)
    assert own[80] < own[1000] - 40.0


def test_a_clipped_recording_is_reported_and_the_crests_of_low_tones_are_not(tmp_path):
    """16 bits: at 15 Hz and half of full scale several samples at a crest are equal."""
    low = pyfar.signals.exponential_sweep_time(RATE_HZ, (15, 9000), sampling_rate=RATE_HZ)
    played = 0.5 * low.time[0]
    excitation = wav(tmp_path / "sweep.wav", played)
    soft = np.concatenate([played, np.zeros(RATE_HZ)])
    loud = np.clip(1.2 * soft, -0.5, 0.5)
    reported = {}
    for name, samples in (("soft", soft), ("loud", loud)):
        take = wav(tmp_path / f"{name}.wav", samples, "PCM_16")
        reported[name] = codes(read_response(ResponseSpec(take, excitation=excitation))[1])
    words = soundfile.read(tmp_path / "soft.wav", dtype="int16")[0]
    crests = "".join("1" if w == words.max() else "0" for w in words)
    assert "1111" in crests  # the case is there
    assert Code.RESPONSE_CLIPPED not in reported["soft"]
    assert Code.RESPONSE_CLIPPED in reported["loud"]


def test_recordings_that_cannot_be_deconvolved_are_refused(tmp_path):
    played, true = sweep(), decay()
    good = wav(tmp_path / "take.wav", recorded(played, true))
    excitation = wav(tmp_path / "sweep.wav", played)
    cases = [
        (
            wav(tmp_path / "cut.wav", recorded(played, true)[:60000]),
            excitation,
            "ends before the decay",
        ),
        (good, wav(tmp_path / "rate.wav", played, rate=48000), "different sampling rates"),
        (good, wav(tmp_path / "silent.wav", 0 * played), "silent"),
        (good, tmp_path / "missing.wav", "does not exist"),
        (good, written(tmp_path, rew_text(true, 0.0)), "goes with a recording"),
        (good, wav(tmp_path / "two.wav", np.stack([played, played], 1)), "several channels"),
        (written(tmp_path, rew_text(true, 0.0), "ir.txt"), excitation, "goes with a recording"),
    ]
    for path, other, words in cases:
        with pytest.raises(InputError, match=words):
            read_response(ResponseSpec(path, excitation=other))
    with pytest.raises(InputError, match="without the excitation"):
        read_response(ResponseSpec(good, excitation_channel=0))
    short = wav(tmp_path / "short.wav", recorded(played, true)[: len(played) + 100])
    with pytest.raises(InputError, match="ends before the decay"):
        read_response(ResponseSpec(short, excitation=excitation))


@pytest.mark.parametrize(
    "band_hz", [(100.0, 3000.0), (20.0, 0.5 * RATE_HZ), (57.3, 0.42 * RATE_HZ), (11.0, 3200.0)]
)
@pytest.mark.parametrize("n", [20_011, 20_480])
def test_the_quotient_of_spectra_is_that_of_pyfar(band_hz, n):
    """The same formula, so equal to rounding, relative to the largest sample."""
    rng = np.random.default_rng(5)
    taken, played = rng.standard_normal(n), rng.standard_normal(9000)
    ours = regularised_quotient(taken, played, RATE_HZ, band_hz)
    padded = [pyfar.Signal(np.pad(x, (0, len(ours) - len(x))), RATE_HZ) for x in (taken, played)]
    inverse = pyfar.dsp.RegularizedSpectrumInversion.from_frequency_range(
        padded[1],
        band_hz,
        regularization_within=1e-5,
        beta=float(np.max(np.abs(padded[1].freq)) ** 2),
    ).invert
    theirs = np.fft.irfft(padded[0].freq[0] * inverse.freq[0], len(ours))
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12 * np.abs(theirs).max())
