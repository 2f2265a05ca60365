"""What still holds where findings void walls, and where predictions are off."""

from __future__ import annotations

import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from types import MappingProxyType

import numpy as np

from roomfit.base.air import attenuation_per_m
from roomfit.base.findings import Code, Finding
from roomfit.base.table import Cell, Table
from roomfit.base.typing import FloatArray
from roomfit.checks.decay import DECAY_SCATTER, mean_miss
from roomfit.checks.verdict import VOID_ANY_MEAN, Remaining, what_remains
from roomfit.report import wording
from roomfit.report.tables import compared_pairs, known_or, parameter_keys
from roomfit.result import Result
from roomfit.room.mesh import volume_m3
from roomfit.room.scene import Scene

# By code why walls are void, of every code that voids them, and what cures it.
_REASONS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    tomllib.loads(files("roomfit.report").joinpath("templates/reasons.toml").read_text("utf-8"))
)
_AGREE = 0.15  # of two means, relatively: Eyring's formula is off by as much in boxes
_MOST_BANDS = 8  # named one by one


# ---------------------------------------------------------------- what is serious, what is usable


def serious_lines(findings: Sequence[Finding]) -> tuple[str, ...]:
    """Return each kind of serious finding once, in a line: what it is, and what cures it."""
    lines = []
    for code, times in Counter(f.code for f in findings if f.severity == "serious").items():
        cure = _REASONS.get(code, {}).get("cure", "read what it says under Findings")
        lines.append(f"Serious: {_why(code)}{f' ({times} times)' * (times > 1)}. Cure: {cure}.")
    return tuple(lines)


def _why(code: Code) -> str:
    return _REASONS.get(code, {}).get("why") or code.value.replace("-", " ")


def remaining_usable(result: Result) -> tuple[str, ...]:
    """Return in sentences what is not to be used and what is all the same; none: no wall is void.

    The first says which walls are taken away and why, the others what remains.
    """
    found = what_remains(result)
    taken = ""
    if found.taken:
        reasons = "; ".join(f"{code.value}: {_why(code)}" for code in found.codes)
        words = wording.count(found.wanted, "value")
        taken = f"{found.taken} of {words} would be called identifiable but for {reasons}."
    if not found.voids:
        return (taken,) if taken else ()
    return tuple(filter(None, (_what_is_void(result, found), taken, *_what_is_left(result, found))))


def _what_is_void(result: Result, found: Remaining) -> str:
    centres = result.bands.centres_hz
    bands = {f for v in found.voids for f in v.about.bands_hz}
    where = ""
    if all(v.about.bands_hz for v in found.voids) and len(bands) < len(centres):
        where = f" at {wording.band_ranges(centres, np.isin(centres, sorted(bands)))}"
    why = ""
    if not found.taken:  # else the next sentence says it
        codes = ", ".join(f.code.value for f in found.voids)
        why = f": {wording.listing([_why(f.code) for f in found.voids[:2]])} [{codes}]"
    return f"The walls' absorption{where} is not to be used{why}."


def _what_is_left(result: Result, found: Remaining) -> Iterable[str]:
    """Yield what is known of the mean absorption of the room, and of its decay."""
    centres, eyring = result.bands.centres_hz, result.eyring_absorption
    heads = [wording.hertz(float(f)) for f in centres]
    means = [
        f"{wording.coefficient(value, 1.0)} ({wording.coefficient(low, 1.0)} to "
        f"{wording.coefficient(high, 1.0)})"
        for value, low, high in result.mean_absorption.T.tolist()
    ]
    chosen = np.flatnonzero(found.mean_usable)
    if chosen.size:
        shown, more = chosen, ""
        if len(chosen) > _MOST_BANDS:  # the middle one of many
            shown = chosen[[int(np.argmin(np.abs(np.log2(centres[chosen] / 1000.0))))]]
            more = f", and in {len(chosen) - 1} more bands"
        each = ", ".join(f"{means[band]} at {heads[band]}" for band in shown)
        yield f"Usable all the same: the mean absorption of the room, {each}{more}."
    left = np.flatnonzero(~found.mean_usable)
    void = [f for f in found.voids if f.code in VOID_ANY_MEAN]
    if void and left.size:
        where, why = wording.band_ranges(centres, ~found.mean_usable), _why(void[0].code)
        yield f"Not the mean at {where}: {why}, so that no decay time gives it, either."
    elif left.size:
        parts = []
        for band in left[:_MOST_BANDS]:
            beside = "with nothing to compare it with"
            if eyring is not None and np.isfinite(found.decay_error[band]):
                agrees = abs(eyring[band] / result.mean_absorption[0, band] - 1.0) <= _AGREE
                word = "and" if agrees else "but"
                beside = f"{word} {wording.coefficient(float(eyring[band]), 1.0)} by Eyring"
            parts.append(f"{heads[band]} {means[band]}, {beside}")
        yield (
            "With less trust, because the interval is wide or the fitted decay is not the measured "
            f"one, mean absorption beside that of the measured decay: {'; '.join(parts)}."
        )
    known = np.flatnonzero(np.isfinite(found.decay_error))[:_MOST_BANDS]
    if known.size:
        errors = (
            wording.number(100.0 * float(found.decay_error[j]), 0, signed=True) for j in known
        )
        off = ", ".join(f"{x} % at {heads[j]}" for x, j in zip(errors, known, strict=True))
        symbol = wording.parameter(found.decay_name).symbol
        yield f"The predicted decay is off the measured {symbol} by {off} (median over the pairs)."


# ---------------------------------------------------------------- where predictions are off

_AUDIBLE_JND, _BEYOND_SDS = 1.0, 2.0


def disagreement_table(answer: Result, scene: Scene) -> Table | None:
    """Return where a decay time or the clarity is off by more than a listener notices.

    A band is listed where the mean over pairs of predicted minus measured is more than one just
    noticeable difference and twice its own standard deviation (systematic), or where single pairs
    are off by two in the root mean square (scatter). Beside it stands the scatter of single
    positions: of decay times what ISO 3382-2 expects of interference alone [1]_, of clarity that
    of the measured positions about the mean of the others; and of a decay time which mean
    absorption would remove a systematic difference. None where there is neither.

    References
    ----------
    .. [1] ISO 3382-2:2008, annex A; as in `roomfit.checks.decay.decay_misses`.
    """
    pairs, rows = compared_pairs(answer.pairs), []
    known = parameter_keys(pairs)
    # of each kind what is known in most bands
    kinds = ("T20_s", "T30_s", "EDT_s"), ("C80_dB", "C50_dB", "D50_percent")
    keys = (next((key for key in kind if key in known), None) for kind in kinds)
    for key in filter(None, keys):
        compared = [pair.parameters[key] for pair in pairs if key in pair.parameters]
        values = np.array([(c.measured, c.jnd, c.null) for c in compared], dtype=np.float64)
        for band in range(len(answer.bands)):
            off = values[np.isfinite(values[:, :2, band]).all(axis=1), :, band].T
            if off.size and (row := _disagreement(answer, scene, key, band, off)) is not None:
                rows.append(row)
    if not rows:
        return None
    which = wording.count(len(pairs), "pair") + " not fitted" * (pairs[0].use == "validate")
    columns = ("", "predicted minus measured", "scatter expected", "mean absorption without it")
    caption = f"Where model and measurement disagree audibly, {which}"
    return Table(caption, columns, rows)


def _disagreement(
    answer: Result, scene: Scene, key: str, band: int, off: FloatArray
) -> tuple[Cell, ...] | None:
    """Return how far off one parameter is in one band, and what that means; None: not far.

    `off` has measured values, errors in JND and the baseline of all pairs, shape (3, n_pairs).
    """
    measured, jnd, baseline = off
    unit = wording.parameter(key).error_unit
    step, decimals = {"%": (5.0, 0), "dB": (1.0, 1), "points": (5.0, 1)}[unit]
    if key in DECAY_SCATTER:
        width_hz = float(answer.bands.upper_hz[band] - answer.bands.lower_hz[band])
        scatter = DECAY_SCATTER[key] / np.sqrt(width_hz * measured) / 0.05
    else:
        known = (measured - baseline)[np.isfinite(baseline)] / step
        scatter = np.full(measured.shape, np.sqrt(np.mean(known**2)) if known.size else np.nan)
    mean, sd = mean_miss(jnd, 0.05 * np.nan_to_num(scatter))
    rms, expected = (float(np.sqrt(np.mean(x**2))) for x in (jnd, scatter))
    needed = Cell(wording.DASH, ("not its sign",), "missing")
    if abs(mean) > max(_AUDIBLE_JND, _BEYOND_SDS * sd):
        size, kind = wording.number(mean * step, decimals, signed=True), "systematic"
        if key in DECAY_SCATTER:
            needed = _needed(answer, scene, band, 0.05 * mean)
    elif rms > 2.0 * _AUDIBLE_JND:
        size, kind = f"±{wording.number(rms * step, decimals)}", "scatter"
    else:
        return None
    head = f"{wording.parameter(key).symbol}, {wording.hertz(float(answer.bands.centres_hz[band]))}"
    beside = known_or(Cell(wording.number(expected * step, decimals), (unit,)), "no others")
    return Cell(head), Cell(f"{size} {unit}", (kind,)), beside, needed


def _needed(answer: Result, scene: Scene, band: int, excess: float) -> Cell:
    """Return which mean absorption would remove a decay that is too long by a share of itself.

    By Sabine's formula with air: the time is inversely proportional to ``alpha S + 4 m V``.
    """
    value, lower, upper = (float(x) for x in answer.mean_absorption[:, band])
    air = 4.0 * float(attenuation_per_m(scene.air, answer.bands)[band])
    air *= volume_m3(scene.room.mesh) / float(np.sum(answer.areas_m2))
    needed = (value + air) * (1.0 + excess) - air
    if not 0.0 <= needed <= 1.0:
        return Cell(wording.DASH, ("none between 0 and 1",), "missing")
    within, style = ("inside", "") if lower <= needed <= upper else ("outside", "worse")
    words = f"in place of {wording.coefficient(value, 1.0)}", f"{within} its interval"
    return Cell(wording.coefficient(needed, 1.0), words, style)
