"""What a reader of a response returns, its checks, and deconvolution."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from roomfit.base.errors import InputError, located
from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import FloatArray
from roomfit.signals.response import clipping, clipping_findings

_SHORTEST_S = 0.01
_LOUDEST, _SOFTEST = 1e12, 1e-30  # their squares are far from the range of a float
# Below this share of the peak an offset is far below any noise floor that matters (-80 dB).
_LEAST_OFFSET = 1e-4
# Of a sum of sizes, what is left of one sign; of the largest, rounding of the other sign, and half
# of all samples of a level in dB; samples of the other sign, above 0 dB.
_ONE_SIDED, _OTHER_SIGN, _LEVELS, _FEW = 0.7, 1e-3, 0.1, 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """One channel of a file."""

    pressure: FloatArray  # (n_samples,); not yet checked: may contain nan
    sampling_rate_hz: float
    # of the first sample after the time zero of the file, by the file itself
    delay_s: float = 0.0
    findings: tuple[Finding, ...] = ()


class UnchosenChannelError(InputError):
    """A file has several channels, with whose number `found` begins, and none was chosen."""


def pick(kind: str, index: int | None, count: int, key: str) -> int:
    """Return the index that was asked for, which must exist; 0 where there is only one."""
    numbers = "0" if count == 1 else f"0 to {count - 1}"
    if index is None and count == 1:
        return 0
    if index is None:
        what = f"the file holds several {kind}s and none was chosen"
        found = f"{count} {kind}s, {numbers}"
        hint = f"what holds of all files stands once: {key} = 0 under [defaults]"
        if key == "channel":
            hint += f", as roomfit check CAMPAIGN --remedy {Code.RECORDING_UNUSABLE}:1 writes it"
        error = UnchosenChannelError if key == "channel" else InputError
        raise error(what, found=found, needed=f"{key} = a number from {numbers}", hint=hint)
    if not 0 <= index < count:
        what, needed = f"the file has no such {kind}", f"{key} = {numbers} ({kind}s count from 0)"
        hint = "look at the file in an editor of sound, and count from 0"
        raise InputError(what, found=f"{key} = {index}", needed=needed, hint=hint)
    return index


def checked(recording: Recording, name: str) -> tuple[FloatArray, tuple[Finding, ...]]:
    """Return the pressure without a constant offset, and a finding for every doubt.

    An offset is subtracted where the quiet end of the file is mostly offset. The mean of the whole
    would be wrong: every response has some. What stays of an offset makes a step at both ends of
    the file, which low bands take for sound.
    """
    pressure = recording.pressure
    refuse_useless(recording, swings=True)
    findings = (*recording.findings, *clipping_findings(pressure, name))
    end = pressure[-max(1, len(pressure) // 4) :]
    mean, peak = float(end.mean()), float(np.abs(pressure).max())
    if abs(mean) <= _LEAST_OFFSET * peak or abs(mean) <= 2.0 * float(end.std()):
        return pressure, findings
    text = (
        f"{name} has a constant offset of {mean:.3g} ({abs(mean) / peak:.2%} of its "
        "peak); it was subtracted."
    )
    evidence = {"offset": mean, "relative_to_peak": mean / peak}
    found = Finding(Code.DC_OFFSET, About(files=[name]), text, evidence)
    return pressure - mean, (*findings, found)


def _is_curve(pressure: FloatArray) -> bool:
    """Return whether a file has one sign, or is as large as levels are, and swings about no value.

    Of the sizes after the largest the sum leaves .08 at most in measured rooms, .88 and more in
    curves; of images that a simulator adds with one sign it leaves as much, but some swing. Levels
    of single samples swing, too, by 30 dB up to the end, where a response is as good as still.
    """
    n, largest = max(len(pressure) // 8, 1), float(np.abs(pressure).max())
    other = min(-float(pressure.min()), float(pressure.max()))
    end_range = float(np.ptp(np.quantile(pressure[-n:], (0.05, 0.95))))
    other_share = min(np.mean(pressure > 0.0), np.mean(pressure < 0.0))
    if other_share < _FEW and end_range > _LEVELS * np.ptp(pressure):
        return True
    if other > _OTHER_SIGN * largest and np.median(np.abs(pressure)) < _LEVELS * largest:
        return False
    centred = pressure - np.median(pressure[-n:])
    size = np.abs(centred)
    after = centred[int(np.argmax(size)) + 1 :][: n - 1]
    after = after[np.abs(after) > _OTHER_SIGN * largest]
    return abs(float(after.sum())) > _ONE_SIDED * float(np.abs(after).sum())


def refuse_useless(recording: Recording, *, swings: bool = False) -> None:
    """Refuse what cannot be sound: too short, not finite, too loud, or nothing but silence.

    And what does not swing, as a response does.
    """
    pressure = recording.pressure
    duration_s = len(pressure) / recording.sampling_rate_hz
    bad = np.flatnonzero(~np.isfinite(pressure))
    largest = float(np.abs(pressure).max(initial=0.0))
    if duration_s < _SHORTEST_S:
        what, found = "is too short", f"{len(pressure)} samples, {1000.0 * duration_s:.3g} ms"
        needed, hint = f"at least {1000.0 * _SHORTEST_S:g} ms", "copy or export the file again"
    elif bad.size:
        what, needed = "holds samples that are not finite numbers", "finite pressures"
        found = f"{bad.size} of {len(pressure)}, the first at sample {bad[0]}"
        hint = "look at how the file was made: a division by an empty spectrum leaves nan"
    elif largest > _LOUDEST:
        what, found = "holds values that no pressure has", f"{largest:.3g}"
        needed = f"at most {_LOUDEST:g} in whatever unit"
        hint = "the file may be damaged, or of another number format than it says"
    elif np.ptp(pressure) <= _SOFTEST:
        what, found = "is silent", f"{len(pressure)} samples, all of them {pressure[0] + 0.0:g}"
        needed, hint = "a response, which rises and decays", "another channel may hold it"
    elif swings and _is_curve(pressure):
        what, needed = "does not swing: energy, an envelope, levels in dB?", "sound pressure"
        found = f"{pressure.min():.3g} to {pressure.max():.3g}, on one side of zero or of the end"
        hint = "export the impulse response itself, neither squared, integrated nor in dB"
    else:
        return
    raise InputError(f"the response {what}", found=found, needed=needed, hint=hint)


# Below this share of the excitation's peak (-60 dB, above the noise of a loopback) it is silent.
_SILENT = 1e-3
# Kept before the start of the excitation, faded in: the filter rings forth and back at the edges of
# the band, and cut off at once the ringing would leave a step.
_LEAD_S = 0.02
_LEAST_DECAY_S = 0.05
_EARLIEST_S, _CLEAR = 0.1, 10.0  # before a peak; a peak over the rms of all lags, no noise's
_BANDS_PER_OCTAVE = 12
_LOWEST_HZ = 10.0
_BELOW_FULL = 10.0 ** (-15.0 / 10.0)
# Share of the strongest line at which the inversion gives up inside the band (-200 dB in power).
_WITHIN = 1e-5
# A linear convolution of 60 s at 192 kHz; more is a mistaken file.
_MOST_SAMPLES = 2**26


def deconvolved(
    recording: Recording,
    excitation: Recording,
    path: Path,
    excitation_path: Path,
    band_hz: tuple[float, float] | None = None,
) -> Recording:
    """Return the impulse response between an excitation and its recording.

    Its time zero is the start of the excitation's file: a recording that began with the playback
    needs no `latency_s` but that of its converters. It begins 20 ms before time zero, or before its
    onset where a recording began later than the playback, in the silence of its file, and ends
    where the recording no longer contains the decay of every frequency: as long after time zero as
    the recording goes on after the last sound of the excitation. Products of harmonic distortion of
    a rising sweep come out before the response [1]_, the second by T ln 2 / ln(f2 / f1), and are
    cut away; the room's answer to them goes on into the response, the less the longer the sweep.

    Notes
    -----
    Division of spectra, regularised outside the band in which the excitation has energy [2]_, see
    `regularised_quotient`: there the response goes to nothing instead of to amplified noise. The
    filter has no phase.

    References
    ----------
    .. [1] A. Farina, "Simultaneous measurement of impulse response and distortion with a
           swept-sine technique", 108th AES Convention, preprint 5093 (2000).
    .. [2] S. Mueller and P. Massarani, "Transfer-function measurement with sweeps", J. Audio
           Eng. Soc. 49, 443-471 (2001).
    """
    rate_hz = recording.sampling_rate_hz
    with located(str(path)):
        if abs(excitation.sampling_rate_hz / rate_hz - 1.0) > 1e-6:
            what = "recording and excitation have different sampling rates"
            found = f"{rate_hz:g} Hz, and {excitation.sampling_rate_hz:g} Hz in {excitation_path}"
            hint = "take the excitation as it was played, at the rate of the recording"
            raise InputError(what, found=found, needed="one rate", hint=hint)
        refuse_useless(recording)
    with located(str(excitation_path)):
        refuse_useless(excitation)
    low_hz, high_hz = band_hz or band_of(excitation.pressure, rate_hz)
    with located(str(path)):
        first, n_kept = _kept(recording.pressure, excitation.pressure)
        response = regularised_quotient(
            recording.pressure, excitation.pressure, rate_hz, (low_hz, high_hz)
        )
        begin = _begin(response, first, n_kept, len(excitation.pressure), rate_hz)
    n_lead = round(_LEAD_S * rate_hz)
    # the last samples of the circular response come before its first ones
    pressure = response[np.arange(begin - n_lead, n_kept)]
    pressure[:n_lead] *= np.sin(0.5 * np.pi * (np.arange(n_lead) + 0.5) / n_lead) ** 2
    kept_s = (n_kept - begin) / rate_hz
    text = (
        f"{path.name} was deconvolved with {excitation_path.name}, which has energy from "
        f"{low_hz:.3g} to {high_hz:.4g} Hz; {kept_s:.2f} s of response are left."
    )
    evidence = {"low_hz": low_hz, "high_hz": high_hz, "duration_s": kept_s}
    finding = Finding(Code.DECONVOLVED, About(files=[path.name]), text, evidence)
    clipped = clipping(
        recording.pressure, path.name, "The response deconvolved from it is distorted"
    )
    findings = (*recording.findings, *excitation.findings, *clipped, finding)
    return Recording(pressure, rate_hz, recording.delay_s + (begin - n_lead) / rate_hz, findings)


def _kept(recorded: FloatArray, played: FloatArray) -> tuple[int, int]:
    """Return between which lags the response contains all frequencies, the last not included."""
    size = np.abs(played - np.median(played))
    loud = np.flatnonzero(size > _SILENT * size.max())
    silent, end = int(loud[0]), int(loud[-1]) + 1
    if len(recorded) + len(played) > _MOST_SAMPLES:
        what = "recording and excitation are too long together"
        found = f"{len(recorded)} and {len(played)} samples"
        hint = "cut the recording behind the decay, or play a shorter sweep"
        raise InputError(what, found=found, needed=f"at most {_MOST_SAMPLES}", hint=hint)
    return -silent, len(recorded) - end


def _begin(response: FloatArray, first: int, n_kept: int, n_played: int, rate_hz: float) -> int:
    """Return the lag at which a response begins; refuse one at which frequencies are missing.

    0, unless its peak is earlier: then 0.1 s before that, where harmonic distortion is not yet.
    """
    lags = np.arange(-n_played, len(response) - n_played)
    size = np.abs(response[lags])
    largest, peak = float(size.max()), int(lags[np.argmax(size)])
    is_clear = largest > _CLEAR * float(np.sqrt(np.mean(size**2)))
    is_short = n_kept - first < _LEAST_DECAY_S * rate_hz
    if is_short or (is_clear and not first - _LEAD_S * rate_hz <= peak < n_kept):
        late, early = "began after the excitation", "ends before the decay after the excitation"
        what = f"the recording {late if peak < first else early}"
        found = f"its response {peak / rate_hz:.3g} s after the start of the excitation's file"
        needed = f"{first / rate_hz:.3g} to {n_kept / rate_hz:.3g} s, where no frequency is missing"
        hint = "record from before the sweep until the room is silent after it"
        raise InputError(what, found=found, needed=needed, hint=hint)
    return 0 if peak >= 0 else max(peak - round(_EARLIEST_S * rate_hz), first)


def band_of(excitation: FloatArray, rate_hz: float) -> tuple[float, float]:
    """Return the frequencies between which an excitation has energy, in Hz.

    Its power is summed in twelfths of an octave. The band goes on, from the strongest, while
    either the power of each or its density per hertz is within 15 dB of the largest: so an
    exponential sweep (equal power in each) and a linear one (equal density) keep all they have.
    A loopback through a chain that rolls off keeps what is 15 dB down: the quotient is right there,
    and its noise 15 dB higher at most, which every band is judged by.
    """
    n_lines = next_fast_len(max(len(excitation), int(2.0 * rate_hz)), real=True)
    power = np.abs(np.fft.rfft(excitation, n_lines)) ** 2
    n_bands = int(_BANDS_PER_OCTAVE * np.log2(0.5 * rate_hz / _LOWEST_HZ))
    edges_hz = 0.5 * rate_hz * 2.0 ** (np.arange(-n_bands, 1) / _BANDS_PER_OCTAVE)
    at = np.round(edges_hz / rate_hz * n_lines).astype(np.int64)
    at = np.minimum(at, len(power))
    total = np.diff(np.concatenate(([0.0], np.cumsum(power)))[at])
    density = total / np.maximum(np.diff(at), 1)
    full = (total >= _BELOW_FULL * total.max()) | (density >= _BELOW_FULL * density.max())
    low = high = int(np.argmax(total))
    while low > 0 and full[low - 1]:
        low -= 1
    while high < len(full) - 1 and full[high + 1]:
        high += 1
    return float(edges_hz[low]), float(edges_hz[high + 1])


def regularised_quotient(
    recorded: FloatArray, played: FloatArray, rate_hz: float, band_hz: tuple[float, float]
) -> FloatArray:
    """Return the quotient of two spectra over time, long enough that nothing wraps onto it.

    ``Y conj(X) / (|X|^2 + beta e^2)`` with the largest ``|X|^2`` as beta; e is 1e-5 within the band
    and 1 outside it, cross-faded over half an octave [1]_.

    References
    ----------
    .. [1] S. G. Norcross, M. Bouchard and G. A. Soulodre, "Inverse filtering design using a
           minimal-phase target function from regularization", 121st AES Convention, paper 6929
           (2006).
    """
    n = next_fast_len(len(recorded) + len(played), real=True)
    played_spectrum = rfft(played, n)
    power = np.abs(played_spectrum) ** 2
    frequency_hz, (low_hz, high_hz) = rfftfreq(n, 1.0 / rate_hz), band_hz
    # cross-faded as the square of a cosine over half an octave outside the band
    inside = np.ones(len(frequency_hz))
    start, end = (int(np.argmin(np.abs(frequency_hz - f))) for f in (low_hz / np.sqrt(2.0), low_hz))
    inside[:start] = 0.0
    inside[start:end] = _rise(end - start)
    if high_hz < 0.5 * rate_hz:
        top_hz = min(high_hz * np.sqrt(2.0), 0.5 * rate_hz)
        start, end = (int(np.argmin(np.abs(frequency_hz - f))) for f in (high_hz, top_hz))
        inside[start:end] *= _rise(end - start)[::-1]
        inside[end:] = 0.0
    regularisation = _WITHIN * inside + (1.0 - inside)
    inverse = np.conj(played_spectrum) / (power + power.max() * regularisation**2)
    return np.asarray(irfft(rfft(recorded, n) * inverse, n), dtype=np.float64)


def _rise(n: int) -> FloatArray:
    """Return n steps from 0 to 1, neither end among them, as the square of a sine."""
    return np.asarray(np.sin(0.5 * np.pi * np.arange(1, n + 1) / (n + 1)) ** 2)
