"""Recorded excitations: the impulse response from the recording of a sweep and the sweep itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.fft import next_fast_len

from roomfit.errors import InputError
from roomfit.files.responses.recording import Recording, clipping, refuse_useless
from roomfit.findings import Finding
from roomfit.typing import FloatArray

# Below this share of the excitation's peak (-60 dB, above the noise of a loopback) it is silent.
_SILENT = 1e-3
# Kept before the start of the excitation, faded in: the filter rings forth and back at the edges of
# the band, and cut off at once the ringing would leave a step.
_LEAD_S = 0.02
_LEAST_DECAY_S = 0.05
_BANDS_PER_OCTAVE = 12
_LOWEST_HZ = 10.0
_BELOW_FULL = 10.0 ** (-15.0 / 10.0)
# Share of the strongest line at which the inversion gives up inside the band (-200 dB in power).
_WITHIN = 1e-5
# A linear convolution of 60 s at 192 kHz; more is a mistaken file.
_MOST_SAMPLES = 2**26


def deconvolved(
    recording: Recording, excitation: Recording, path: Path, excitation_path: Path
) -> Recording:
    """Return the impulse response between an excitation and its recording.

    Its time zero is the start of the excitation's file: a recording that began with the playback
    needs no `latency_s` but that of its converters. The response ends where the recording no
    longer holds the decay of every frequency: as long after time zero as the recording goes on
    after the last sound of the excitation. Products of harmonic distortion of a rising sweep come
    out before time zero [1]_, the second by T ln 2 / ln(f2 / f1), and are cut away but for the
    last 20 ms; the room's answer to them goes on into the response, the less the longer the sweep.

    Parameters
    ----------
    recording, excitation : Recording
        At the same sampling rate. The excitation may be any broadband signal, or a loopback.
    path, excitation_path : Path
        Name both in messages.

    Raises
    ------
    InputError
        Two sampling rates, a recording that ends before the excitation does, silence, or samples
        that are not finite.

    Notes
    -----
    Division of spectra, regularised outside the band in which the excitation has energy [2]_,
    [3]_: there the response goes to nothing instead of to amplified noise. The filter has no phase.

    References
    ----------
    .. [1] A. Farina, "Simultaneous measurement of impulse response and distortion with a
           swept-sine technique", 108th AES Convention, preprint 5093 (2000).
    .. [2] S. Mueller and P. Massarani, "Transfer-function measurement with sweeps", J. Audio
           Eng. Soc. 49, 443-471 (2001).
    .. [3] pyfar, `pyfar.dsp.RegularizedSpectrumInversion`.
    """
    rate_hz = recording.sampling_rate_hz
    if abs(excitation.sampling_rate_hz / rate_hz - 1.0) > 1e-6:
        raise InputError(
            "recording and excitation have different sampling rates",
            where=str(path),
            found=f"{rate_hz:g} Hz, and {excitation.sampling_rate_hz:g} Hz in {excitation_path}",
            needed="one rate",
            hint="take the excitation as it was played, at the rate of the recording",
        )
    refuse_useless(recording, path)
    refuse_useless(excitation, excitation_path)
    n_kept = _kept(recording.pressure, excitation.pressure, rate_hz, path)
    low_hz, high_hz = band_of(excitation.pressure, rate_hz)
    response = _divided(recording.pressure, excitation.pressure, rate_hz, (low_hz, high_hz))
    n_lead = round(_LEAD_S * rate_hz)
    lead = response[len(response) - n_lead :]
    fade = np.sin(0.5 * np.pi * (np.arange(n_lead) + 0.5) / n_lead) ** 2
    pressure = np.concatenate([fade * lead, response[:n_kept]])
    text = (
        f"{path.name} was deconvolved with {excitation_path.name}, which has energy from "
        f"{low_hz:.3g} to {high_hz:.4g} Hz; {n_kept / rate_hz:.2f} s of response are left."
    )
    evidence = {"low_hz": low_hz, "high_hz": high_hz, "duration_s": n_kept / rate_hz}
    told = Finding("deconvolved", "info", text, evidence)
    clipped = clipping(recording.pressure, path, "The response deconvolved from it is distorted")
    findings = (*recording.findings, *excitation.findings, *clipped, told)
    return Recording(pressure, rate_hz, recording.delay_s - n_lead / rate_hz, findings)


def _kept(recorded: FloatArray, played: FloatArray, rate_hz: float, path: Path) -> int:
    """Return how many samples of the response hold all frequencies."""
    size = np.abs(played - np.median(played))
    sounding = int(np.flatnonzero(size > _SILENT * size.max())[-1]) + 1
    if len(recorded) + len(played) > _MOST_SAMPLES:
        raise InputError(
            "recording and excitation are too long together",
            where=str(path),
            found=f"{len(recorded)} and {len(played)} samples",
            needed=f"at most {_MOST_SAMPLES}",
        )
    if len(recorded) < sounding + _LEAST_DECAY_S * rate_hz:
        raise InputError(
            "the recording ends before the decay after the excitation",
            where=str(path),
            found=f"{len(recorded) / rate_hz:.4g} s",
            needed=f"the {sounding / rate_hz:.4g} s of the excitation, and the decay after it",
            hint="record until the room is silent",
        )
    return len(recorded) - sounding


def band_of(excitation: FloatArray, rate_hz: float) -> tuple[float, float]:
    """Return the frequencies between which an excitation has energy, in Hz.

    Its power is summed in twelfths of an octave. The band goes on, from the strongest, while
    either the power of each or its density per hertz is within 15 dB of the largest: so an
    exponential sweep (equal power in each) and a linear one (equal density) keep all they have.

    Parameters
    ----------
    excitation : float array, shape (n_samples,)
    rate_hz : float
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


def _divided(
    recorded: FloatArray, played: FloatArray, rate_hz: float, band_hz: tuple[float, float]
) -> FloatArray:
    """Return the quotient of the spectra over time, long enough that nothing wraps onto it."""
    import pyfar

    n = next_fast_len(len(recorded) + len(played), real=True)
    signal = pyfar.Signal(np.pad(recorded, (0, n - len(recorded))), rate_hz)
    source = pyfar.Signal(np.pad(played, (0, n - len(played))), rate_hz)
    strongest = float(np.max(np.abs(source.freq)) ** 2)
    inverse = pyfar.dsp.RegularizedSpectrumInversion.from_frequency_range(
        source, band_hz, regularization_within=_WITHIN, beta=strongest
    ).invert
    spectrum = signal.freq[0] * inverse.freq[0]
    return np.asarray(np.fft.irfft(spectrum, n))
