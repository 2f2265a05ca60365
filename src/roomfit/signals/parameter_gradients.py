"""Parameters of ISO 3382-1 of an echogram, with their derivative by the energy of every bin.

One vector of derivatives a parameter serves three ends: with the derivative of the energies by an
absorption it gives that of the parameter; with the scatter of the energies by interference, or
from batch to batch of a trace, the scatter of the parameter.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from roomfit.errors import InputError
from roomfit.signals.decay import DecayCurve
from roomfit.signals.room_parameters import FIT_RANGES_DB, POINTS_OF_A_FIT, ParameterName
from roomfit.typing import FloatArray

ValueName = Literal[ParameterName, "G_dB"]
VALUE_NAMES: tuple[ValueName, ...] = (*get_args(ParameterName), "G_dB")

_DB = 10.0 / np.log(10.0)
# The direct sound of a source of unit power at 10 m: the level to which G refers.
_ENERGY_AT_10_M = 1.0 / (4.0 * np.pi * 100.0)
_EARLY_S = {"C50_dB": 0.05, "C80_dB": 0.08, "D50_percent": 0.05}


def value_gradients(
    curve: DecayCurve, band: int, names: Sequence[ValueName]
) -> tuple[FloatArray, FloatArray]:
    """Return parameters of an echogram and their derivatives by the energies of its bins.

    Parameters
    ----------
    curve : DecayCurve
        From `roomfit.signals.decay.echogram_decay_curve`, for energies per square metre of a
        source of unit power where G is asked for.
    band : int
    names : sequence of str
        Of `VALUE_NAMES`.

    Returns
    -------
    values : float array, shape (n_names,)
        As `room_parameters` gives them. A decay that does not fall far enough within the echogram
        is evaluated as far as it falls, where `room_parameters` refuses: a fit must be able to
        come back from there. G is the level above that of the free field at 10 m.
    gradients : float array, shape (n_names, n_bins)
        Exact, with the instants at which the curve crosses -5 dB and the like moving along, and
        with the energy that is added for the time after the echogram.

    Raises
    ------
    InputError
        An unknown name, or an echogram without energy.
    """
    total = float(curve.energy_left[band, 0])
    if not total > 0.0:
        raise InputError("an echogram without energy has no room parameters")
    values = np.empty(len(names))
    by_left = np.zeros((len(names), len(curve.time_s)))
    for row, name in enumerate(names):
        if name in FIT_RANGES_DB:
            values[row], by_left[row] = _decay_time_s(curve, band, FIT_RANGES_DB[name])
        elif name in _EARLY_S:
            values[row], by_left[row] = _early(curve, band, name)
        elif name == "G_dB":
            values[row] = _DB * np.log(total / _ENERGY_AT_10_M)
            by_left[row, 0] = _DB / total
        elif name == "TS_ms":
            values[row], by_left[row] = _centre_time_ms(curve, band)
        else:
            raise InputError(
                "unknown room parameter", found=repr(name), needed=", ".join(VALUE_NAMES)
            )
    tail, tail_moment_s = _tail_gradients(curve, band)
    # a bin counts at every boundary before it, and a little in what comes after the echogram
    gradients = np.cumsum(by_left, axis=1)[:, :-1]
    gradients += by_left.sum(axis=1)[:, None] * tail
    for row in (i for i, name in enumerate(names) if name == "TS_ms"):
        gradients[row] += 1000.0 / total * tail_moment_s
    return values, gradients


def _decay_time_s(
    curve: DecayCurve, band: int, fit_range_db: tuple[float, float]
) -> tuple[float, FloatArray]:
    """Return a decay time and its derivative by the energy left at each boundary."""
    time_s, left = curve.time_s, curve.energy_left[band]
    level_db = np.maximum(_DB * np.log(np.maximum(left / left[0], 1e-30)), -300.0)
    begin_s, by_begin = _crossing(time_s, level_db, fit_range_db[0], curve.onset_s)
    end_s, by_end = _crossing(time_s, level_db, fit_range_db[1], curve.onset_s)
    span_s = end_s - begin_s
    if not span_s > 0.0:
        # nothing falls after the onset: longer than the echogram, by any measure
        return 60.0 * float(time_s[-1] - time_s[0]), np.zeros_like(left)
    u = np.linspace(0.0, 1.0, POINTS_OF_A_FIT)
    times = begin_s + span_s * u
    i = np.clip(np.searchsorted(time_s, times, side="right") - 1, 0, len(time_s) - 2)
    step_s = time_s[i + 1] - time_s[i]
    share = (times - time_s[i]) / step_s
    levels = (1.0 - share) * level_db[i] + share * level_db[i + 1]
    fall = (level_db[i + 1] - level_db[i]) / step_s
    weight = (u - 0.5) / (span_s * np.sum((u - 0.5) ** 2))
    slope = float(weight @ levels)
    if not slope < 0.0:
        return 60.0 * float(time_s[-1] - time_s[0]), np.zeros_like(left)
    by_level: FloatArray = np.zeros_like(left)
    np.add.at(by_level, i, weight * (1.0 - share))
    np.add.at(by_level, i + 1, weight * share)
    # the range moves: its points climb along the curve, and its width divides the slope
    along = weight * fall
    by_level += float(along @ (1.0 - u) + slope / span_s) * by_begin
    by_level += float(along @ u - slope / span_s) * by_end
    by_left = _DB * by_level / np.maximum(left, 1e-30 * left[0])
    by_left[0] -= _DB * float(by_level.sum()) / left[0]
    return -60.0 / slope, 60.0 / slope**2 * by_left


def _crossing(
    time_s: FloatArray, level_db: FloatArray, depth_db: float, onset_s: float
) -> tuple[float, FloatArray]:
    """Return when the curve falls below a depth, and the derivative by its levels.

    Not before the onset, and at the last boundary where it never falls so far: there the instant
    stands still.
    """
    by_level = np.zeros_like(level_db)
    below = np.flatnonzero(level_db < -depth_db)
    if not below.size:
        return float(time_s[-1]), by_level
    i = int(below[0])
    if i == 0:
        return onset_s, by_level
    fall = level_db[i - 1] - level_db[i]
    share = (level_db[i - 1] + depth_db) / fall
    step_s = time_s[i] - time_s[i - 1]
    found_s = float(time_s[i - 1] + share * step_s)
    if found_s <= onset_s:
        return onset_s, by_level
    by_level[i - 1] = (1.0 - share) * step_s / fall
    by_level[i] = share * step_s / fall
    return found_s, by_level


def _early(curve: DecayCurve, band: int, name: str) -> tuple[float, FloatArray]:
    """Return C50 or C80 in dB, or D50 in percent, with its derivative by the energy left."""
    left = curve.energy_left[band]
    i, share = _place(curve.time_s, curve.onset_s + _EARLY_S[name])
    weights: FloatArray = np.zeros_like(left)
    weights[i : i + 2] = 1.0 - share, share
    total, late = float(left[0]), float((1.0 - share) * left[i] + share * left[i + 1])
    if name == "D50_percent":
        by_left = -100.0 / total * weights
        by_left[0] += 100.0 * late / total**2
        return 100.0 * (1.0 - late / total), by_left
    # one part in 1e12 on either side keeps the logarithm where all is early, or all late
    late = float(np.clip(late, 1e-12 * total, (1.0 - 1e-12) * total))
    by_left = -_DB * total / (late * (total - late)) * weights
    by_left[0] += _DB / (total - late)
    return float(_DB * np.log(total / late - 1.0)), by_left


def _centre_time_ms(curve: DecayCurve, band: int) -> tuple[float, FloatArray]:
    """Return the centre time, with its derivative by the energy left (the tail's moment apart)."""
    time_s, left = curve.time_s, curve.energy_left[band]
    steps_s = np.diff(time_s)
    weights = 0.5 * (np.append(steps_s, 0.0) + np.insert(steps_s, 0, 0.0))
    moment = float(weights @ left) + float(left[-1] * curve.tail_time_constant_s[band])
    total = float(left[0])
    by_left = 1000.0 / total * weights
    by_left[0] -= 1000.0 * moment / total**2
    return 1000.0 * (moment / total - (curve.onset_s - float(time_s[0]))), by_left


def _tail_gradients(curve: DecayCurve, band: int) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of the tail's energy and of its moment by the energies of the bins.

    The tail is ``last**2 / (before - last)`` of two equal stretches at the end of the echogram,
    and its time constant ``step / ln(before / last)``.
    """
    edges = curve.time_s
    tail, constant_s = float(curve.energy_left[band, -1]), float(curve.tail_time_constant_s[band])
    if not (tail > 0.0 and constant_s > 0.0):
        return np.zeros(len(edges) - 1), np.zeros(len(edges) - 1)
    step_s = float(edges[-1] - edges[0]) / 6.0
    r = np.exp(-step_s / constant_s)
    last = tail * (1.0 - r) / r
    before = last / r
    after = [
        np.clip((edges[1:] - at_s) / np.diff(edges), 0.0, 1.0)
        for at_s in edges[-1] - step_s * np.array([2.0, 1.0])
    ]
    by_last, by_before = after[1], after[0] - after[1]
    gap = before - last
    by_tail = last * (2.0 * before - last) / gap**2 * by_last - (last / gap) ** 2 * by_before
    by_constant = constant_s**2 / step_s * (by_last / last - by_before / before)
    return by_tail, constant_s * by_tail + tail * by_constant


def _place(time_s: FloatArray, at_s: float) -> tuple[int, float]:
    """Return the boundary before an instant, and how far on the way to the next it lies, 0 to 1."""
    i = int(np.clip(np.searchsorted(time_s, at_s, side="right") - 1, 0, len(time_s) - 2))
    return i, float(np.clip((at_s - time_s[i]) / (time_s[i + 1] - time_s[i]), 0.0, 1.0))
