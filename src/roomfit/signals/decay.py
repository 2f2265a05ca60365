"""Backward-integrated decay curves and the room parameters of ISO 3382-1 that they give.

Curves come from measured pressure or from predicted energies. Recordings that are no impulse
responses or decay too little are refused.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, get_args

import numpy as np
from scipy import fft
from scipy.ndimage import maximum_filter1d, median_filter

from roomfit.base.arguments import check_known, float_array
from roomfit.base.bands import Bands
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.base.typing import ParameterName as ParameterName
from roomfit.signals import filters
from roomfit.signals.noise import NoiseEstimate, block_length_s, decay_line, estimate_noise
from roomfit.signals.response import ImpulseResponse, check_travel, padded, times_s

# Beyond this share of `ringing_s` (4 periods of an octave) lies less than 1e-4 of an impulse.
_LEAD = 1.0 / 16.0
_LOWEST_DB = -200.0
_DB = 10.0 / np.log(10.0)


@dataclass(frozen=True, slots=True, eq=False)
class DecayCurve:
    """Energy still to come at each time: Schroeder's backward integral."""

    bands: Bands
    time_s: FloatArray  # (n_times,), rising, after emission
    # (n_bands, n_times), pressure squared times seconds, or the unit of the echogram: noise is
    # subtracted, the extrapolated energy after `usable_end_s` added; 0 after `usable_end_s`
    energy_left: FloatArray
    onset_s: float  # Arrival of the direct sound; early and late are counted from here
    usable_end_s: FloatArray  # (n_bands,)
    usable_db: FloatArray  # (n_bands,), range below its beginning in which the curve is reliable
    tail_time_constant_s: FloatArray  # (n_bands,), of the extrapolation after `usable_end_s`
    noise_reached: BoolArray  # (n_bands,), whether noise, not the end of data, sets the usable end

    def levels_db(self, time_s: FloatArray) -> FloatArray:
        """Return the curves in dB at given times, -200 at least; shape (n_bands, n_times)."""
        levels = np.maximum(decay_curve_db(self), _LOWEST_DB)
        return np.stack([np.interp(time_s, self.time_s, row) for row in levels])


def decay_curve(
    bands: Bands, response: ImpulseResponse, onset_s: float, *, keep_noise: bool = False
) -> DecayCurve:
    """Return the decay curves of a measured response.

    `onset_s`: arrival of the direct sound after emission, from `find_onset` or from the geometry.
    `keep_noise`: whether to integrate the whole file with its noise instead, for comparison with
    values that were computed so. `usable_db` stays the same.

    Notes
    -----
    Noise is subtracted, the integral ends where the decay meets the noise, and the remainder is
    extrapolated by the exponential that leads there: the method with the least error in [1]_. The
    filters ring before the direct sound, too, so the curve begins four periods before it.

    References
    ----------
    .. [1] M. Guski, M. Vorländer, "Comparison of noise compensation methods for room acoustic
           impulse response evaluations", Acta Acustica united with Acustica 100, 320-327 (2014).
    """
    check_travel(response, onset_s)
    rate_hz = response.sampling_rate_hz
    leads_s = _LEAD * filters.ringing_s(bands)
    long = padded(response, float(leads_s.max()))
    filtered = filters.filter_pressure(bands, long)
    noise = estimate_noise(bands, long, filtered, onset_s)

    # boundaries between samples: each sample stands for half an interval on either side
    first = max(0, int((onset_s - leads_s.max() + long.time_zero_s) * rate_hz))
    time_s = (np.arange(first, filtered.shape[1] + 1) - 0.5) / rate_hz - long.time_zero_s
    energy_left = np.zeros((len(bands), len(time_s)))
    for band, pressure in enumerate(filtered):
        begin, end = np.searchsorted(time_s, (onset_s - leads_s[band], noise.usable_end_s[band]))
        floor, tail = noise.floor[band], noise.tail_energy[band]
        if keep_noise:
            end, floor, tail = len(time_s) - 1, 0.0, 0.0
        net = (pressure[first : first + end] ** 2 - floor) / rate_hz
        net[:begin] = 0.0
        energy_left[band, : end + 1] = _backward_sum(net) + tail
    # nothing is known after the last band's end, which may be most of a file
    known = int(np.flatnonzero(energy_left.any(axis=0)).max(initial=0)) + 2
    return DecayCurve(
        bands,
        time_s[:known].copy(),
        energy_left[:, :known].copy(),
        onset_s,
        noise.usable_end_s,
        np.where(noise.tail_energy > 0.0, _fall_db(energy_left[:, 0], noise.tail_energy), 0.0),
        noise.tail_time_constant_s,
        noise.reached,
    )


def echogram_decay_curve(
    bands: Bands, energies: FloatArray, edges_s: FloatArray, onset_s: float
) -> DecayCurve:
    """Return the decay curves of predicted energies in time bins.

    After the last bin the decay is extrapolated as over the last third of the time.

    `energies`, shape (n_bands, n_bins): 0 or more, arriving within each bin, not per second.
    `edges_s`, shape (n_bins + 1,): rising times after emission. `onset_s`: arrival of the direct
    sound.
    """
    energy_left = np.stack([_backward_sum(row) for row in energies])
    tail, unsure, constant_s = tail_of(energy_left, edges_s)
    energy_left += tail[:, None]
    usable_db = _fall_db(energy_left[:, 0], unsure)
    ends_s = np.full(len(bands), edges_s[-1])
    reached = np.zeros(len(bands), dtype=np.bool_)
    return DecayCurve(bands, edges_s, energy_left, onset_s, ends_s, usable_db, constant_s, reached)


def reduced_alike(predicted: DecayCurve, measured: DecayCurve) -> DecayCurve:
    """Return predicted curves that end and are extrapolated as measured ones.

    Where walls differ much the decay is bent, and flattens below where noise sets its end: the
    exponential that stands for the rest of a measured decay is then too steep. The same line is
    put through what is predicted, with the noise that the measurement had, so that both curves
    have the same error.

    `predicted`: from `echogram_decay_curve`, in the bands of `measured`; a band that ends before
    the measured one stays as it is. `measured`: from `decay_curve`.
    """
    found = {
        name: getattr(predicted, name).copy()
        for name in ("energy_left", "usable_end_s", "usable_db", "tail_time_constant_s")
    }
    time_s, onset_s, end_time_s = predicted.time_s, predicted.onset_s, float(predicted.time_s[-1])
    for band, bandwidth_hz in enumerate(filters.statistical_bandwidth_hz(predicted.bands).tolist()):
        own, end_s = predicted.energy_left[band], float(measured.usable_end_s[band])
        tau, usable_db = measured.tail_time_constant_s[band], measured.usable_db[band]
        if not (tau > 0.0 and onset_s < end_s < end_time_s and own[0] > 0.0):
            continue
        reached = bool(measured.noise_reached[band])
        step_s = block_length_s(bandwidth_hz, end_time_s - onset_s)
        edges = np.arange(0.0, (end_time_s if reached else end_s) - onset_s + 1e-9, step_s)
        power = -np.diff(np.interp(onset_s + edges, time_s, own)) / step_s
        # at its end the measured line is as high as the noise; beside a cut file there is none
        at_end = own[0] * 10.0 ** (-0.1 * usable_db) / tau
        floor, span_db = (at_end, 25.0) if reached else (1e-12 * at_end, np.inf)
        line = decay_line(edges[:-1] + 0.5 * step_s, power + floor, floor, span_db)
        if line is None:
            continue
        height, constant_s = line
        tail = height * constant_s * np.exp(-(end_s - onset_s) / constant_s)
        beyond_s = np.maximum(time_s - end_s, 0.0)
        until_end = np.maximum(own - np.interp(end_s, time_s, own), 0.0)
        # after its end the line itself, so that no level between two bins is without a number
        found["energy_left"][band] = until_end + tail * np.exp(-beyond_s / constant_s)
        found["usable_end_s"][band], found["usable_db"][band] = end_s, usable_db
        found["tail_time_constant_s"][band] = constant_s
    return replace(predicted, **found)


def decay_curve_db(curve: DecayCurve) -> FloatArray:
    """Return the curves in dB below their beginning, shape (n_bands, n_times).

    -inf after the usable end, where nothing is known.
    """
    total = curve.energy_left[:, :1]
    ratio = curve.energy_left / np.where(total > 0.0, total, 1.0)
    # a sum that noise has made negative has no energy
    with np.errstate(divide="ignore"):
        return np.asarray(10.0 * np.log10(np.maximum(ratio, 0.0)))


def _backward_sum(energy: FloatArray) -> FloatArray:
    """Return the energy from each bin boundary on, one entry longer than the bins."""
    return np.concatenate((np.cumsum(energy[::-1])[::-1], [0.0]))


def _fall_db(total: FloatArray, tail: FloatArray) -> FloatArray:
    """Return how far the tail lies below the whole in dB, from 0 to inf."""
    with np.errstate(divide="ignore"):
        ratio = np.where(total > tail, total, 1.0) / np.where(total > tail, tail, 1.0)
    return np.asarray(10.0 * np.log10(ratio))


def tail_of(
    energy_left: FloatArray, edges_s: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return energy after the last edge, uncertain energy, and the tail's time constant.

    Of equal stretches of an exponential each has r times the energy of the one before; all that
    follow the last together r / (1 - r) times its own. Where the last third does not fall, nothing
    is added and all its energy is uncertain. Shape (n_bands,) each.
    """
    step_s = (edges_s[-1] - edges_s[0]) / 6.0
    at = edges_s[-1] - step_s * np.array([2.0, 1.0, 0.0])
    left = np.stack([np.interp(at, edges_s, row) for row in energy_left])
    before, last = left[:, 0] - left[:, 1], left[:, 1] - left[:, 2]
    falls = (last > 0.0) & (last < before)
    r = np.where(falls, last / np.where(falls, before, 1.0), 0.5)
    tail = np.where(falls, last * r / (1.0 - r), 0.0)
    return tail, np.where(falls, tail, left[:, 0]), np.where(falls, -step_s / np.log(r), 0.0)


# ISO 3382-1:2009, table A.1: 5 % of EDT (taken for T20 and T30 as well), 1 dB of C80 (and C50) and
# G, 0.05 of D50, 10 ms of TS; Bradley, Reich and Norcross, Applied Acoustics 58, 99-108 (1999):
# 0.03 of STI.
_JND_OF_TIMES = 0.05  # relative
_JND = {"C50_dB": 1.0, "C80_dB": 1.0, "G_dB": 1.0, "D50_percent": 5.0, "TS_ms": 10.0, "STI": 0.03}


def in_jnd(parameter: str, measured: FloatArray, predicted: FloatArray) -> FloatArray:
    """Return predicted minus measured in just noticeable differences of ISO 3382-1.

    Examples
    --------
    A reverberation time 10 % too long is two just noticeable differences off:

    >>> in_jnd("T20_s", np.array([1.0]), np.array([1.1])).round(6)
    array([2.])
    """
    difference = np.asarray(predicted) - np.asarray(measured)
    return np.asarray(difference / jnd_of(parameter, measured))


def jnd_of(parameter: str, values: FloatArray) -> FloatArray:
    """Return one just noticeable difference of a parameter, in its own unit, at given values.

    `parameter`: "EDT_s", "T20_s", "T30_s", "C50_dB", "C80_dB", "D50_percent", "TS_ms", "G_dB" or
    "STI".

    Examples
    --------
    >>> float(jnd_of("EDT_s", np.array(2.0)))
    0.1
    """
    what = "no just noticeable difference is known for this parameter"
    check_known(what, parameter, (*FIT_RANGES_DB, *_JND))
    if parameter in FIT_RANGES_DB:
        return np.asarray(_JND_OF_TIMES * np.asarray(values))
    return np.full(np.shape(values), _JND[parameter])


_LEAST_RANGE_DB = 15.0
_N_BLOCKS, _LEAST_BLOCK = 12, 64
# No excitation is shorter; in a dry room nearly all energy arrives within a few ms.
_SHORTEST_EXCITATION_S = 0.05
# Bins of a spectrum about a line of hum, by how much it exceeds their median, and how far it leaks.
_LINE_BINS, _LINE, _LINE_LEAKS = 31, 10.0, 9


def check_is_response(response: ImpulseResponse, where: str | None = None) -> None:
    """Refuse a recording of the excitation that was not deconvolved, with an `InputError`.

    Two signs are sought between the instants by which 5 and 95 % of the energy have arrived. A
    sweep climbs: the median frequency rises from block to block by two octaves or more in all. A
    long excitation of any kind does not decay: half its energy arrives in more than 0.6 of the time
    of the other half (an exponential decay: 0.28), and no peak exceeds its mean by 16 dB. Hum is
    left out first, since it neither climbs nor decays: a response with hum is a response. Refused
    is a second sound, too: no room is silent for a tenth of a second and then loud again.
    """
    pressure = _without_hum(response.pressure)
    cumulative = np.cumsum(pressure**2)
    begin, middle, end = np.searchsorted(cumulative, cumulative[-1] * np.array([0.05, 0.5, 0.95]))
    loud = pressure[begin : end + 1]
    length_s = len(loud) / response.sampling_rate_hz
    if length_s < _SHORTEST_EXCITATION_S:
        return
    crest = float(np.max(loud**2) / np.mean(loud**2))
    lasting = middle - begin > 0.6 * (end - middle) and crest < 40.0
    if lasting or _climbs(loud):
        what = "this looks like a recording of the excitation or of noise, no impulse response"
        found = f"sound that lasts {length_s:.2f} s without decaying"
        hint = 'excitation = "sweep.wav" under [defaults], the sweep as played; or measure louder'
    elif (again_s := _begins_again_s(pressure, response.sampling_rate_hz)) is not None:
        what, found = "the file holds a second sound", f"one {again_s:.2f} s after its beginning"
        hint = "cut the file before the second sound, or behind a click before the response"
    else:
        return
    needed = "the response after deconvolution: one onset, then a decay"
    raise InputError(what, where=where, found=found, needed=needed, hint=hint)


def _begins_again_s(pressure: FloatArray, rate_hz: float) -> float | None:
    """Return when a second sound begins, after the first sample; None where there is none.

    Blocks of 50 ms from the onset on, after two that are 20 dB quieter, and 30 dB below the loudest
    at most. Not in the last tenth, where circular deconvolution leaves what precedes the response.
    """
    n, end = round(_SHORTEST_EXCITATION_S * rate_hz), int(0.9 * len(pressure))
    size = np.abs(pressure)
    first = int(np.argmax(size >= 0.1 * size.max()))
    n_blocks = max(end - first, 0) // n
    energy = np.sum(pressure[first : first + n_blocks * n].reshape(-1, n) ** 2, axis=1)
    quietest = np.minimum.accumulate(np.maximum(energy[:-1], energy[1:]))[:-1]
    loud = energy[2:] >= 1e-3 * energy.max(initial=0.0)
    again = np.flatnonzero(loud & (energy[2:] >= 100.0 * quietest))
    return float((first + (2 + again[0]) * n) / rate_hz) if again.size else None


def _without_hum(pressure: FloatArray) -> FloatArray:
    """Return samples without their mean and without lines of their spectrum, shape (n_samples,).

    A line stands 20 dB above the median of the 31 magnitudes about it, in the spectrum under a Hann
    window; it is cut to that median. Sweeps, noise and decays, whose spectra are smooth on this
    scale, stay what they are.
    """
    centred = pressure - np.mean(pressure)
    spectrum = np.fft.rfft(centred)
    windowed = np.abs(np.fft.rfft(centred * np.hanning(centred.size)))
    median = median_filter(windowed, _LINE_BINS, mode="nearest")
    is_line = maximum_filter1d(windowed > _LINE * median, _LINE_LEAKS)
    own = median_filter(np.abs(spectrum), _LINE_BINS, mode="nearest")
    keep = np.minimum(1.0, own / np.maximum(np.abs(spectrum), np.finfo(float).tiny))
    return np.asarray(np.fft.irfft(np.where(is_line, keep, 1.0) * spectrum, centred.size))


def _climbs(loud: FloatArray) -> bool:
    size = len(loud) // _N_BLOCKS
    if size < _LEAST_BLOCK:
        return False
    power = np.abs(np.fft.rfft(loud[: size * _N_BLOCKS].reshape(_N_BLOCKS, size), axis=1)) ** 2
    cumulative = np.cumsum(power, axis=1)
    median = np.argmax(cumulative >= 0.5 * cumulative[:, -1:], axis=1) + 0.5
    rises = int(np.sum(np.diff(median) > 0.0))
    return rises >= _N_BLOCKS - 3 and bool(median[-1] > 4.0 * median[0])


def check_decay_range(curve: DecayCurve, where: str | None = None) -> None:
    """Refuse a response of which no band has 15 dB of decay above its noise and before its end.

    With the cause, an `InputError`: the file is cut short, or noise masks the decay. Single bands
    without T20 are reported by `range_findings` instead.
    """
    deepest = int(np.argmax(curve.usable_db))
    cut, range_db = not curve.noise_reached[deepest], curve.usable_db[deepest]
    if range_db < _LEAST_RANGE_DB:
        raise InputError(
            "the decay is cut short" if cut else "the decay drowns in noise",
            where=where,
            found=f"{range_db:.0f} dB of decay at {curve.bands.centres_hz[deepest]:g} Hz, and no "
            "more in any other band",
            needed=f"at least {_LEAST_RANGE_DB:g} dB in some band, 25 dB for T20",
            hint="give the whole response" if cut else "measure with a longer sweep, or louder",
        )


PARAMETER_NAMES: tuple[ParameterName, ...] = get_args(ParameterName)

# Levels between which each decay time is read, below the curve's beginning.
FIT_RANGES_DB: dict[str, tuple[float, float]] = {
    "EDT_s": (0.0, 10.0),
    "T20_s": (5.0, 25.0),
    "T30_s": (5.0, 35.0),
}
# Points of the line through a range, and where the early part of each parameter ends.
_POINTS, _EARLY_S = 512, {"C50_dB": 0.05, "C80_dB": 0.08, "D50_percent": 0.05}
# Energy after the usable end is extrapolated; where it is a hundredth of all, an error of 20 % in
# it moves D50, TS or C80 around 0 dB by no more than a tenth of a just noticeable difference.
_ROOM_PARAMETERS_LEAST_RANGE_DB = 20.0


class RoomParameters(NamedTuple):
    """Parameters of one source and receiver in every band."""

    bands: Bands
    values: FloatArray  # (7, n_bands), rows and units as `PARAMETER_NAMES`; nan where not valid
    valid: BoolArray  # (7, n_bands), whether the decay range suffices for the parameter

    def of(self, name: ParameterName) -> FloatArray:
        """Return one parameter in every band, nan where not valid, shape (n_bands,)."""
        return np.asarray(self.values[PARAMETER_NAMES.index(name)])


def room_parameters(curve: DecayCurve) -> RoomParameters:
    """Return EDT, T20, T30, C50, C80, D50 and TS of every band.

    The same function serves measured and predicted curves, so that neither is favoured.

    `curve`: from `decay_curve` or `echogram_decay_curve`.

    The result is ``values`` of shape (7, n_bands), in the units that `PARAMETER_NAMES` end in.

    Notes
    -----
    Decay times come from a straight line through the curve by least squares, every instant of the
    range with the same weight: 0 to -10 dB from the onset on (EDT), -5 to -25 dB (T20), -5 to
    -35 dB (T30) [1]_. A range that reaches deeper than `curve.usable_db` is not evaluated; nor
    are C, D and TS where that is less than 20 dB, or C where the late part lies below it.

    References
    ----------
    .. [1] ISO 3382-1:2009, "Measurement of room acoustic parameters - Performance spaces".
    """
    levels_db = decay_curve_db(curve)
    values = np.full((len(PARAMETER_NAMES), len(curve.bands)), np.nan)
    for band, level_db in enumerate(levels_db):
        left, usable_db = curve.energy_left[band], curve.usable_db[band]
        tail = float(left[0]) * 10.0 ** (-0.1 * usable_db)
        for row, name in enumerate(PARAMETER_NAMES):
            if name in FIT_RANGES_DB:
                lowest = FIT_RANGES_DB[name][1]
                if lowest <= usable_db and level_db.min() < -lowest:
                    values[row, band] = decay_time(curve, level_db, FIT_RANGES_DB[name])[0]
            elif usable_db >= _ROOM_PARAMETERS_LEAST_RANGE_DB and name in _EARLY_S:
                value, late, _ = early_part(curve, band, name)
                if name == "D50_percent" or tail < late < left[0]:
                    values[row, band] = value
            elif usable_db >= _ROOM_PARAMETERS_LEAST_RANGE_DB:
                values[row, band] = centre_time_ms(curve, band, tail)[0]
    return RoomParameters(curve.bands, values, np.isfinite(values))


def range_findings(parameters: RoomParameters, where: str) -> tuple[Finding, ...]:
    """Return a finding for the bands in which T20 could not be evaluated.

    `where`: names the response in the sentence.
    """
    missing = parameters.bands.centres_hz[np.isnan(parameters.of("T20_s"))].tolist()
    if not missing:
        return ()
    sentence = (
        f"{where}: noise or the end of the file leaves less than 25 dB of decay at "
        f"{', '.join(f'{f:g}' for f in missing)} Hz; T20 is not evaluated there."
    )
    about, evidence = About(bands_hz=missing), {"bands_hz": missing}
    return (Finding(Code.DECAY_RANGE_TOO_SMALL, about, sentence, evidence),)


def decay_time(
    curve: DecayCurve,
    level_db: FloatArray,
    fit_range_db: tuple[float, float],
    *,
    derivative: bool = False,
) -> tuple[float, FloatArray]:
    """Return the reverberation time over a range of levels, and its derivative by the levels.

    NaN where the curve does not fall after the onset; zeros where no derivative is wanted. The
    range's end is that of the curve where it never falls so far. `level_db`: (n_times,).
    """
    time_s, level_db = curve.time_s, np.maximum(level_db, -300.0)
    begin_s, by_begin = _crossing(time_s, level_db, fit_range_db[0], curve.onset_s)
    end_s, by_end = _crossing(time_s, level_db, fit_range_db[1], curve.onset_s)
    span_s, by_level = end_s - begin_s, np.zeros_like(level_db)
    if not span_s > 0.0:
        return np.nan, by_level
    # the curve is known at unequal times: the line is drawn through equally spaced ones
    u = np.linspace(0.0, 1.0, _POINTS)
    times = begin_s + span_s * u
    i = np.clip(np.searchsorted(time_s, times, side="right") - 1, 0, len(time_s) - 2)
    step_s = time_s[i + 1] - time_s[i]
    share = (times - time_s[i]) / step_s
    weight = (u - 0.5) / (span_s * np.sum((u - 0.5) ** 2))
    slope = float(weight @ ((1.0 - share) * level_db[i] + share * level_db[i + 1]))
    if not slope < 0.0:
        return np.nan, by_level
    if derivative:
        np.add.at(by_level, i, weight * (1.0 - share))
        np.add.at(by_level, i + 1, weight * share)
        # the range moves: its points climb along the curve, and its width divides the slope
        along = weight * (level_db[i + 1] - level_db[i]) / step_s
        by_level += float(along @ (1.0 - u) + slope / span_s) * by_begin
        by_level += float(along @ u - slope / span_s) * by_end
    return -60.0 / slope, 60.0 / slope**2 * by_level


class DecayLine(NamedTuple):
    """The line through a decay curve that a decay time is read from."""

    name: ParameterName
    ends_s: FloatArray  # (2,)
    levels_db: FloatArray  # (2,), there
    nonlinearity_permille: float  # of the curve, 0 for a line: ISO 3382-2:2008, B.2


def evaluated_line(curve: DecayCurve, parameters: RoomParameters, band: int) -> DecayLine | None:
    """Return the line of T30, of T20 where that is not known, None where neither is."""
    names: tuple[ParameterName, ...] = ("T30_s", "T20_s")
    name = next((n for n in names if np.isfinite(parameters.of(n)[band])), None)
    if name is None:
        return None
    level_db = np.maximum(decay_curve_db(curve)[band], -300.0)
    depths_db = FIT_RANGES_DB[name]
    begin_s, end_s = (_crossing(curve.time_s, level_db, x, curve.onset_s)[0] for x in depths_db)
    times, ends = np.linspace(begin_s, end_s, _POINTS), np.array([begin_s, end_s])
    levels = np.interp(times, curve.time_s, level_db)
    slope, height_db = np.polyfit(times, levels, 1)
    correlation = float(np.corrcoef(times, levels)[0, 1])
    return DecayLine(name, ends, height_db + slope * ends, 1e3 * (1.0 - correlation**2))


def _crossing(
    time_s: FloatArray, level_db: FloatArray, depth_db: float, onset_s: float
) -> tuple[float, FloatArray]:
    """Return when the curve falls below a depth, and the derivative by its levels.

    Not before the onset, and at the last boundary where it never falls so far: there the
    derivative is zero.
    """
    by_level = np.zeros_like(level_db)
    below = np.flatnonzero(level_db < -depth_db)
    if not below.size:
        return float(time_s[-1]), by_level
    i = int(below[0])
    if i == 0:
        return onset_s, by_level
    fall, step_s = level_db[i - 1] - level_db[i], time_s[i] - time_s[i - 1]
    share = (level_db[i - 1] + depth_db) / fall
    found_s = float(time_s[i - 1] + share * step_s)
    if found_s <= onset_s:
        return onset_s, by_level
    by_level[i - 1 : i + 1] = (1.0 - share) * step_s / fall, share * step_s / fall
    return found_s, by_level


def early_part(curve: DecayCurve, band: int, name: str) -> tuple[float, float, FloatArray]:
    """Return C50 or C80 in dB, or D50 in percent, late energy, and the derivative by what is left.

    The derivative has the shape (n_times,).
    """
    left, time_s, end_s = curve.energy_left[band], curve.time_s, curve.onset_s + _EARLY_S[name]
    # the boundary before the end of the early part, and the share of the bin up to that end
    i = min(max(int(np.searchsorted(time_s, end_s, side="right")) - 1, 0), len(time_s) - 2)
    share = min(max(float((end_s - time_s[i]) / (time_s[i + 1] - time_s[i])), 0.0), 1.0)
    weights: FloatArray = np.zeros_like(left)
    weights[i : i + 2] = 1.0 - share, share
    total, late = float(left[0]), float((1.0 - share) * left[i] + share * left[i + 1])
    if name == "D50_percent":
        by_left = -100.0 / total * weights
        by_left[0] += 100.0 * late / total**2
        return 100.0 * (1.0 - late / total), late, by_left
    # one part in 1e12 on either side keeps the logarithm where all is early, or all late
    kept = min(max(late, 1e-12 * total), (1.0 - 1e-12) * total)
    by_left = -_DB * total / (kept * (total - kept)) * weights
    by_left[0] += _DB / (total - kept)
    return float(_DB * np.log(total / kept - 1.0)), late, by_left


def centre_time_ms(curve: DecayCurve, band: int, tail: float) -> tuple[float, FloatArray]:
    """Return the centre time, with its derivative by the energy left (the tail's moment apart).

    The integral of what is left, by parts, with the share of the exponential tail.
    """
    left, steps_s = curve.energy_left[band], np.diff(curve.time_s)
    weights = 0.5 * (np.append(steps_s, 0.0) + np.insert(steps_s, 0, 0.0))
    moment = float(weights @ left) + float(tail * curve.tail_time_constant_s[band])
    total = float(left[0])
    by_left = 1000.0 / total * weights
    by_left[0] -= 1000.0 * moment / total**2
    return 1000.0 * (moment / total - (curve.onset_s - float(curve.time_s[0]))), by_left


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
    filters.check_sampling_rate(bands, rate_hz)
    length = fft.next_fast_len(
        n + int(np.ceil(filters.ringing_s(bands).max() * rate_hz)), real=True
    )
    frequencies = fft.rfftfreq(length, 1.0 / rate_hz)
    magnitudes = filters.frequency_response(bands, frequencies) ** 2
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
