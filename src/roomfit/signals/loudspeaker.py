"""What a loudspeaker does within a band: heard in its responses, and taken out of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from roomfit._checks import float_array
from roomfit.errors import InputError
from roomfit.signals.response import ImpulseResponse
from roomfit.typing import ComplexArray, FloatArray

# Levels are told every half octave, each over an octave that fades to either side: fine enough for
# a slope within an octave band, too coarse for single modes of the room.
_STEP_OCTAVES = 0.5
_REACH_OCTAVES = 0.5
_FADE_S = 0.01
_FEWEST = 3
_DOUBT = 2.0  # times the variance of chance, before anything counts as colour
_HIGHEST = 0.45  # of the sampling rate
_MOST_DB = 30.0
# Less colour than this, in the mean over frequency, is what a first guess of the walls makes of
# a source without any (0.3 dB in boxes of another program), and does no harm where it is real.
_LEAST_DB = 1.0
# Equalised sound may begin a little before and ring a little after: padded against wrapping round.
_PADDING = 4


@dataclass(frozen=True, slots=True, eq=False)
class SourceMagnitude:
    """Level of a source over frequency, about its own mean."""

    frequencies_hz: FloatArray  # (n,): rising
    level_db: FloatArray  # (n,)

    def __post_init__(self) -> None:
        f = float_array("frequencies", self.frequencies_hz, (None,), low=1.0, unit="Hz")
        object.__setattr__(self, "frequencies_hz", f)
        level = float_array("levels", self.level_db, (len(f),), unit="dB")
        object.__setattr__(self, "level_db", level)


def source_magnitude(
    measured: Sequence[ImpulseResponse],
    reference: Sequence[ImpulseResponse],
    until_s: Sequence[float],
    lowest_hz: float,
    schroeder_hz: float,
) -> SourceMagnitude:
    """Return the level of one source: its responses beside those of a source without colour.

    Power is summed over the responses and over an octave about each frequency, half an octave
    apart, and then divided: what the room does to both is gone. The level is drawn towards none by
    as much as the responses disagree on it; of fewer than three nothing is told, and neither is a
    colour of less than 1 dB.

    Parameters
    ----------
    measured : sequence of ImpulseResponse
        Of one sampling rate.
    reference : sequence of ImpulseResponse
        What a model says of the same pairs, up to one factor for all.
    until_s : sequence of float
        How long after emission each pair is to be compared.
    lowest_hz : float
        Where the lowest band begins.
    schroeder_hz : float
        About here and below, single modes of the room decide, which no first guess of its walls
        predicts: less and less colour is told.

    Raises
    ------
    InputError
        No response, or different sampling rates.
    """
    rates = {r.sampling_rate_hz for r in (*measured, *reference)}
    if len(rates) != 1:
        raise InputError(
            "responses of a source differ in sampling rate, or there is none",
            found=f"{len(measured)} responses, rates {sorted(rates)}",
            needed="one or more, of one rate",
        )
    octaves = float(np.log2(_HIGHEST * rates.pop() / lowest_hz))
    nodes = lowest_hz * 2.0 ** np.arange(0.0, max(octaves, 0.0) + 1e-9, _STEP_OCTAVES)
    if len(measured) < _FEWEST:
        return SourceMagnitude(nodes, np.zeros(nodes.size))
    observed, expected = (_powers(all_of, until_s, nodes) for all_of in (measured, reference))
    level = _decibel(observed.sum(axis=0) / expected.sum(axis=0))
    level = np.maximum(level, level.max() - _MOST_DB)
    spread = np.var(_decibel(observed / expected), axis=0, ddof=1) / len(measured)
    level -= np.average(level, weights=1.0 / np.maximum(spread, 1e-6))
    # colour is what exceeds chance: where responses contradict each other, there is less of it
    colour = max(float(np.mean(level**2 - _DOUBT * spread)), 0.0)
    trust = 1.0 / (1.0 + (schroeder_hz / nodes) ** 4)
    level = level * trust * colour / np.maximum(colour + spread, 1e-6)
    observed_db = float(np.sqrt(np.mean(level**2)))
    return SourceMagnitude(nodes, level if observed_db >= _LEAST_DB else np.zeros(nodes.size))


def _powers(
    responses: Sequence[ImpulseResponse], until_s: Sequence[float], nodes_hz: FloatArray
) -> FloatArray:
    """Return each response's power about each of some frequencies, (n_responses, n_nodes)."""
    observed = [_first_sound(r, t) for r, t in zip(responses, until_s, strict=True)]
    n = fft.next_fast_len(2 * max(h.size for h in observed), real=True)
    f = fft.rfftfreq(n, 1.0 / responses[0].sampling_rate_hz)[1:]
    power = np.stack([np.abs(fft.rfft(h, n)[1:]) ** 2 for h in observed])
    away = np.log2(f[None, :] / nodes_hz[:, None]) / _REACH_OCTAVES
    # equal weight to equal shares of an octave
    weight = np.where(np.abs(away) < 1.0, np.cos(0.5 * np.pi * away) ** 2, 0.0) / f
    return np.asarray(np.maximum((power @ weight.T) / weight.sum(axis=1), 1e-300))


def _decibel(ratio: FloatArray) -> FloatArray:
    return np.asarray(10.0 * np.log10(np.maximum(ratio, 1e-30)))


def _first_sound(response: ImpulseResponse, until_s: float) -> FloatArray:
    """Return the pressure until some time after emission, faded out."""
    t = np.arange(response.pressure.size) / response.sampling_rate_hz - response.time_zero_s
    left = np.clip((until_s - t) / _FADE_S, 0.0, 1.0)
    return np.asarray(response.pressure * left)[left > 0.0]


def equalise(response: ImpulseResponse, magnitude: SourceMagnitude) -> ImpulseResponse:
    """Return a response as a source of the same mean level without colour would have given it.

    Loudspeakers are nearly of least phase, so the inverse is, too: its phase is the Hilbert
    transform of its log magnitude, by folding the cepstrum [1]_. Times after emission keep their
    meaning; the delay that goes with the colour is taken out.

    References
    ----------
    .. [1] A. V. Oppenheim, R. W. Schafer, Discrete-Time Signal Processing, 3rd ed., 2010,
           section 13.
    """
    n = fft.next_fast_len(_PADDING * response.pressure.size, real=True)
    n += n % 2
    f = fft.rfftfreq(n, 1.0 / response.sampling_rate_hz)
    spectrum = fft.rfft(response.pressure, n) * _least_phase(-_level_at(magnitude, f))
    return replace(response, pressure=fft.irfft(spectrum, n)[: response.pressure.size])


def power_gain(colour: SourceMagnitude, frequency_hz: FloatArray) -> FloatArray:
    """Return by how much `equalise` multiplies power at some frequencies."""
    return np.asarray(10.0 ** (-0.1 * _level_at(colour, np.asarray(frequency_hz))))


def _level_at(colour: SourceMagnitude, frequency_hz: FloatArray) -> FloatArray:
    octaves = np.log2(np.maximum(frequency_hz, 1.0))
    return np.interp(octaves, np.log2(colour.frequencies_hz), colour.level_db)


def _least_phase(level_db: FloatArray) -> ComplexArray:
    """Return the least-phase spectrum of a level over the frequencies of a real transform."""
    cepstrum = fft.irfft(level_db * np.log(10.0) / 20.0)
    n = cepstrum.size
    cepstrum[1 : n // 2] *= 2.0
    cepstrum[n // 2 + 1 :] = 0.0
    return np.asarray(np.exp(fft.rfft(cepstrum)))
