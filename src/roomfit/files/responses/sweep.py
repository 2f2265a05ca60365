"""An impulse response measured with sweeps: what is played, the response, and whether it suffices.

Nothing here plays, records or writes: arrays go in and come out.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from roomfit.base.arguments import check_name, check_range, float_array
from roomfit.base.bands import Bands, bands_between, bands_in_words
from roomfit.base.errors import InputError
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.files.responses.recordings import Recording, deconvolved
from roomfit.signals.decay import DecayCurve, check_decay_range, check_is_response, decay_curve
from roomfit.signals.response import ImpulseResponse, clipping, find_onset

_BACKGROUND_S = 1.0  # of silence before the first sweep
_LOWEST_HZ, _HIGHEST_HZ, _HIGHEST = 40.0, 20_000.0, 0.45  # of the sweep; a share of the rate
_RISE_S, _FALL_S = 0.05, 0.005
_AMPLITUDE = 0.5  # converters that interpolate have 6 dB left
_SOFT = 0.5  # amplitude of the first sweep beside the others: what follows the level shows
# ISO 3382-1:2009: the level lies so far above the background noise for T20 and for T30.
_T20_DB, _T30_DB = 35.0, 45.0
_NEEDED_HZ = 4000.0  # up to this octave, from 125 Hz, a response must suffice
_FULL_SCALE = 1.0 - 1e-4
# Repetitions that differ by more than both, the background and the share of what was recorded,
# differ by an event: loudspeakers repeat themselves to -40 dB.
_ABOVE_BACKGROUND, _SHARE, _BLOCK_S = 10.0, 1e-4, 0.125
_SAME_DB, _LINEAR_DB, _SAME_SAMPLES = 0.1, 0.5, 0.2
_STILL_S, _STILL = 0.05, 1e-9  # no microphone gives equal samples for so long
_ABSENT = 1e-5  # of the strongest third of an octave
_WAKE = (
    "see whether the loudspeaker plays, and whether the right microphone is recorded; then louder, "
    "or with a longer silence after the sweep"
)


@dataclass(frozen=True, slots=True)
class SweepPlan:
    """What is played: a second of silence, a soft sweep, sweeps; each with silence to decay in."""

    sampling_rate_hz: float = 48_000.0  # 8 to 192 kHz
    seconds: float = 6.0  # of one sweep, 1 to 60
    silence_s: float = 3.0  # after each, 0.5 to 30: longer than the decay and the delay together
    repetitions: int = 3  # 1 to 20

    def __post_init__(self) -> None:
        check_range("sampling rate", self.sampling_rate_hz, 8000.0, 192_000.0, "Hz")
        check_range("length of the sweep", self.seconds, 1.0, 60.0, "s")
        check_range("silence after the sweep", self.silence_s, 0.5, 30.0, "s")
        check_range("number of repetitions", self.repetitions, 1, 20)
        check_range("length of a measurement", self.length_s, 0.0, 600.0, "s")

    @property
    def length_s(self) -> float:
        """How long all of it takes."""
        return _BACKGROUND_S + (1 + self.repetitions) * (self.seconds + self.silence_s)


def sweep(plan: SweepPlan) -> FloatArray:
    """Return one exponential sweep [1]_, faded in and out, shape (n_samples,), at most 0.5.

    From 40 Hz to 20 kHz, or to 0.45 of the sampling rate: equal energy in each octave.

    References
    ----------
    .. [1] A. Farina, "Simultaneous measurement of impulse response and distortion with a
           swept-sine technique", 108th AES Convention, preprint 5093 (2000).
    """
    rate_hz = plan.sampling_rate_hz
    n = round(plan.seconds * rate_hz)
    growth = float(np.log(_top_hz(rate_hz) / _LOWEST_HZ))
    x = np.expm1(growth * np.arange(n) / n)
    x = _AMPLITUDE * np.sin(2.0 * np.pi * _LOWEST_HZ * plan.seconds / growth * x)
    for part_s, ends in ((_RISE_S, x), (_FALL_S, x[::-1])):
        fade = np.arange(round(part_s * rate_hz)) / (part_s * rate_hz)
        ends[: len(fade)] *= np.sin(0.5 * np.pi * fade) ** 2
    return np.asarray(x)


def _top_hz(rate_hz: float) -> float:
    return min(_HIGHEST_HZ, _HIGHEST * rate_hz)


def excitation(plan: SweepPlan) -> FloatArray:
    """Return all that is played, shape (n_samples,): silence, a sweep at half, and all others."""
    rate_hz = plan.sampling_rate_hz
    one = np.concatenate([sweep(plan), np.zeros(round(plan.silence_s * rate_hz))])
    silence = np.zeros(round(_BACKGROUND_S * rate_hz))
    return np.concatenate([silence, _SOFT * one, np.tile(one, plan.repetitions)])


@dataclass(frozen=True, slots=True, eq=False)
class SweepResponse:
    """A response as it was measured, and how good it is."""

    response: ImpulseResponse  # recorded over played: emission, but for the delay of the devices
    peak_dbfs: float  # of the recording; 0 is full scale
    n_clipped: int  # samples at full scale
    noise_dbfs: float  # rms of the background before the first sweep
    bands: Bands
    range_db: FloatArray  # (n_bands,), of decay above the noise, and before the end
    again: tuple[str, ...]  # why it is to be measured again, and what to change; empty: it suffices

    def content(self) -> dict[str, Any]:
        """Return what is shown of it, as JSON."""
        good = np.select([self.range_db >= _T30_DB, self.range_db >= _T20_DB], ["T30", "T20"], "")
        return {
            "peak_dbfs": round(self.peak_dbfs, 1),
            "n_clipped": self.n_clipped,
            "noise_dbfs": round(self.noise_dbfs, 1),
            "bands_hz": self.bands.centres_hz.tolist(),
            "range_db": np.minimum(self.range_db, 200.0).round(1).tolist(),
            "suffices_for": good.tolist(),
            "again": list(self.again),
        }

    def __str__(self) -> str:
        """Return what the command line prints."""
        own = self.content()
        rows = zip(own["bands_hz"], own["range_db"], own["suffices_for"], strict=True)
        lines = (
            f"peak {own['peak_dbfs']:.1f} dBFS, background {own['noise_dbfs']:.1f} dBFS, "
            f"{self.n_clipped} samples clipped",
            f"range of the decay; T20 needs {_T20_DB:g} dB, T30 {_T30_DB:g} dB",
            *(f"{f:>8g} Hz {x:>6.1f} dB  {good or 'too short'}" for f, x, good in rows),
            *(f"again: {reason}" for reason in self.again),
        )
        return "\n".join(lines)


def response_from_recording(
    plan: SweepPlan, recorded: FloatArray, reported: tuple[str, ...] = ()
) -> SweepResponse:
    """Return the response of a recording that began with the first sample played.

    The mean of the repetitions, without the sweep. Repetitions that differ by more than background
    explains are named with the likely cause: a gain that followed the sound, samples that were lost
    or clocks that differ, an event.

    Notes
    -----
    Whether a decay suffices is judged from 125 Hz to 4 kHz by ISO 3382-1:2009.
    """
    x = float_array("recording", recorded, (None,))
    rate_hz, n_first = plan.sampling_rate_hz, round(_BACKGROUND_S * plan.sampling_rate_hz)
    n_needed = len(excitation(plan))
    if len(x) < n_needed:
        raise InputError(
            "the recording is shorter than what was played",
            found=f"{len(x)} samples",
            needed=f"{n_needed} samples",
            hint="measure again, and leave the page or the command alone meanwhile",
        )
    background = x[:n_first] - x[:n_first].mean()
    soft, *others = x[n_first:n_needed].reshape(1 + plan.repetitions, -1)
    repeated = np.array(others)
    mean = (_SOFT * soft + repeated.sum(axis=0)) / (_SOFT**2 + plan.repetitions)
    response, bands, curve = _response(mean, plan)
    n_clipped, noise = int(np.count_nonzero(np.abs(x) >= _FULL_SCALE)), float(background.std())
    reasons = [*reported]
    if n_clipped or any(clipping(row, "", "") for row in repeated):
        found = f"{n_clipped} samples at full scale" if n_clipped else "peaks of equal height"
        reasons.append(f"the recording is clipped ({found}): lower the gain of the microphone")
    n = round(_STILL_S * rate_hz)
    blocks = background[: len(background) // n * n].reshape(-1, n)
    if np.any(np.ptp(blocks, axis=1) <= _STILL):
        reasons.append(
            "the background is digital silence for 50 ms and more: a gate or a noise suppression "
            "is on, or the gain of the microphone is far too low"
        )
    reasons += (
        *_of_bandwidth(mean, rate_hz),
        *_of_repetitions(repeated, soft, noise, rate_hz),
        *_of_range(bands, curve.usable_db, curve.noise_reached, plan),
    )
    peak_dbfs, noise_dbfs = (
        20.0 * float(np.log10(max(a, 1e-10))) for a in (np.abs(x).max(), noise)
    )
    return SweepResponse(
        response, peak_dbfs, n_clipped, noise_dbfs, bands, curve.usable_db, tuple(reasons)
    )


def _response(mean: FloatArray, plan: SweepPlan) -> tuple[ImpulseResponse, Bands, DecayCurve]:
    """Return the response to a sweep, bands and its decay; refuse one that is none."""
    rate_hz = plan.sampling_rate_hz
    bands = bands_between("octave", 125.0, min(8000.0, rate_hz / 4.2))  # its filter needs 4
    # where the sweep has all its power: its ends, inverted, would amplify noise
    band_hz = _LOWEST_HZ * 2.0**0.5, _top_hz(rate_hz) / 1.1
    both = Recording(mean, rate_hz), Recording(sweep(plan), rate_hz)
    what = ""
    try:
        own = deconvolved(*both, Path("recording"), Path("sweep"), band_hz)
        response = ImpulseResponse(own.pressure, rate_hz, -own.delay_s)
        curve = decay_curve(bands, response, find_onset(response))
        check_decay_range(curve)
        what = "noise is louder than the response, all frequencies together"
        check_is_response(response)  # by which others would take it for a sweep
    except InputError as error:
        found, needed = error.found, error.needed
        raise InputError(what or error.what, found=found, needed=needed, hint=_WAKE) from error
    return response, bands, curve


def _of_bandwidth(mean: FloatArray, rate_hz: float) -> Iterator[str]:
    """Say where not even noise arrives above some frequency, as from a headset for speech."""
    edges_hz = _top_hz(rate_hz) * 2.0 ** (np.arange(-12, 1) / 3.0)
    power = np.cumsum(np.abs(rfft(mean)) ** 2)
    sound = np.diff(np.interp(edges_hz, rfftfreq(len(mean), 1.0 / rate_hz), power))
    reached_hz = float(edges_hz[np.flatnonzero(sound > _ABSENT * sound.max())[-1] + 1])
    if reached_hz < min(_NEEDED_HZ * 2.0**0.5, 0.8 * _top_hz(rate_hz)):
        yield (
            f"nothing arrives above {reached_hz:.0f} Hz: a headset or a call mode limits the band; "
            "use another microphone"
        )


def _of_repetitions(
    repeated: FloatArray, soft: FloatArray, noise: float, rate_hz: float
) -> Iterator[str]:
    """Say where repetitions differ by more than the background and by what; else, what is louder.

    `repeated` has the shape (n_repetitions, n_samples); `soft` is the recording of the first sweep.
    """
    left = noise**2 / len(repeated)  # of the background in the mean
    own, gains_db = _compared(repeated, repeated.mean(axis=0), left, rate_hz)
    power = np.mean((own - own.mean(axis=0)) ** 2, axis=2)
    limit = max(_ABOVE_BACKGROUND * noise**2, _SHARE * float(np.mean(repeated**2)))
    if not power.max() > limit:
        expected = _SOFT * repeated.mean(axis=0)
        (bend_db,) = _compared(soft[None], expected, _SOFT**2 * left, rate_hz)[1]
        if abs(bend_db) > _LINEAR_DB:
            yield (
                f"a sweep that is 6 dB softer is recorded {6.0 - bend_db:.1f} dB softer: automatic "
                "gain, noise suppression or a compressor is on, or the loudspeaker is at its limit"
            )
        return
    lags = [_lag(row, repeated[0]) for row in repeated]
    worst, block = np.unravel_index(int(np.argmax(power)), power.shape)
    if np.ptp(lags) > _SAME_SAMPLES:
        yield (
            f"repetitions are {np.ptp(lags):.1f} samples apart: samples were lost, or playing and "
            "recording have clocks of their own; close other programs, use one device for both, "
            "or one repetition and a longer sweep"
        )
    elif np.ptp(gains_db) > _SAME_DB:
        yield (
            f"the level changes by {np.ptp(gains_db):.1f} dB between repetitions: switch off "
            "automatic gain and echo cancelling, or keep doors and people still"
        )
    else:
        yield (
            f"repetition {worst + 1} differs from the mean {block * _BLOCK_S:.1f} s after it began "
            "by more than the background: a sound of something else in the room; keep still"
        )


def _compared(
    signals: FloatArray, common: FloatArray, background: float, rate_hz: float
) -> tuple[FloatArray, FloatArray]:
    """Return signals in blocks, shape (n, n_blocks, n_samples), and their gains in dB, (n,).

    Each gain is the median over the blocks in which the common signal is loud: an event is no gain.
    It is 0 dB where there are none, as in a background, mean square, that is as loud.
    """
    n = round(_BLOCK_S * rate_hz)
    own = signals[:, : common.size // n * n].reshape(len(signals), -1, n)
    blocks = common[: common.size // n * n].reshape(-1, n)
    energy = np.sum(blocks**2, axis=1) - n * background
    loud = energy > max(0.01 * energy.max(), _ABOVE_BACKGROUND * n * background)
    if not loud.any():
        return own, np.zeros(len(signals))
    gains = np.median(np.sum(own * blocks, axis=2)[:, loud] / energy[loud], axis=1)
    return own, 20.0 * np.log10(np.maximum(gains, 1e-10))


def _lag(signal: FloatArray, other: FloatArray) -> float:
    """Return by how many samples a signal is late, to a fraction of one."""
    n = next_fast_len(2 * len(signal), real=True)
    product = irfft(rfft(signal, n) * np.conj(rfft(other, n)), n)
    at = int(np.argmax(product))
    before, top, after = product[[at - 1, at, (at + 1) % n]]
    bend = before - 2.0 * top + after
    fraction = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return float((at if at < n // 2 else at - n) + fraction)


def _of_range(
    bands: Bands, range_db: FloatArray, noise_reached: BoolArray, plan: SweepPlan
) -> Iterator[str]:
    """Say where the decay is too short, and what would lengthen it."""
    short = (range_db < _T20_DB) & (bands.centres_hz <= _NEEDED_HZ)
    cut = short & ~noise_reached
    if cut.any():
        where = bands_in_words(bands, np.flatnonzero(cut).tolist())
        yield f"the recording ends before the decay does ({where}): longer silence after the sweep"
    noisy = np.flatnonzero(short & ~cut)
    if noisy.size:
        missing_db = _T20_DB - float(range_db[noisy].min())
        times = 10.0 ** (0.1 * missing_db)
        words = [f"{range_db[i]:.0f} dB" for i in noisy]
        more = f", or {np.ceil(times * plan.repetitions):.0f} repetitions" if times < 8.0 else ""
        yield (
            f"noise hides the decay in {bands_in_words(bands, noisy.tolist(), words)}, and T20 "
            f"needs {_T20_DB:g} dB: {missing_db:.0f} dB louder{more}, or a sweep {times:.1f} times "
            "as long, or a quieter hour"
        )


_NAME = re.compile(r'[^._\s/\\:*?"<>|][^/\\:*?"<>|]*')


def response_name(source: str, receiver: str) -> str:
    """Return the name of the file of a pair, by which other commands know it."""
    for kind, name in (("source", source), ("receiver", receiver)):
        check_name(kind, name)
        if not _NAME.fullmatch(name) or (kind == "source" and "_" in name) or len(name) > 50:
            raise InputError(
                f"this is no name for a {kind} in the name of a file",
                found=repr(name[:80]),
                needed='1 to 50 letters, none of / \\ : * ? " < > |, and no _ in a source',
                hint="S1 and R1",
            )
    return f"{source}_{receiver}.wav"


def check_not_measured(path: Path, *, again: bool) -> None:
    """Refuse a pair whose response is there, unless it is to be measured again."""
    if path.exists() and not again:
        raise InputError(
            "this pair was measured already",
            where=str(path),
            found="a response",
            needed="a pair without one, or the wish to measure again, which replaces it",
            hint="--again, or another --source or --receiver",
        )


def wav_bytes(response: ImpulseResponse) -> bytes:
    """Return a response as a WAV file of 32-bit floating point numbers."""
    import soundfile

    file, rate_hz = io.BytesIO(), round(response.sampling_rate_hz)
    soundfile.write(file, response.pressure, rate_hz, format="WAV", subtype="FLOAT")
    return file.getvalue()
