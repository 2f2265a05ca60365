"""Parameters of ISO 3382-1: those of an echogram with derivatives, and measured ones checked.

The derivative of a parameter by the energy of every bin serves three ends: with the derivative of
the energies by an absorption it gives that of the parameter; with the variance of the energies by
interference, or over the batches of a trace, the variance of the parameter.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Literal

import numpy as np

from roomfit.base.arguments import check_known, float_array
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding, Severity
from roomfit.base.kernels import kernel
from roomfit.base.typing import VALUE_NAMES as VALUE_NAMES
from roomfit.base.typing import FloatArray
from roomfit.base.typing import ValueName as ValueName
from roomfit.signals.decay import (
    FIT_RANGES_DB,
    DecayCurve,
    centre_time_ms,
    decay_time,
    early_part,
    jnd_of,
)

_DB = 10.0 / np.log(10.0)
# The direct sound of a source of unit power at 10 m: the level to which G refers.
_ENERGY_AT_10_M = 1.0 / (4.0 * np.pi * 100.0)


def value_gradients(
    curve: DecayCurve, band: int, names: Sequence[ValueName], *, derivative: bool = True
) -> tuple[FloatArray, FloatArray]:
    """Return parameters of an echogram and their derivatives by the energies of its bins.

    `curve`: from `roomfit.signals.decay.echogram_decay_curve`, for energies per square metre of a
    source of unit power where G is asked for. `names`: of `VALUE_NAMES`. `derivative`: without it
    the values come in half the time, and `gradients` is empty.

    `values` has the shape (n_names,): as of `room_parameters`. A decay that does not fall far
    enough within the echogram is evaluated as far as it falls, where `room_parameters` gives nan: a
    fit must be able to return from there. G is the level above that of the free field at 10 m.
    `gradients` has the shape (n_names, n_bins): exact, including the shift of the instants at which
    the curve crosses -5 dB and the like, and the energy that is added for the time after the
    echogram.
    """
    left = curve.energy_left[band]
    total = float(left[0])
    if not total > 0.0:
        what = "an echogram without energy has no room parameters"
        hint = "leave the band out, or trace more rays"
        raise InputError(what, found=f"energy 0 in band {band}", needed="energy above 0", hint=hint)
    values, by_left = np.empty(len(names)), np.zeros((len(names), len(left)))
    level_db = np.maximum(_DB * np.log(np.maximum(left / total, 1e-30)), -300.0)
    for row, name in enumerate(names):
        if name in FIT_RANGES_DB:
            values[row], by_level = decay_time(
                curve, level_db, FIT_RANGES_DB[name], derivative=derivative
            )
            by_left[row] = _DB * by_level / np.maximum(left, 1e-30 * total)
            by_left[row, 0] -= _DB * float(by_level.sum()) / total
        elif name == "G_dB":
            values[row], by_left[row, 0] = _DB * np.log(total / _ENERGY_AT_10_M), _DB / total
        elif name == "TS_ms":
            values[row], by_left[row] = centre_time_ms(curve, band, float(left[-1]))
        else:
            values[row], _, by_left[row] = early_part(curve, band, name)
    # nothing falls after the onset: longer than the echogram, by any measure
    values[np.isnan(values)] = 60.0 * float(curve.time_s[-1] - curve.time_s[0])
    if not derivative:
        return values, np.zeros((len(names), 0))
    tail, tail_moment_s = tail_gradients(curve, band)
    # a bin counts at every boundary before it, and a little in what comes after the echogram
    gradients = np.cumsum(by_left, axis=1)[:, :-1] + by_left.sum(axis=1)[:, None] * tail
    gradients[[name == "TS_ms" for name in names]] += 1000.0 / total * tail_moment_s
    return values, gradients


_POINTS_OF_A_LINE = (
    64  # of a decay range, at which `values_of_bins` puts its line through the levels
)


@kernel()
def _level_db(left: FloatArray, i: int) -> float:
    return 10.0 * math.log10(max(float(left[i] / left[0]), 1e-30))


@kernel()
def _share_above(left: FloatArray, i: int, depth: float) -> float:
    """Return the share of the bin before a boundary in which levels are above a depth."""
    level = _level_db(left, i - 1)
    return (level + depth) / max(level - _level_db(left, i), 1e-12)


@kernel()
def _decay_time_of_bins(
    left: FloatArray, edges_s: FloatArray, onset_s: float, high: float, low: float
) -> float:
    """Return the decay time between two depths in dB; far too long where nothing falls."""
    n_bins, step_s = len(edges_s) - 1, edges_s[1] - edges_s[0]
    above, below = left[0] * 10.0 ** (-0.1 * high), left[0] * 10.0 ** (-0.1 * low)
    begin, end = onset_s, edges_s[n_bins]
    for i in range(1, n_bins + 1):
        if left[i] < above and begin == onset_s:
            begin = max(edges_s[i - 1] + _share_above(left, i, high) * step_s, onset_s + 1e-9)
        if left[i] < below:
            end = edges_s[i - 1] + _share_above(left, i, low) * step_s
            break
    slope, squares = 0.0, 0.0
    for k in range(_POINTS_OF_A_LINE):
        u = k / (_POINTS_OF_A_LINE - 1.0)
        at = (begin + (end - begin) * u - edges_s[0]) / step_s
        i = min(int(at), n_bins - 1)
        level = _level_db(left, i)
        level += (at - i) * (_level_db(left, i + 1) - level)
        slope += (u - 0.5) * level
        squares += (u - 0.5) ** 2
    slope /= squares * max(end - begin, 1e-9)
    return -60.0 / slope if slope < 0.0 else 60.0 * float(edges_s[n_bins] - edges_s[0])


@kernel()
def values_of_bins(
    energies: FloatArray, shares: FloatArray, edges_s: FloatArray, onset_s: float
) -> FloatArray:
    """Return all values of many echograms of a pair, shape (n_points, 8), by `VALUE_NAMES`.

    For differences between absorptions: a line goes through fewer levels than that of
    `value_gradients`.

    `energies`, shape (n_points, n_bins): some energy in each row. `shares`, shape (2 n + 1,): of an
    energy that the filter carries from n bins before its own to n after it. `edges_s`, shape
    (n_bins + 1,): uniform.
    """
    n_bins = len(edges_s) - 1
    step_s, reach = edges_s[1] - edges_s[0], len(shares) // 2
    out = np.empty((len(energies), 8))
    for p in range(len(energies)):
        left = np.zeros(n_bins + 1)
        for i in range(n_bins):
            if energies[p, i] > 0.0:
                for k in range(max(i - reach, 0), min(i + reach + 1, n_bins)):
                    left[k] += energies[p, i] * shares[k - i + reach]
        for i in range(n_bins - 1, -1, -1):
            left[i] += left[i + 1]
        # after the last bin as over the last third of the time
        third = max(n_bins // 6, 1)
        before = left[n_bins - 2 * third] - left[n_bins - third]
        last = left[n_bins - third] - left[n_bins]
        ratio = last / before if 1e-12 * left[0] < last < before else 0.0
        tail = last * ratio / (1.0 - ratio)
        left += tail
        moment = step_s * (left.sum() - 0.5 * (left[0] + left[n_bins]))
        if ratio > 0.0:
            moment += tail * third * step_s / -math.log(ratio)
        total = left[0]
        out[p, 0] = _decay_time_of_bins(left, edges_s, onset_s, 0.0, 10.0)
        out[p, 1] = _decay_time_of_bins(left, edges_s, onset_s, 5.0, 25.0)
        out[p, 2] = _decay_time_of_bins(left, edges_s, onset_s, 5.0, 35.0)
        for row in range(3, 6):
            at = (onset_s + (0.08 if row == 4 else 0.05) - edges_s[0]) / step_s
            i = min(int(at), n_bins - 1)
            late = left[i] + min(at - i, 1.0) * (left[i + 1] - left[i])
            late = min(max(late, 1e-12 * total), (1.0 - 1e-12) * total)
            out[p, row] = 10.0 * math.log10(total / late - 1.0)
            if row == 5:
                out[p, row] = 100.0 * (1.0 - late / total)
        out[p, 6] = 1000.0 * (moment / total - (onset_s - edges_s[0]))
        out[p, 7] = 10.0 * math.log10(max(total, 1e-300) / _ENERGY_AT_10_M)
    return out


def tail_gradients(curve: DecayCurve, band: int) -> tuple[FloatArray, FloatArray]:
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


# What is possible in a room. Churches and reverberation chambers stay below 15 s; 10 cm from the
# source in a treated room C80 and G stay below 40 dB.
POSSIBLE: dict[ValueName, tuple[float, float, str]] = {
    "EDT_s": (0.01, 15.0, "s"),
    "T20_s": (0.03, 15.0, "s"),
    "T30_s": (0.03, 15.0, "s"),
    "C50_dB": (-40.0, 40.0, "dB"),
    "C80_dB": (-40.0, 40.0, "dB"),
    "D50_percent": (1.0, 100.0, "%"),
    "TS_ms": (0.1, 3000.0, "ms"),
    "G_dB": (-40.0, 45.0, "dB"),
}
_USUAL_UNIT = {"s": "milliseconds", "ms": "seconds", "%": "a fraction of 1", "dB": "a ratio"}
# T30 over T20, and EDT over either: beyond the first a doubt, beyond the second an error.
_DECAY_RATIOS: dict[ValueName, tuple[float, float]] = {"T30_s": (1.35, 2.5), "EDT_s": (2.0, 8.0)}
# D50 follows from C50, but means over teams or directions are taken of each by itself.
_DOUBT_PERCENT, _ERROR_PERCENT = 5.0, 20.0
_REFERENCES: tuple[ValueName, ...] = ("T20_s", "T30_s")


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredValues:
    """Room parameters measured between one source and one receiver.

    Examples
    --------
    >>> measured = MeasuredValues("LS1", "MP1", [500, 1000], {"T20_s": [1.21, 1.15]}, {})
    >>> measured.values["T20_s"].tolist()
    [1.21, 1.15]
    """

    source: str
    receiver: str
    centres_hz: FloatArray  #: (n_bands,), nominal, rising
    values: Mapping[ValueName, FloatArray]  #: (n_bands,) by `VALUE_NAMES`, in their units, or nan
    #: (n_bands,), stated standard deviation, or nan; of no other names than `values`
    spread: Mapping[ValueName, FloatArray] = field(default_factory=dict)
    use: Literal["fit", "validate"] = "fit"
    findings: tuple[Finding, ...] = ()  #: what reading the table raised
    state: str = ""  #: of the room, among its `states`; "": as the room is described

    def __post_init__(self) -> None:
        centres = float_array("band centres", self.centres_hz, (None,), low=1.0, unit="Hz")
        object.__setattr__(self, "centres_hz", centres)
        for name in ("values", "spread"):
            table = {}
            for key, row in getattr(self, name).items():
                where = f"{self.source} to {self.receiver}"
                check_known("unknown room parameter", key, VALUE_NAMES, where=where)
                check_known("a spread without its value", key, self.values, where=where)
                array = np.array(row, dtype=np.float64)
                if array.shape != centres.shape:
                    what, found = f"{key} has not one value a band", f"{array.size} values"
                    needed = f"{centres.size}, one for each of centres_hz"
                    hint = "give nan for what was not measured"
                    raise InputError(what, where=where, found=found, needed=needed, hint=hint)
                array.setflags(write=False)
                table[key] = array
            object.__setattr__(self, name, MappingProxyType(table))

    @property
    def pair_name(self) -> tuple[str, str, str]:
        """Source, receiver and state of the room."""
        return self.source, self.receiver, self.state

    def at(self, name: ValueName, wanted_hz: FloatArray) -> FloatArray:
        """Return a parameter at given centres of bands, NaN where it is unknown, (n_bands,)."""
        return self._row(self.values.get(name), wanted_hz)

    def spread_at(self, name: ValueName, wanted_hz: FloatArray) -> FloatArray:
        """Return its stated standard deviation, NaN where none is stated, shape (n_bands,)."""
        return self._row(self.spread.get(name), wanted_hz)

    def _row(self, row: FloatArray | None, wanted_hz: FloatArray) -> FloatArray:
        out: FloatArray = np.full(wanted_hz.size, np.nan)
        if row is not None:
            match = np.abs(self.centres_hz[None, :] / wanted_hz[:, None] - 1.0) < 1e-6
            found = match.any(axis=1)
            out[found] = row[match.argmax(axis=1)[found]]
        return out


def check_possible(name: ValueName, value: float, where: str) -> None:
    """Refuse a value that no room has."""
    low, high, unit = POSSIBLE[name]
    if not low <= value <= high:
        raise InputError(
            "implausible room parameter",
            where=where,
            found=f"{_short(name)} of {value:g} {unit}",
            needed=f"{low:g} to {high:g} {unit}",
            hint=f"is it in {_USUAL_UNIT[unit]}, or in the wrong row? leave the cell empty where "
            "it is unknown",
        )


def contradiction_findings(measured: MeasuredValues, where: str) -> tuple[Finding, ...]:
    """Return a finding where values of one pair are not consistent."""
    pair, doubts = f"{where}, {measured.source} to {measured.receiver}", []
    for band, centre_hz in enumerate(measured.centres_hz.tolist()):
        known = {k: float(v[band]) for k, v in measured.values.items() if np.isfinite(v[band])}
        for is_error, found, needed in _contradictions(known):
            if is_error:
                what = "room parameters that contradict each other"
                hint = "check units and rows; leave a cell empty where the value is not sure"
                raise InputError(
                    what, where=f"{pair} at {centre_hz:g} Hz", found=found, needed=needed, hint=hint
                )
            doubts.append((centre_hz, found))
    if not doubts:
        return ()
    bands = sorted({f for f, _ in doubts})
    sentence = (
        f"{pair}: {len(doubts)} pairs of values do not go well together; the first: "
        f"{doubts[0][1]} at {doubts[0][0]:g} Hz."
    )
    evidence = {"bands_hz": bands, "doubts": [f"{f:g} Hz: {s}" for f, s in doubts]}
    return (Finding(Code.ROOM_PARAMETERS_INCONSISTENT, About(bands_hz=bands), sentence, evidence),)


def _contradictions(known: dict[ValueName, float]) -> Iterator[tuple[bool, str, str]]:
    """Yield whether it is an error or a doubt, what values stand beside each other, and needed."""
    c50, c80, d50 = (known.get(name, np.nan) for name in ("C50_dB", "C80_dB", "D50_percent"))
    if c80 < c50:
        found = f"C80 of {c80:g} dB and C50 of {c50:g} dB"
        at_least = "C80 at least as large as C50: what is early within 50 ms is early within 80 ms"
        yield True, found, at_least
    expected = 100.0 / (1.0 + 10.0 ** (-0.1 * c50))
    if abs(expected - d50) > _DOUBT_PERCENT:
        found = f"D50 of {d50:g} % beside C50 of {c50:g} dB"
        is_error = abs(expected - d50) > _ERROR_PERCENT
        yield is_error, found, f"D50 near {expected:.0f} %, which is that C50"
    reference = next((n for n in _REFERENCES if n in known), None)
    for name, (doubt, error) in _DECAY_RATIOS.items():
        if reference in (None, name) or name not in known:
            continue
        value, other = known[name], known[reference]
        ratio = max(value / other, other / value)
        if ratio > doubt:
            found = f"{_short(name)} of {value:g} s beside {_short(reference)} of {other:g} s"
            yield ratio > error, found, f"times that differ by less than {error:g} times"


def joined_values(
    repeated: tuple[MeasuredValues, ...],
) -> tuple[MeasuredValues, tuple[Finding, ...]]:
    """Return several measurements of one pair as one, and a finding where they differ.

    The mean of what is known. Its standard deviation is the stated one or half of the range
    between them, whichever is larger.

    `repeated`: of one pair and with the same bands, at least one.
    """
    first = repeated[0]
    if len(repeated) == 1:
        return first, ()
    values: dict[ValueName, FloatArray] = {}
    spread: dict[ValueName, FloatArray] = {}
    worst: tuple[float, ValueName, float] = (0.0, "T20_s", 0.0)
    for name in dict.fromkeys(name for m in repeated for name in m.values):
        empty = np.full(first.centres_hz.size, np.nan)
        rows = np.ma.masked_invalid([m.values.get(name, empty) for m in repeated])
        stated = [m.spread.get(name, empty) for m in repeated]
        mean, apart = rows.mean(axis=0), np.ma.ptp(rows, axis=0)
        values[name] = mean.filled(np.nan)
        half = np.where(rows.count(axis=0) > 1, 0.5 * apart.filled(np.nan), np.nan)
        spread[name] = np.fmax.reduce([*stated, half], axis=0)
        for band in np.flatnonzero(rows.count(axis=0)):
            jnd = float(apart[band] / jnd_of(name, np.abs(mean[band])))
            if jnd > worst[0]:
                worst = (jnd, name, float(first.centres_hz[band]))
    joined = replace(first, values=values, spread=spread)
    apart, worst_name, centre_hz = worst
    if apart == 0.0:
        return joined, ()
    sentence = (
        f"{first.source} to {first.receiver} was measured {len(repeated)} times with different "
        f"results, {_short(worst_name)} at {centre_hz:g} Hz by {apart:.1f} just noticeable "
        "differences. Their mean is used, and half of the difference as its spread."
    )
    graded: Severity = "warning" if apart > 1.0 else "info"
    evidence = {"parameter": worst_name, "band_hz": centre_hz, "jnd": apart}
    about = About(bands_hz=[centre_hz], pairs=[(first.source, first.receiver)])
    return joined, (Finding(Code.REPEATED_VALUES_DIFFER, about, sentence, evidence, graded=graded),)


def _short(name: str) -> str:
    return name.split("_")[0]
