"""A measured response whose bands are scaled over time."""

from __future__ import annotations

import numpy as np
from scipy import fft

from roomfit.base.arguments import float_array
from roomfit.base.bands import Bands
from roomfit.base.typing import FloatArray
from roomfit.signals.filters import check_sampling_rate, frequency_response, ringing_s
from roomfit.signals.noise import NoiseEstimate
from roomfit.signals.response import ImpulseResponse, times_s


def scaled_response(
    response: ImpulseResponse,
    bands: Bands,
    time_s: FloatArray,
    ratio: FloatArray,
    noise: NoiseEstimate | None = None,
) -> FloatArray:
    """Return a response with the energy of its bands scaled over time, shape (n_samples,).

    `response`: on the clock of `time_s`. `bands`: what lies below the lowest and above the highest
    is scaled with these. `time_s`, shape (n_times,): rising; before the first and after the last
    the ratio stays as it is there. `ratio`, shape (n_bands, n_times): of energies, 0 or larger.
    `noise`: from `estimate_noise`: the decay alone is scaled, the noise stays what it is. Left out:
    there is none.

    Notes
    -----
    Where the decay has the power D and the noise N, the power is scaled by ``(r D + N) / (D + N)``:
    noise is never scaled by itself, and where it masks the decay it carries no more than what is
    predicted of it, as well as the exponential D that leads to the noise is known.

    The magnitudes of the bands are squares of those of `frequency_response`: they add up to one at
    every frequency, without delay. What is added to the response is the sum of bands times gain
    minus one: where every ratio is 1 it comes back bit by bit.
    """
    ratios = float_array("ratios", ratio, (len(bands), len(time_s)), low=0.0)
    rate_hz, t, n = response.sampling_rate_hz, times_s(response), len(response.pressure)
    check_sampling_rate(bands, rate_hz)
    length = fft.next_fast_len(n + int(np.ceil(ringing_s(bands).max() * rate_hz)), real=True)
    frequencies = fft.rfftfreq(length, 1.0 / rate_hz)
    magnitudes = frequency_response(bands, frequencies) ** 2
    magnitudes[0, frequencies <= bands.exact_centres_hz[0]] = 1.0
    magnitudes[-1, frequencies >= bands.exact_centres_hz[-1]] = 1.0
    spectrum = fft.rfft(response.pressure, length)
    made = response.pressure.copy()
    for band, magnitude in enumerate(magnitudes):
        power = np.interp(t, time_s, ratios[band])
        if noise is not None:
            power = 1.0 + (power - 1.0) * _decay_share(noise, band, t)
        if np.any(power != 1.0):
            made += (np.sqrt(power) - 1.0) * fft.irfft(spectrum * magnitude, length)[:n]
    return made


def _decay_share(noise: NoiseEstimate, band: int, t: FloatArray) -> FloatArray:
    """Return the share of the decay in the power of a band at every time."""
    constant_s, floor = noise.tail_time_constant_s[band], noise.floor[band]
    if not constant_s > 0.0:
        return np.zeros_like(t)
    at_end = noise.tail_energy[band] / constant_s
    decay = at_end * np.exp(np.clip((noise.usable_end_s[band] - t) / constant_s, -300.0, 300.0))
    return np.asarray(decay / (decay + floor)) if floor > 0.0 else np.ones_like(t)
