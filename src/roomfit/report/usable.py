"""What still holds where findings void single walls: the room's mean, groups, predicted decays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from roomfit.findings import Code, Finding
from roomfit.inversion.model_checks import DECAY_SCATTER, mean_miss
from roomfit.report.wording import (
    band_ranges,
    coefficient,
    count,
    hertz,
    listing,
    number,
    parameter,
)
from roomfit.results import Result
from roomfit.typing import BoolArray, FloatArray, IntArray

# Why walls are void, as part of a sentence; of every code that voids identifiability.
REASONS: Mapping[Code, str] = MappingProxyType(
    {
        Code.LEVELS_NOT_LINEAR: "the chain of the measurement is not linear",
        Code.DECAY_BENT: "the files contain a bent decay",
        Code.NOISE_GATED: "the files went through a noise gate",
        Code.EXCHANGED: "files are exchanged",
        Code.RECORDING_OF_TWO_PAIRS: "one recording stands for two pairs",
        Code.RECORDINGS_LATE: "recordings begin late",
        Code.COORDINATES_SCALED: "positions have another scale than the recordings",
        Code.LEVELS_APART: "levels of files are apart by another gain",
        Code.FIXED_ABSORPTION_CONTRADICTED: "a fixed absorption contradicts the data",
        Code.DISPLACEMENT_DETECTED: "positions or walls are not where they were specified",
        Code.POSITION_INCONSISTENT: "positions contradict the arrival times",
        Code.REFLECTION_DELAY_DETECTED: "reflections arrive later than the walls permit",
        Code.WALL_POSITION_MISMATCH: "walls are not where they were specified",
        Code.SOURCE_NOT_OMNIDIRECTIONAL: "a source is directional and was taken for "
        "omnidirectional",
        Code.SCATTERING_UNDERESTIMATED: "walls scatter more than was specified",
        Code.MODEL_MISFIT_ALL_BANDS: "the model explains no band",
    }
)
# The recorded decay itself, or the size of the room, is then another: neither the fit nor a
# formula of a diffuse field has a mean to give.
_VOID_THE_MEAN = frozenset(
    {Code.LEVELS_NOT_LINEAR, Code.DECAY_BENT, Code.NOISE_GATED, Code.COORDINATES_SCALED}
)
WIDEST_MEAN = 0.25  # half an interval over the value
_LARGEST_MISS_JND, _MISS_SDS = 2.0, 2.0
_AGREE = 0.15  # of two means, relatively: Eyring's formula is off by as much in boxes
_MOST_BANDS = 8  # named one by one


@dataclass(frozen=True, slots=True, eq=False)
class Remaining:
    """What may be used of a result of which findings void walls."""

    voids: tuple[Finding, ...]  # that take walls away, one a code; none: nothing is taken away
    taken: int  # absorptions that the rule alone calls identifiable, and the findings do not
    wanted: int  # absorptions that were not fixed
    mean_usable: BoolArray  # (n_bands,), whether the mean of the room and its interval hold
    # (n_bands,), predicted over measured less 1, median over pairs, of the decay time that most
    # pairs have; NaN where none is known
    decay_error: FloatArray
    decay_name: str  # of that decay time, as T20_s; "" where none is known
    sentences: tuple[str, ...]


def remaining_usable(result: Result) -> tuple[str, ...]:
    """Return in sentences what is not to be used and what is all the same; none: no wall is void.

    The first says which walls are taken away and why, the others what remains.
    """
    return what_remains(result).sentences


def what_remains(result: Result) -> Remaining:
    """Return what findings leave of a result.

    The mean of the room counts as usable in a band where no finding doubts the recorded decay or
    the size of the room, the decay of the fitted pairs is reproduced, and half the interval is at
    most a quarter of the value. Elsewhere it stands beside the mean that Eyring's formula gives of
    the measured decay.
    """
    voids = void_findings(result)
    fixed = result.lower95 == result.upper95
    name, error, reproduced = _decays(result)
    mean, lower, upper = result.mean_absorption
    doubted = np.array([_doubted(result, f) for f in map(float, result.bands.centres_hz)])
    narrow = upper - lower <= 2.0 * WIDEST_MEAN * mean
    usable = ~doubted & reproduced & narrow
    by_rule = result.identifiable_by_rule
    taken = 0 if by_rule is None else int((by_rule & ~result.identifiable & ~fixed).sum())
    found = Remaining(voids, taken, int((~fixed).sum()), usable, error, name, ())
    if not voids:
        return found
    sentences = (
        _what_is_void(result, found),
        _mean(result, found),
        _other_means(result, found),
        _decay(result, found),
    )
    return Remaining(
        voids, taken, found.wanted, usable, error, name, tuple(s for s in sentences if s)
    )


def void_findings(result: Result) -> tuple[Finding, ...]:
    """Return the first finding of each code that voids identifiability."""
    first: dict[Code, Finding] = {}
    for finding in result.findings:
        if finding.code.voids_identifiability:
            first.setdefault(finding.code, finding)
    return tuple(first.values())


def _doubted(result: Result, centre_hz: float) -> bool:
    """Return whether a finding about this band doubts the mean: chain, size, or decay."""
    return any(
        (f.code in _VOID_THE_MEAN or f.code is Code.DECAY_NOT_REPRODUCED)
        and f.about.in_band(centre_hz)
        for f in result.findings
    )


def _decays(result: Result) -> tuple[str, FloatArray, BoolArray]:
    """Return name and median relative error of the decay time, and where it is reproduced.

    As `roomfit.inversion.model_checks.decay_misses` judges it: the mean over the fitted pairs is
    missed by no more than two just noticeable differences, or two of its standard deviations.
    """
    n = len(result.bands)
    width_hz = result.bands.upper_hz - result.bands.lower_hz
    fitted = [p for p in result.pairs if p.use == "fit"] or list(result.pairs)
    name = next((k for k in DECAY_SCATTER if any(k in p.parameters for p in fitted)), "")
    error, reproduced = np.full(n, np.nan), np.zeros(n, dtype=np.bool_)
    rows = [p.parameters[name] for p in fitted if name in p.parameters]
    for band in range(n) if rows else ():
        both = np.array([(c.measured[band], c.predicted[band]) for c in rows])
        measured_s, predicted_s = both[np.isfinite(both).all(axis=1)].T
        if not measured_s.size:
            continue
        relative = predicted_s / measured_s - 1.0
        scatter = DECAY_SCATTER[name] / np.sqrt(width_hz[band] * measured_s)
        miss, sd = mean_miss(relative / 0.05, scatter)
        error[band] = np.median(relative)
        reproduced[band] = abs(miss) <= max(_LARGEST_MISS_JND, _MISS_SDS * sd)
    return name, error, reproduced


def _what_is_void(result: Result, found: Remaining) -> str:
    reasons = listing([REASONS[f.code] for f in found.voids[:2]])
    codes = ", ".join(f.code.value for f in found.voids)
    bands = sorted({f for v in found.voids for f in v.about.bands_hz})
    if any(not v.about.bands_hz for v in found.voids) or len(bands) == len(result.bands):
        where = ""
    else:
        where = " at " + band_ranges(
            result.bands.centres_hz, np.isin(result.bands.centres_hz, bands)
        )
    text = f"The walls' absorption{where} is not to be used: {reasons} [{codes}]."
    if found.taken:
        text += (
            f" {found.taken} of {count(found.wanted, 'value')} would be called identifiable "
            f"but for {codes}."
        )
    return text


def _mean(result: Result, found: Remaining) -> str:
    chosen = np.flatnonzero(found.mean_usable)
    if not chosen.size:
        return ""
    return f"Usable all the same: the mean absorption of the room, {_means(result, chosen)}."


def _means(result: Result, chosen: IntArray) -> str:
    """Return means with intervals, each of so few bands, or of the middle one of many."""
    shown = chosen
    if len(chosen) > _MOST_BANDS:
        distance = np.abs(np.log2(result.bands.centres_hz[chosen] / 1000.0))
        shown = chosen[[int(np.argmin(distance))]]
    cells = []
    for band in shown:
        value, low, high = (coefficient(float(x), 1.0) for x in result.mean_absorption[:, band])
        at = hertz(float(result.bands.centres_hz[band]))
        cells.append(f"{value} ({low} to {high}) at {at}")
    more = "" if len(shown) == len(chosen) else f", and in {len(chosen) - 1} more bands"
    return f"{', '.join(cells)}{more}"


def _other_means(result: Result, found: Remaining) -> str:
    """Return the mean where it is not usable by itself, beside Eyring's of the measured decay."""
    parts = []
    void = [f for f in found.voids if f.code in _VOID_THE_MEAN]
    left = ~found.mean_usable
    if void and left.any():
        where = band_ranges(result.bands.centres_hz, left)
        return (
            f"Not the mean at {where}: {REASONS[void[0].code]}, so that no decay time gives it, "
            "either."
        )
    for band in np.flatnonzero(left):
        at = hertz(float(result.bands.centres_hz[band]))
        value, low, high = map(float, result.mean_absorption[:, band])
        own = f"{coefficient(value, 1.0)} ({coefficient(low, 1.0)} to {coefficient(high, 1.0)})"
        if result.eyring_absorption is None or not np.isfinite(found.decay_error[band]):
            parts.append(f"{at} {own}, with nothing to compare it with")
            continue
        by_decay = float(result.eyring_absorption[band])
        agrees = abs(by_decay / value - 1.0) <= _AGREE
        word = "and" if agrees else "but"
        parts.append(f"{at} {own}, {word} {coefficient(by_decay, 1.0)} by Eyring")
    if not parts:
        return ""
    return (
        "With less trust, for the interval is wide or the fitted decay is not the measured one, "
        f"mean absorption beside that of the measured decay: {'; '.join(parts[:_MOST_BANDS])}."
    )


def _decay(result: Result, found: Remaining) -> str:
    known = np.isfinite(found.decay_error)
    if not known.any():
        return ""
    cells = [
        f"{number(100.0 * float(found.decay_error[j]), 0, signed=True)} % at "
        f"{hertz(float(result.bands.centres_hz[j]))}"
        for j in np.flatnonzero(known)[:_MOST_BANDS]
    ]
    symbol = parameter(found.decay_name).symbol
    return (
        f"The predicted decay is off the measured {symbol} by {', '.join(cells)} (median over "
        "the pairs)."
    )
