"""Room parameters that somebody measured, and whether they can be true."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from roomfit.checks import float_array
from roomfit.errors import InputError
from roomfit.findings import Finding, Severity
from roomfit.signals.jnd import jnd_of
from roomfit.signals.parameter_gradients import VALUE_NAMES, ValueName
from roomfit.typing import FloatArray

# What a room can have. Churches and reverberation chambers stay below 15 s; a hand's breadth from
# the source in a treated room C80 and G stay below 40 dB.
POSSIBLE: dict[ValueName, tuple[float, float, str]] = {
    "EDT_s": (0.01, 15.0, "s"),
    "T20_s": (0.03, 15.0, "s"),
    "T30_s": (0.03, 15.0, "s"),
    "C50_dB": (-40.0, 40.0, "dB"),
    "C80_dB": (-40.0, 40.0, "dB"),
    "D50_percent": (0.0, 100.0, "%"),
    "TS_ms": (0.1, 3000.0, "ms"),
    "G_dB": (-40.0, 45.0, "dB"),
}
_USUAL_UNIT = {"s": "milliseconds", "ms": "seconds", "%": "a fraction of 1", "dB": "a ratio"}
# T30 over T20, and EDT over either: beyond the first a doubt, beyond the second an error.
_DECAY_RATIOS: dict[ValueName, tuple[float, float]] = {"T30_s": (1.35, 2.5), "EDT_s": (2.0, 8.0)}
# D50 is C50 in other words. Means over teams or directions are taken of each by itself.
_DOUBT_PERCENT, _ERROR_PERCENT = 5.0, 20.0


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredValues:
    """What was measured between one source and one receiver.

    Attributes
    ----------
    source, receiver : str
    centres_hz : float array, shape (n_bands,)
        Nominal centres, rising.
    values : mapping of value name to float array, shape (n_bands,)
        In the units that the names of `VALUE_NAMES` tell; NaN where unknown.
    spread : mapping of value name to float array, shape (n_bands,)
        Stated standard deviation; NaN where none was stated. Of no other names than `values`.
    """

    source: str
    receiver: str
    centres_hz: FloatArray
    values: Mapping[ValueName, FloatArray]
    spread: Mapping[ValueName, FloatArray]

    def __post_init__(self) -> None:
        centres = float_array("band centres", self.centres_hz, (None,), low=1.0, unit="Hz")
        object.__setattr__(self, "centres_hz", centres)
        for name in ("values", "spread"):
            table = {}
            for key, row in getattr(self, name).items():
                if key not in VALUE_NAMES or key not in self.values:
                    raise InputError(
                        "unknown room parameter",
                        where=f"{self.source} to {self.receiver}",
                        found=repr(key),
                        needed=", ".join(VALUE_NAMES),
                    )
                array = np.array(row, dtype=np.float64)
                if array.shape != centres.shape:
                    raise InputError(
                        f"{key} has not one value a band",
                        where=f"{self.source} to {self.receiver}",
                        found=f"{array.size} values",
                        needed=f"{centres.size}",
                    )
                array.setflags(write=False)
                table[key] = array
            object.__setattr__(self, name, MappingProxyType(table))


def check_possible(name: ValueName, value: float, where: str) -> None:
    """Refuse a value that no room has.

    Raises
    ------
    InputError
        Names the value, the limits and the mistake that is behind it most often.
    """
    low, high, unit = POSSIBLE[name]
    if not low <= value <= high:
        raise InputError(
            "implausible room parameter",
            where=where,
            found=f"{_short(name)} of {value:g} {unit}",
            needed=f"{low:g} to {high:g} {unit}",
            hint=f"is it in {_USUAL_UNIT[unit]}, or in the wrong row? leave the cell empty where "
            "it is not known",
        )


def contradiction_findings(measured: MeasuredValues, where: str) -> tuple[Finding, ...]:
    """Return the doubts about values of one pair that do not go together.

    Raises
    ------
    InputError
        They cannot be of one response: C80 below C50, D50 of another C50, or decay times that
        differ by a factor that no decay has.
    """
    doubts: list[tuple[float, str]] = []
    for band, centre_hz in enumerate(measured.centres_hz):
        at = f"{where}, {measured.source} to {measured.receiver} at {centre_hz:g} Hz"
        known = {k: float(v[band]) for k, v in measured.values.items() if np.isfinite(v[band])}
        for sentence in (*_energy_doubts(known, at), *_decay_doubts(known, at)):
            doubts.append((float(centre_hz), sentence))
    if not doubts:
        return ()
    bands = sorted({f for f, _ in doubts})
    return (
        Finding(
            "parameters-doubtful",
            "warning",
            f"{where}, {measured.source} to {measured.receiver}: {len(doubts)} pairs of values do "
            f"not go well together; the first: {doubts[0][1]} at {doubts[0][0]:g} Hz.",
            {"bands_hz": bands, "doubts": [f"{f:g} Hz: {s}" for f, s in doubts]},
        ),
    )


def joined_values(
    repeated: tuple[MeasuredValues, ...],
) -> tuple[MeasuredValues, tuple[Finding, ...]]:
    """Return several measurements of one pair as one, and a finding where they differ.

    The mean of what is known. Their spread is what is stated or half of the range between them,
    whichever is larger: a pair that was measured twice with different results is less sure.

    Parameters
    ----------
    repeated : tuple of MeasuredValues
        Of one pair and with the same bands, at least one.
    """
    first = repeated[0]
    if len(repeated) == 1:
        return first, ()
    names = list(dict.fromkeys(name for m in repeated for name in m.values))
    values: dict[ValueName, FloatArray] = {}
    spread: dict[ValueName, FloatArray] = {}
    worst: tuple[float, str, float] = (0.0, "", 0.0)
    for name in names:
        empty = np.full(first.centres_hz.size, np.nan)
        rows = np.array([m.values.get(name, empty) for m in repeated])
        stated = np.array([m.spread.get(name, empty) for m in repeated])
        values[name], half = empty.copy(), empty.copy()
        for band in np.flatnonzero(np.isfinite(rows).any(axis=0)):
            seen = rows[np.isfinite(rows[:, band]), band]
            values[name][band] = seen.mean()
            half[band] = 0.5 * np.ptp(seen) if seen.size > 1 else np.nan
            apart = float(np.ptp(seen) / jnd_of(name, np.abs(seen.mean())))
            if apart > worst[0]:
                worst = (apart, name, float(first.centres_hz[band]))
        candidates = np.vstack((stated, half[None]))
        spread[name] = np.fmax.reduce(candidates, axis=0)
    joined = MeasuredValues(first.source, first.receiver, first.centres_hz, values, spread)
    apart, worst_name, centre_hz = worst
    if apart == 0.0:
        return joined, ()
    sentence = (
        f"{first.source} to {first.receiver} was measured {len(repeated)} times with different "
        f"results, {_short(worst_name)} at {centre_hz:g} Hz by {apart:.1f} just noticeable "
        "differences. Their mean is used, and half of the difference as its spread."
    )
    severity: Severity = "warning" if apart > 1.0 else "info"
    evidence = {"parameter": worst_name, "band_hz": centre_hz, "jnd": apart}
    return joined, (Finding("pair-measured-twice", severity, sentence, evidence),)


def _energy_doubts(known: dict[ValueName, float], at: str) -> list[str]:
    if "C80_dB" in known and "C50_dB" in known and known["C80_dB"] < known["C50_dB"]:
        raise _contradiction(
            at,
            f"C80 of {known['C80_dB']:g} dB and C50 of {known['C50_dB']:g} dB",
            "C80 at least as large as C50: what is early within 50 ms is early within 80 ms",
        )
    if "C50_dB" not in known or "D50_percent" not in known:
        return []
    expected = 100.0 / (1.0 + 10.0 ** (-0.1 * known["C50_dB"]))
    told = f"D50 of {known['D50_percent']:g} % beside C50 of {known['C50_dB']:g} dB"
    off = abs(expected - known["D50_percent"])
    if off > _ERROR_PERCENT:
        raise _contradiction(at, told, f"D50 near {expected:.0f} %, which is that C50")
    return [told] if off > _DOUBT_PERCENT else []


def _decay_doubts(known: dict[ValueName, float], at: str) -> list[str]:
    times: tuple[ValueName, ...] = ("T20_s", "T30_s")
    reference = next((n for n in times if n in known), None)
    doubts: list[str] = []
    if reference is None:
        return doubts
    for name, (doubt, error) in _DECAY_RATIOS.items():
        value = known.get(name)
        if value is None or name == reference:
            continue
        told = f"{_short(name)} of {value:g} s beside {_short(reference)} of {known[reference]:g} s"
        ratio = max(value / known[reference], known[reference] / value)
        if ratio > error:
            raise _contradiction(at, told, f"times that differ by less than {error:g} times")
        if ratio > doubt:
            doubts.append(told)
    return doubts


def _contradiction(at: str, found: str, needed: str) -> InputError:
    return InputError(
        "room parameters that contradict each other",
        where=at,
        found=found,
        needed=needed,
        hint="check units and rows; leave a cell empty where the value is not sure",
    )


def _short(name: str) -> str:
    return name.split("_")[0]
