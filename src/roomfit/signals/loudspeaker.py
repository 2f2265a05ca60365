"""The magnitude response of a loudspeaker within a band: estimated, and equalised."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import fft

from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray
from roomfit.signals.response import ImpulseResponse

# Levels are given every half octave, each over an octave that fades to either side: fine enough for
# a slope within an octave band, too coarse for single modes of the room.
_STEP_OCTAVES, _REACH_OCTAVES = 0.5, 0.5
_FADE_S, _FEWEST = 0.01, 3
_DOUBT = 2.0  # times the variance by chance is subtracted before a level counts
_HIGHEST = 0.45  # of the sampling rate
_MOST_DB = 30.0
# A smaller rms level over frequency arises from the first guess of the walls alone (0.3 dB in boxes
# of another program), and does no harm where it is real.
_LEAST_DB = 1.0
# Equalised sound may begin a little earlier and ring a little longer: padded against wrap-around.
_PADDING = 4


class SourceMagnitude(NamedTuple):
    """Level of a source over frequency, about its own mean."""

    frequencies_hz: FloatArray  # (n,): rising
    level_db: FloatArray  # (n,)


def source_magnitude(
    measured: Sequence[ImpulseResponse],
    reference: Sequence[ImpulseResponse],
    until_s: Sequence[float],
    lowest_hz: float,
    schroeder_hz: float,
) -> SourceMagnitude:
    """Return the level of one source from its responses and those of a source with flat magnitude.

    Power is summed over the responses and over an octave about each frequency, half an octave
    apart, and then divided: the room's part cancels. The level is shrunk towards zero by as much as
    the responses disagree on it; it is zero for fewer than three responses, where its rms is below
    1 dB, and where all that is asked for lies above half of the sampling rate.

    `measured`: of one sampling rate. `reference`: those that a model predicts for the same pairs,
    up to one factor for all. `until_s`: how long after emission each pair is to be compared.
    `lowest_hz`: where the lowest band begins. `schroeder_hz`: about here and below, single modes of
    the room decide, which no first guess of its walls predicts: the level is weighted down.
    """
    rates = {r.sampling_rate_hz for r in (*measured, *reference)}
    if len(rates) != 1:
        what = "responses of a source differ in sampling rate, or there is none"
        found = f"{len(measured)} responses, rates {sorted(rates)}"
        hint = "leave out responses of other rates, or resample them"
        raise InputError(what, found=found, needed="one or more, of one rate", hint=hint)
    octaves = float(np.log2(_HIGHEST * rates.pop() / lowest_hz))
    nodes = lowest_hz * 2.0 ** np.arange(0.0, max(octaves, 0.0) + 1e-9, _STEP_OCTAVES)
    if len(measured) < _FEWEST or measured[0].sampling_rate_hz < 2.0 * lowest_hz:
        return SourceMagnitude(nodes, np.zeros(nodes.size))
    observed, expected = (_powers(all_of, until_s, nodes) for all_of in (measured, reference))
    whole = observed.sum(axis=0) / expected.sum(axis=0)
    level, each = (10.0 * np.log10(np.maximum(x, 1e-30)) for x in (whole, observed / expected))
    level = np.maximum(level, level.max() - _MOST_DB)
    spread = np.var(each, axis=0, ddof=1) / len(measured)
    level -= np.average(level, weights=1.0 / np.maximum(spread, 1e-6))
    # the magnitude response is what exceeds chance: less of it where responses contradict
    colour = max(float(np.mean(level**2 - _DOUBT * spread)), 0.0)
    trust = 1.0 / (1.0 + (schroeder_hz / nodes) ** 4)
    level = level * trust * colour / np.maximum(colour + spread, 1e-6)
    observed_db = float(np.sqrt(np.mean(level**2)))
    return SourceMagnitude(nodes, level if observed_db >= _LEAST_DB else np.zeros(nodes.size))


def _powers(
    responses: Sequence[ImpulseResponse], until_s: Sequence[float], nodes_hz: FloatArray
) -> FloatArray:
    """Return each response's power about each of some frequencies, (n_responses, n_nodes)."""
    observed = []
    for r, end_s in zip(responses, until_s, strict=True):
        t = np.arange(r.pressure.size) / r.sampling_rate_hz - r.time_zero_s
        fade = np.clip((end_s - t) / _FADE_S, 0.0, 1.0)
        observed.append(np.asarray(r.pressure * fade)[fade > 0.0])
    n = fft.next_fast_len(2 * max(h.size for h in observed), real=True)
    f = fft.rfftfreq(n, 1.0 / responses[0].sampling_rate_hz)[1:]
    power = np.stack([np.abs(fft.rfft(h, n)[1:]) ** 2 for h in observed])
    away = np.log2(f[None, :] / nodes_hz[:, None]) / _REACH_OCTAVES
    # equal weight to equal shares of an octave
    weight = np.where(np.abs(away) < 1.0, np.cos(0.5 * np.pi * away) ** 2, 0.0) / f
    return np.asarray(np.maximum((power @ weight.T) / weight.sum(axis=1), 1e-300))


def equalise(response: ImpulseResponse, magnitude: SourceMagnitude) -> ImpulseResponse:
    """Return the response of a source of the same mean level with flat magnitude.

    Loudspeakers are nearly of minimum phase, so the inverse is, too: its phase is the Hilbert
    transform of its log magnitude, by folding the cepstrum [1]_. The delay that goes with the
    magnitude is removed; times after emission keep their meaning.

    References
    ----------
    .. [1] A. V. Oppenheim, R. W. Schafer, Discrete-Time Signal Processing, 3rd ed., 2010,
           section 13.
    """
    n = fft.next_fast_len(_PADDING * response.pressure.size, real=True)
    n += n % 2
    f = fft.rfftfreq(n, 1.0 / response.sampling_rate_hz)
    cepstrum = fft.irfft(-_level_at(magnitude, f) * np.log(10.0) / 20.0)
    cepstrum[1 : n // 2] *= 2.0
    cepstrum[n // 2 + 1 :] = 0.0
    spectrum = fft.rfft(response.pressure, n) * np.exp(fft.rfft(cepstrum))
    return replace(response, pressure=fft.irfft(spectrum, n)[: response.pressure.size])


def power_gain(colour: SourceMagnitude, frequency_hz: FloatArray) -> FloatArray:
    """Return the factor by which `equalise` multiplies power at some frequencies."""
    return np.asarray(10.0 ** (-0.1 * _level_at(colour, np.asarray(frequency_hz))))


def _level_at(colour: SourceMagnitude, frequency_hz: FloatArray) -> FloatArray:
    octaves = np.log2(np.maximum(frequency_hz, 1.0))
    return np.interp(octaves, np.log2(colour.frequencies_hz), colour.level_db)
