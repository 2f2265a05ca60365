"""One impulse response as measured: its onset, its clock, its echoes, and whether it is clipped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft
from scipy.ndimage import uniform_filter1d

from roomfit.base.arguments import check_range, float_array
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Edit, Finding, Remedy, Severity
from roomfit.base.typing import FloatArray

# Equal samples in a row, and equal peaks, at which a response counts as cut off; the levels that
# its converter must know for the latter, and the steps by which a crest falls beside its top.
_CLIPPED_RUN, _EQUAL_PEAKS, _FEW_LEVELS, _CREST_STEPS = 4, 5, 500.0, 3.0
_EARLY = "Early energy is wrong"


@dataclass(frozen=True, slots=True, eq=False)
class ImpulseResponse:
    """Sound pressure over time after an impulse."""

    pressure: FloatArray  # (n_samples,), unit as recorded
    sampling_rate_hz: float
    time_zero_s: float = 0.0  # Emission on the file's clock: sample 0 is at ``-time_zero_s``

    def __post_init__(self) -> None:
        check_range("sampling rate", self.sampling_rate_hz, 1000.0, 1e6, "Hz")
        object.__setattr__(self, "pressure", float_array("pressure", self.pressure, (None,)))

    @property
    def last_s(self) -> float:
        """Time of the last sample after emission."""
        return (len(self.pressure) - 1) / self.sampling_rate_hz - self.time_zero_s


def times_s(response: ImpulseResponse) -> FloatArray:
    """Return the time after emission of every sample, shape (n_samples,)."""
    samples = np.arange(len(response.pressure))
    return np.asarray(samples / response.sampling_rate_hz - response.time_zero_s)


def padded(response: ImpulseResponse, silence_s: float) -> ImpulseResponse:
    """Return the response with silence added before and after, at unchanged times after emission.

    At least `silence_s` on either side, in whole samples.
    """
    n = int(np.ceil(silence_s * response.sampling_rate_hz))
    return ImpulseResponse(
        np.pad(response.pressure, n),
        response.sampling_rate_hz,
        response.time_zero_s + n / response.sampling_rate_hz,
    )


_SLICE = 1024  # samples after the peak that tell two recordings apart nearly always
_UNEQUAL = 1e-6  # of the energy: what is left of one recording, less the other, is no rounding
_UNEQUAL_NOISE = 1e-2  # the same of the last quarter, where two recordings have noise of their own


def same_recordings(signals: Sequence[FloatArray]) -> tuple[tuple[int, int], ...]:
    """Return the pairs (first, later) of signals that are one recording, scaled or shifted.

    Shifted by whole samples, of either sign, cut at either end. A second recording of the same
    place is another one: its noise differs. Of several copies each is paired with the first.

    `signals` have the shape (n_samples,) and any lengths; silence equals nothing.
    """
    peaks = [int(np.argmax(np.abs(x))) for x in signals]
    slices = np.zeros((len(signals), _SLICE))
    for row, x, peak in zip(slices, signals, peaks, strict=True):
        own = x[peak : peak + _SLICE]
        row[: own.size] = own / max(float(np.linalg.norm(own)), np.finfo(float).tiny)
    alike = np.abs(slices @ slices.T) > 1.0 - 1e-3
    found: dict[int, int] = {}  # the first, by the copy
    for i, j in np.argwhere(np.triu(alike, 1)).tolist():
        if i in found or j in found:
            continue
        before = min(peaks[i], peaks[j])
        after = min(len(signals[i]) - peaks[i], len(signals[j]) - peaks[j])
        one, other = (signals[k][peaks[k] - before : peaks[k] + after] for k in (i, j))
        rest = (one - float(one @ other) / float(other @ other) * other) ** 2
        tail = slice(-(len(one) // 4) or None, None)
        quiet = float(np.sum(rest[tail])) <= _UNEQUAL_NOISE * float(np.sum(one[tail] ** 2))
        if quiet and float(np.sum(rest)) <= _UNEQUAL * float(one @ one):
            found[j] = i
    return tuple((i, j) for j, i in found.items())


# Above 800 Hz an echo is a millisecond long at most; above 8 kHz few loudspeakers radiate evenly.
_LOWEST_HZ, _HIGHEST_HZ = 800.0, 8000.0
_PADDING_S = 0.02  # the filter rings for less
_ECHO_S = 0.3e-3
_SURROUNDINGS_S = 10e-3
_FLOOR = 1e-9


def clipping_findings(pressure: FloatArray, name: str) -> tuple[Finding, ...]:
    """Return a finding where the peaks of a response were cut off; none of silence.

    Also where many separate peaks are equally high: short peaks that are cut off have no run of
    equal samples; but no two reflections of a room are equal, let alone five, unless a converter
    knows only a few levels.
    """
    if not np.ptp(pressure) > 0.0:
        return ()
    found = clipping(pressure, name, _EARLY)
    size, steps = np.abs(pressure), np.abs(np.diff(pressure))
    largest = float(size.max())
    if found or largest < _FEW_LEVELS * float(steps[steps > 0.0].min()):
        return found
    beside = np.minimum(np.append(0.0, size[:-1]), np.append(size[1:], 0.0))
    is_peak = (size >= largest * (1.0 - 1e-6)) & (beside < 0.99 * largest)
    n_peaks = int(np.count_nonzero(is_peak))
    if n_peaks < _EQUAL_PEAKS:
        return ()
    evidence = {"equal_peaks": n_peaks, "largest": largest}
    return (_clipped(name, f"{n_peaks} peaks have", _EARLY, evidence),)


def clipping(pressure: FloatArray, name: str, harm: str) -> tuple[Finding, ...]:
    """Return a finding where the peak was cut off: a run of equal samples with steep sides.

    A peak is one sample or two. The crest of a low tone has more samples that a coarse converter
    takes for equal, but beside them it falls by a step or two of the converter only. `harm` says
    what it does to the result.
    """
    size, steps = np.abs(pressure), np.abs(np.diff(pressure))
    # full scale downwards is one step farther than upwards
    repeated = (steps == 0.0) & (size[1:] >= size.max() * (1.0 - 1e-4))
    edges = np.flatnonzero(np.diff(np.concatenate(([0], repeated.astype(np.int8), [0]))))
    first, last = edges[::2], edges[1::2]
    beside = np.concatenate(([0.0], steps, [0.0]))
    crest = _CREST_STEPS * float(steps[steps > 0.0].min())
    steep = np.maximum(beside[first], beside[last + 1]) > crest
    longest = int(np.max((last - first)[steep], initial=0)) + 1
    if longest < _CLIPPED_RUN:
        return ()
    many = f"{longest} samples in a row have"
    return (_clipped(name, many, harm, {"longest_run": longest, "largest": float(size.max())}),)


def _clipped(name: str, many: str, harm: str, evidence: dict[str, float]) -> Finding:
    text = f"{name} looks clipped: {many} the largest value, {evidence['largest']:.4g}. {harm}; "
    text += "measure again at a lower level."
    return Finding(Code.RESPONSE_CLIPPED, About(files=[name]), text, evidence)


def echo_prominence(response: ImpulseResponse) -> FloatArray:
    """Return by how much the energy of each sample exceeds its surroundings, shape (n_samples,).

    The natural logarithm of the squared envelope between 0.8 and 8 kHz, over 0.3 ms, less its mean
    over 10 ms: 0 on average, 2 to 4 for a strong wall reflection. Zeros where the sampling rate
    leaves no such band.
    """
    rate_hz = response.sampling_rate_hz
    high_hz = min(_HIGHEST_HZ, 0.45 * rate_hz)
    if high_hz < 2.0 * _LOWEST_HZ:
        return np.zeros(len(response.pressure))
    # a Butterworth filter forth and back; scipy.signal's takes half a second to load
    n = fft.next_fast_len(len(response.pressure) + round(_PADDING_S * rate_hz))
    w = np.tan(np.pi * fft.fftfreq(n))
    low, high = np.tan(np.pi / rate_hz * np.array([_LOWEST_HZ, high_hz]))
    band = 2.0 * (w > 0.0) * w**8 / (w**8 + ((w**2 - low * high) / (high - low)) ** 8)
    analytic = fft.ifft(fft.fft(response.pressure, n) * band)[: len(response.pressure)]
    squared = np.abs(analytic) ** 2
    energy = uniform_filter1d(squared, max(round(_ECHO_S * rate_hz), 1))
    level = np.log(energy + _FLOOR * float(energy.max(initial=0.0)) + np.finfo(float).tiny)
    return np.asarray(level - uniform_filter1d(level, max(round(_SURROUNDINGS_S * rate_hz), 1)))


_BELOW_PEAK = 10.0 ** (-20.0 / 20.0)
# A normal noise exceeds 5 standard deviations once in 1.7 million samples.
_ABOVE_NOISE = 5.0
_TOLERANCE_M = 0.1
_ONSET_SAMPLES = 3.0  # error of `find_onset` itself, of half of all clicks of full bandwidth
# Larger than any error of a position: early and late windows contain the wrong reflections.
SERIOUS_M = 3.0


def find_onset(response: ImpulseResponse, where: str | None = None) -> float:
    """Return when the direct sound arrives, in seconds after emission.

    The moment when the pressure first comes within 20 dB of its peak [1]_ and exceeds the noise,
    interpolated between samples. A single sample is thus found 0.9 samples early. A click whose
    spectrum ends steeply rings before its peak: it is found 1 to 5.1 samples early, 2.6 in the
    median of full bandwidth, and where it ends at a share of the Nyquist frequency of a half or
    less, 2.7 samples over that share: 7 at 0.4.

    `where`, optional: names the response in a message.

    Notes
    -----
    Noise is the quietest tenth of the file; an offset is subtracted first.

    References
    ----------
    .. [1] ISO 3382-1:2009, annex A: the response begins where it rises clearly out of the
           background, and is more than 20 dB below its maximum before.
    """
    pressure = response.pressure - np.median(response.pressure)
    size = np.abs(pressure)
    peak = float(size.max(initial=0.0))
    tenths = [np.mean(part**2) for part in np.array_split(pressure, 10) if part.size]
    noise = _ABOVE_NOISE * float(np.sqrt(min(tenths)))
    if not noise < peak:
        what = "no direct sound was found in the response"
        found = f"a peak of {peak:.3g} and noise of {noise / _ABOVE_NOISE:.3g} (rms)"
        needed = f"a peak at least {_ABOVE_NOISE:g} times the noise"
        hint = "another channel may contain the response, or the file may be noise only"
        raise InputError(what, where=where, found=found, needed=needed, hint=hint)
    threshold = max(_BELOW_PEAK * peak, min(noise, 0.5 * peak))
    first = int(np.argmax(size >= threshold))
    sample = float(first)
    if first > 0:
        before = float(size[first - 1])
        sample -= (float(size[first]) - threshold) / (float(size[first]) - before)
    return sample / response.sampling_rate_hz - response.time_zero_s


def find_peak(response: ImpulseResponse, onset_s: float) -> float:
    """Return when a pulse that is as short as its sampling rate allows has its peak.

    In seconds after emission: a parabola through the first maximum of half of the largest pressure
    of the eight samples after the onset of `find_onset`, or more: a steep filter rings for as long
    before. A pulse that has half of its peak two samples before is a loudspeaker's and begins at
    its onset, which is returned.
    """
    size = np.abs(response.pressure - np.median(response.pressure))
    first = max(int(np.ceil((onset_s + response.time_zero_s) * response.sampling_rate_hz)), 2)
    near = size[first - 2 : first + 9]
    rise, before, own, after = near[:-3], near[1:-2], near[2:-1], near[3:]
    largest = own.max(initial=0.0)
    at = int(np.argmax((own >= before) & (own > after) & (own >= 0.5 * largest)))
    if not largest > 0.0 or rise[at] > 0.5 * own[at] or not own[at] > after[at]:
        return onset_s
    shift = 0.5 * (after[at] - before[at]) / (2.0 * own[at] - before[at] - after[at])
    return float((first + at + shift) / response.sampling_rate_hz - response.time_zero_s)


def check_travel(response: ImpulseResponse, travel_s: float, where: str | None = None) -> None:
    """Refuse a response that ends before the direct sound can have arrived.

    `travel_s`: distance over speed of sound.
    """
    end_s = len(response.pressure) / response.sampling_rate_hz - response.time_zero_s
    if end_s <= travel_s:
        raise InputError(
            "the response ends before the direct sound arrives",
            where=where,
            found=f"the file ends {1000.0 * abs(end_s):.1f} ms "
            f"{'after' if end_s >= 0.0 else 'before'} emission",
            needed=f"more than {1000.0 * travel_s:.1f} ms, the travel time of the direct sound",
            hint="check the positions, the unit of the room, the latency and the file",
        )


def onset_tolerance_m(speed_of_sound_m_s: float, sampling_rate_hz: float) -> float:
    """Return by how much an onset may differ from the geometry, in m of path."""
    return _TOLERANCE_M + _ONSET_SAMPLES / sampling_rate_hz * speed_of_sound_m_s


def compare_onset(
    onset_s: float,
    travel_s: float,
    speed_of_sound_m_s: float,
    where: str,
    sampling_rate_hz: float,
    *,
    is_stated: bool = True,
) -> tuple[Finding, ...]:
    """Return a finding where the onset and the geometry disagree by more than 10 cm.

    The length of three samples is added to that; the finding is serious from 3 m on.

    `onset_s`: measured, from `find_onset`. `travel_s`: distance over speed of sound. `where`: names
    the response in the sentence. `is_stated`: whether emission is by the file's clock and latency;
    else it was estimated from several files, and a latency changes nothing.
    """
    apart_m = (onset_s - travel_s) * speed_of_sound_m_s
    if abs(apart_m) <= onset_tolerance_m(speed_of_sound_m_s, sampling_rate_hz):
        return ()
    sentence = (
        f"{where}: the direct sound arrives {1000.0 * abs(onset_s - travel_s):.2f} ms "
        f"{'later' if apart_m > 0.0 else 'earlier'} "
        f"than the geometry says, which is {abs(apart_m):.2f} m of path"
        f"{', before it was emitted' * (onset_s < 0.0)}. Check the positions, "
        "latency_s, time_zero and whether it is the file of this pair; sound that is blocked "
        "or that a loudspeaker sends elsewhere arrives late, too."
    )
    evidence = {"onset_s": onset_s, "travel_s": travel_s, "difference_m": apart_m}
    files, now = ("measurements", "*"), ["emission"] if is_stated else ["unknown"]
    advised = [Remedy([Edit(files, "time_zero", "direct", now=now)])]
    graded: Severity = "serious" if abs(apart_m) > SERIOUS_M else "warning"
    if graded == "serious" and is_stated:
        advised.append(Remedy([Edit(files, "latency_s", onset_s - travel_s, "add")], once=True))
    own = About(files=[where]), sentence, evidence
    return (Finding(Code.TIME_ZERO_MISMATCH, *own, graded=graded, remedies=advised),)


def time_zero_from_direct(
    response: ImpulseResponse, travel_s: float, where: str | None = None
) -> ImpulseResponse:
    """Return the response on a clock by which its direct sound arrives after the travel time.

    For files that begin at the direct sound, or at an arbitrary instant.
    """
    shift_s = find_onset(response, where) - travel_s
    return replace(response, time_zero_s=response.time_zero_s + shift_s)
