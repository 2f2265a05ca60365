"""Backward-integrated decay curves, from measured pressure and from predicted energies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from roomfit.bands import Bands
from roomfit.checks import float_array
from roomfit.errors import InputError
from roomfit.signals.filters import FilterBank, filter_pressure, ringing_s
from roomfit.signals.impulse_response import ImpulseResponse, padded
from roomfit.signals.noise import estimate_noise
from roomfit.signals.onset import check_travel
from roomfit.typing import BoolArray, FloatArray

# Beyond this share of `ringing_s` (4 periods of an octave) lies less than 1e-4 of an impulse.
_LEAD = 1.0 / 16.0


@dataclass(frozen=True, slots=True, eq=False)
class DecayCurve:
    """Energy still to come at each time: Schroeder's backward integral.

    Attributes
    ----------
    bands : Bands
    time_s : float array, shape (n_times,)
        Rising, after emission.
    energy_left : float array, shape (n_bands, n_times)
        Pressure squared times seconds, or the unit of the echogram. Noise is subtracted, and what
        the decay would hold after `usable_end_s` is added. 0 after `usable_end_s`.
    onset_s : float
        Arrival of the direct sound; early and late are counted from here.
    usable_end_s : float array, shape (n_bands,)
    usable_db : float array, shape (n_bands,)
        How far below its beginning the curve may be trusted, positive dB.
    tail_time_constant_s : float array, shape (n_bands,)
        In which the energy after `usable_end_s` is taken to fall to 1/e.
    noise_reached : bool array, shape (n_bands,)
        Whether noise, not the end of the file or of the prediction, sets the usable end.
    """

    bands: Bands
    time_s: FloatArray
    energy_left: FloatArray
    onset_s: float
    usable_end_s: FloatArray
    usable_db: FloatArray
    tail_time_constant_s: FloatArray
    noise_reached: BoolArray


def decay_curve(
    bank: FilterBank, response: ImpulseResponse, onset_s: float, *, keep_noise: bool = False
) -> DecayCurve:
    """Return the decay curves of a measured response.

    Parameters
    ----------
    bank : FilterBank
    response : ImpulseResponse
    onset_s : float
        Arrival of the direct sound after emission, from `find_onset` or from the geometry.
    keep_noise : bool
        Whether to integrate the whole file with its noise instead, for comparison with values
        that were computed so. What `usable_db` says stays the same.

    Raises
    ------
    InputError
        The file ends before the onset, or a band reaches above half the sampling rate.

    Notes
    -----
    Noise is subtracted, the integral ends where the decay meets the noise, and the exponential
    that leads there stands for the rest: the method that [1]_ found to err least. The filters ring
    before the direct sound, too, so the curve begins four periods before it.

    References
    ----------
    .. [1] M. Guski, M. Vorländer, "Comparison of noise compensation methods for room acoustic
           impulse response evaluations", Acta Acustica united with Acustica 100, 320-327 (2014).
    """
    check_travel(response, onset_s)
    rate_hz = response.sampling_rate_hz
    leads_s = _LEAD * ringing_s(bank)
    long = padded(response, float(leads_s.max()))
    filtered = filter_pressure(bank, long)
    noise = estimate_noise(bank, long, filtered, onset_s)

    # boundaries between samples: each sample stands for half an interval on either side
    first = max(0, int((onset_s - leads_s.max() + long.time_zero_s) * rate_hz))
    time_s = (np.arange(first, filtered.shape[1] + 1) - 0.5) / rate_hz - long.time_zero_s
    energy_left = np.zeros((len(bank.bands), len(time_s)))
    for band, pressure in enumerate(filtered):
        begin, end = np.searchsorted(time_s, (onset_s - leads_s[band], noise.usable_end_s[band]))
        floor, tail = noise.floor[band], noise.tail_energy[band]
        if keep_noise:
            end, floor, tail = len(time_s) - 1, 0.0, 0.0
        net = (pressure[first : first + end] ** 2 - floor) / rate_hz
        net[:begin] = 0.0
        energy_left[band, : end + 1] = _backward_sum(net) + tail
    return DecayCurve(
        bank.bands,
        time_s,
        energy_left,
        onset_s,
        noise.usable_end_s,
        np.where(noise.tail_energy > 0.0, _fall_db(energy_left[:, 0], noise.tail_energy), 0.0),
        noise.tail_time_constant_s,
        noise.reached,
    )


def echogram_decay_curve(
    bands: Bands, energies: ArrayLike, edges_s: ArrayLike, onset_s: float
) -> DecayCurve:
    """Return the decay curves of predicted energies in time bins.

    What comes after the last bin is taken to go on falling as over the last third of the time.

    Parameters
    ----------
    bands : Bands
    energies : array_like, shape (n_bands, n_bins)
        Energy that arrives within each bin, not per second.
    edges_s : array_like, shape (n_bins + 1,)
        Rising times after emission.
    onset_s : float
        Arrival of the direct sound.

    Raises
    ------
    InputError
        Shapes disagree, an energy is negative, or the edges do not rise.
    """
    edges = float_array("time edges", edges_s, (None,), unit="s")
    if len(edges) < 2 or not np.all(np.diff(edges) > 0.0):
        raise InputError("time edges must rise", found=f"{len(edges)} edges", needed="two or more")
    energy = float_array("energies", energies, (len(bands), len(edges) - 1), low=0.0)
    energy_left = np.stack([_backward_sum(row) for row in energy])
    tail, unsure, constant_s = _tail(energy_left, edges)
    energy_left += tail[:, None]
    usable_db = _fall_db(energy_left[:, 0], unsure)
    ends_s = np.full(len(bands), edges[-1])
    reached = np.zeros(len(bands), dtype=np.bool_)
    return DecayCurve(bands, edges, energy_left, onset_s, ends_s, usable_db, constant_s, reached)


def decay_curve_db(curve: DecayCurve) -> FloatArray:
    """Return the curves in dB below their beginning, for pictures.

    Returns
    -------
    float array, shape (n_bands, n_times)
        0 and falling; -inf after the usable end, where nothing is known.
    """
    total = curve.energy_left[:, :1]
    ratio = curve.energy_left / np.where(total > 0.0, total, 1.0)
    # a sum that noise has driven below zero holds no energy
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


def _tail(
    energy_left: FloatArray, edges_s: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return energy after the last edge, energy that is unsure, and the tail's time constant.

    Of equal stretches of an exponential each holds r times the one before; all that follow the last
    together hold r / (1 - r) times it. Where the last third does not fall, nothing is added and all
    that it holds is unsure. Shape (n_bands,) each.
    """
    step_s = (edges_s[-1] - edges_s[0]) / 6.0
    at = edges_s[-1] - step_s * np.array([2.0, 1.0, 0.0])
    left = np.stack([np.interp(at, edges_s, row) for row in energy_left])
    before, last = left[:, 0] - left[:, 1], left[:, 1] - left[:, 2]
    falls = (last > 0.0) & (last < before)
    r = np.where(falls, last / np.where(falls, before, 1.0), 0.5)
    tail = np.where(falls, last * r / (1.0 - r), 0.0)
    return tail, np.where(falls, tail, left[:, 0]), np.where(falls, -step_s / np.log(r), 0.0)
