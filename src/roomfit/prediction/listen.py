"""What a changed room would sound like: a measured response, scaled by what a change does.

Nothing is synthesised. The measured response stays, with the colour of its room and chain; each
band is scaled over time by the ratio of the predicted energies after to before.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import fft

from roomfit._checks import float_array
from roomfit._numba import one_blas_thread
from roomfit.air import attenuation_per_m
from roomfit.bands import Bands
from roomfit.cache import Cache
from roomfit.errors import InputError
from roomfit.findings import Finding
from roomfit.inversion.measurements import observe
from roomfit.measurement import Measurement
from roomfit.objective.observation import spread_over_time
from roomfit.prediction.changes import Change, changed_draws
from roomfit.prediction.decay import follow_decay
from roomfit.prediction.predict import check_materials, is_unknown
from roomfit.response.binned import pair_energies
from roomfit.results import result_doubts
from roomfit.scene import Scene
from roomfit.settings import Settings
from roomfit.signals.decay import PARAMETER_NAMES
from roomfit.signals.filters import (
    check_sampling_rate,
    frequency_response,
    ringing_s,
)
from roomfit.signals.noise import NoiseEstimate
from roomfit.signals.response import ImpulseResponse, times_s
from roomfit.typing import FloatArray, Progress
from roomfit.uncertainty.posterior import AbsorptionPosterior, draw_absorption

# Ratios are means over a tenth of the time since the direct sound, and over 10 ms at most: of
# decays of .3 and .6 s the mean over 20 ms is off by 0.1 dB.
_MEAN_SHARE, _LONGEST_MEAN_S = 0.1, 0.01
# What is predicted is relied on so far down either decay; below it the ratio goes on as it fell.
_RELIED_ON_DB = 40.0
_LEAST_SHARE = 1e-12  # of the energy: less is rounding


class ChangedResponse(NamedTuple):
    """A measured response as it would be after a change."""

    measurement: Measurement
    samples: FloatArray  # (n_samples,), in the unit, at the rate and on the clock of the file
    # (n_bands,), s after emission, from which the measured noise carries the predicted tail; NaN
    # where the file ends before its noise
    noise_from_s: FloatArray


def scaled_response(
    response: ImpulseResponse,
    bands: Bands,
    time_s: FloatArray,
    ratio: FloatArray,
    noise: NoiseEstimate | None = None,
) -> FloatArray:
    """Return a response with the energy of its bands scaled over time, shape (n_samples,).

    Parameters
    ----------
    response : ImpulseResponse
        On the clock of `time_s`.
    bands : Bands
        What lies below the lowest and above the highest is scaled with these.
    time_s : float array, shape (n_times,)
        Rising; before the first and after the last the ratio stays as it is there.
    ratio : float array, shape (n_bands, n_times)
        Of energies, 0 or larger.
    noise : NoiseEstimate, optional
        From `estimate_noise`: the decay alone is scaled, the noise stays what it is. Left out:
        there is none.

    Raises
    ------
    InputError
        Shapes disagree, a ratio is negative, or a band reaches above half the sampling rate.

    Notes
    -----
    Where the decay has the power D and the noise N, the power is scaled by ``(r D + N) / (D + N)``:
    noise is never scaled by itself, and where it masks the decay it carries no more than what is
    predicted of it, as well as the exponential D that leads to the noise is known.

    The magnitudes of the bands are squares of those of `frequency_response`: they add up to one at
    every frequency, without delay. What is added to the response is the sum of bands times gain
    minus one: where every ratio is 1 it comes back bit by bit.

    Examples
    --------
    >>> response = ImpulseResponse(np.array([1.0, 0.5, 0.25]), 8000.0)
    >>> octave = Bands("octave", np.array([1000.0]))
    >>> scaled_response(response, octave, np.zeros(1), np.array([[4.0]])).round(9)
    array([2. , 1. , 0.5])
    """
    ratios = float_array("ratios", ratio, (len(bands), len(time_s)), low=0.0)
    rate_hz = response.sampling_rate_hz
    check_sampling_rate(bands, rate_hz)
    t, n = times_s(response), len(response.pressure)
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


def energy_ratio(
    before: FloatArray, after: FloatArray, edges_s: FloatArray, direct_s: float
) -> FloatArray:
    """Return the ratio of predicted energies over time, after over before, shape (n_bands, n_bins).

    Early reflections keep their own: means are over a tenth of the time since the direct sound.
    Until this the ratio is 1. Where one of the decays has fallen by 40 dB, the logarithm of the
    ratio goes on as it fell over the later half of the time before.

    Parameters
    ----------
    before, after : float arrays, shape (n_bands, n_bins)
        Energies of uniform bins, spread as by the filters.
    edges_s : float array, shape (n_bins + 1,)
    direct_s : float
        Arrival of the direct sound.
    """
    middle = 0.5 * (edges_s[1:] + edges_s[:-1])
    half_s = np.clip(_MEAN_SHARE * (middle - direct_s), 0.0, _LONGEST_MEAN_S)
    half_s = np.maximum(half_s, 0.5 * (edges_s[1] - edges_s[0]))
    found = np.ones_like(before)
    for band, rows in enumerate(zip(before, after, strict=True)):
        if np.array_equal(*rows):
            continue
        sums = [np.concatenate(([0.0], np.cumsum(row))) for row in rows]
        old, new = (
            np.interp(middle + half_s, edges_s, s) - np.interp(middle - half_s, edges_s, s)
            for s in sums
        )
        known = old > _LEAST_SHARE * sums[0][-1]
        found[band, known] = new[known] / old[known]
        deep = np.stack([s[-1] - s[1:] < 10.0 ** (-0.1 * _RELIED_ON_DB) * s[-1] for s in sums])
        ends = [int(np.argmax(d)) for d in deep]
        end = min(e for e in (*ends, before.shape[1] - 1) if e > 0)
        used = np.flatnonzero(middle[:end] > 0.5 * (direct_s + middle[end]))
        if used.size > 1:
            level = np.log(np.maximum(found[band, used], 1e-30))
            slope, height = np.polyfit(middle[used] - middle[end], level, 1)
            found[band, end:] = np.exp(height + slope * (middle[end:] - middle[end]))
    found[:, middle < direct_s] = 1.0
    return found


@one_blas_thread
def listen(
    scene: Scene,
    absorption: AbsorptionPosterior,
    changes: Sequence[Change],
    measurements: Sequence[Measurement],
    *,
    settings: Settings | None = None,
    cache: Cache | None = None,
    progress: Progress | None = None,
) -> tuple[tuple[ChangedResponse, ...], tuple[Finding, ...]]:
    """Return measured responses as they would be after a change of materials.

    At the most likely absorption before and after; what is not known of it is said by
    `roomfit.predict`, not here. Level and clock are those of the files.

    Parameters
    ----------
    scene, absorption, changes, settings, cache, progress
        As of `roomfit.predict`; without changes the samples come back as they are.
    measurements : sequence of Measurement
        Of pairs of the scene, all at one sampling rate.

    Raises
    ------
    InputError
        Other materials than the room's, a change that cannot be made or of a material whose
        absorption was not known, no measured response, or one that cannot be examined.
    """
    settings = Settings() if settings is None else settings
    check_materials(absorption, scene)
    if not measurements:
        raise InputError("no measured response to change", needed="[[measurements]] with a file")
    rng = np.random.default_rng(settings.seed)
    old = absorption.absorption
    new, _, findings = changed_draws(absorption, draw_absorption(absorption, 2, rng), changes, rng)
    materials = scene.room.materials
    unknown = [c.material for c in changes if is_unknown(absorption)[materials.index(c.material)]]
    if unknown:
        raise InputError(
            "the absorption before the change is not known",
            found=", ".join(unknown),
            needed="a material of the result: there is no ratio of after to before",
        )
    bands = absorption.bands
    observed, doubts = observe(scene, measurements, bands)
    times = [m.parameters.values[PARAMETER_NAMES.index("T30_s")] for m in observed]
    longest_s = max((float(np.nanmax(row)) for row in times if np.isfinite(row).any()), default=0.0)
    binned, _, traced = follow_decay(
        scene, absorption, np.minimum(old, new), longest_s, settings, cache, progress
    )
    attenuation = attenuation_per_m(scene.air, bands)
    edges, bin_s = binned.edges_s, float(binned.edges_s[1] - binned.edges_s[0])
    found = []
    for m in observed:
        # nothing is predicted between the end of the trace and that of the file
        silent = max(0, int(np.ceil((times_s(m.response)[-1] - edges[-1]) / bin_s)))
        edges_s = np.append(edges, edges[-1] + bin_s * np.arange(1, silent + 1))
        before, after = (
            np.pad(
                spread_over_time(bands, pair_energies(binned, bands, m.pair, a, attenuation)),
                ((0, 0), (0, silent)),
            )
            for a in (old, new)
        )
        ratio = energy_ratio(before, after, edges_s, m.direct_s)
        middle = 0.5 * (edges_s[1:] + edges_s[:-1])
        samples = scaled_response(m.response, bands, middle, ratio, m.noise)
        from_s = np.where(m.noise.reached, m.noise.usable_end_s, np.nan)
        found.append(ChangedResponse(m.measurement, samples, from_s))
    rests_on = result_doubts(absorption)
    return tuple(found), (*rests_on, *absorption.findings, *findings, *doubts, *traced)


def convolved(dry: FloatArray, response: FloatArray) -> FloatArray:
    """Return a recording as it sounds through a response, shape (n_dry + n_response - 1,)."""
    n = len(dry) + len(response) - 1
    length = fft.next_fast_len(n, real=True)
    return np.asarray(fft.irfft(fft.rfft(dry, length) * fft.rfft(response, length), length)[:n])


def with_dry_recording(
    sounds: Sequence[dict[str, FloatArray]], dry: FloatArray
) -> tuple[list[dict[str, FloatArray]], float]:
    """Return responses with what a dry recording becomes in each, and the factor of all of these.

    The loudest then has a peak of half.
    """
    wet = [{f"dry_{k}": convolved(dry, x) for k, x in s.items()} for s in sounds]
    factor = 0.5 / max(float(np.abs(x).max()) for s in wet for x in s.values())
    scaled = [{k: factor * x for k, x in s.items()} for s in wet]
    return [s | w for s, w in zip(sounds, scaled, strict=True)], factor
