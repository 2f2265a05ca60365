"""What still holds where findings void single walls, in sentences: mean of the room, decays."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from roomfit.base.findings import Code
from roomfit.base.typing import IntArray
from roomfit.checks.verdict import VOID_ANY_MEAN, Remaining, what_remains
from roomfit.report.wording import (
    band_ranges,
    coefficient,
    count,
    hertz,
    listing,
    number,
    parameter,
)
from roomfit.result import Result

# Why walls are void, as part of a sentence; of every code that voids them.
REASONS: Mapping[Code, str] = MappingProxyType(
    {
        Code.DECAY_BENT: "the files contain a bent decay",
        Code.NOISE_GATED: "the files went through a noise gate",
        Code.EXCHANGED: "files are exchanged",
        Code.RECORDING_OF_TWO_PAIRS: "one recording stands for two pairs",
        Code.RECORDINGS_LATE: "recordings begin late",
        Code.COORDINATES_SCALED: "positions have another scale than the recordings",
        Code.LEVELS_APART: "levels of files are apart by another gain",
        Code.DISPLACEMENT_DETECTED: "positions or walls are not where they were specified",
        Code.POSITION_INCONSISTENT: "positions contradict the arrival times",
        Code.REFLECTION_DELAY_DETECTED: "reflections arrive later than the walls permit",
        Code.WALL_POSITION_MISMATCH: "walls are not where they were specified",
        Code.SOURCE_NOT_OMNIDIRECTIONAL: "a source is directional and was taken for "
        "omnidirectional",
        Code.SCATTERING_UNDERESTIMATED: "walls scatter more than was specified",
        Code.MODEL_MISFIT_ALL_BANDS: "the model does not explain the data",
        Code.DECAY_NOT_REPRODUCED: "the fitted decay is not that of the measurement",
        Code.REFLECTION_DISAGREES: "single reflections contradict the absorption of their wall",
        Code.MIRROR_AMBIGUITY: "walls can be exchanged without changing any response",
    }
)
_AGREE = 0.15  # of two means, relatively: Eyring's formula is off by as much in boxes
_MOST_BANDS = 8  # named one by one


def remaining_usable(result: Result) -> tuple[str, ...]:
    """Return in sentences what is not to be used and what is all the same; none: no wall is void.

    The first says which walls are taken away and why, the others what remains.
    """
    found = what_remains(result)
    if not found.voids:
        return _taken_back(found)
    sentences = (
        _what_is_void(result, found),
        *_taken_back(found),
        _mean(result, found),
        _other_means(result, found),
        _decay(result, found),
    )
    return tuple(s for s in sentences if s)


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
    why = "" if found.taken else f": {reasons} [{codes}]"  # else the next sentence says it
    return f"The walls' absorption{where} is not to be used{why}."


def _taken_back(found: Remaining) -> tuple[str, ...]:
    """Return how many values the rule alone would call identifiable, and why they are not."""
    if not found.taken:
        return ()
    reasons = "; ".join(f"{code.value}: {REASONS[code]}" for code in found.codes)
    words = count(found.wanted, "value")
    return (f"{found.taken} of {words} would be called identifiable but for {reasons}.",)


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
    void = [f for f in found.voids if f.code in VOID_ANY_MEAN]
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
        "With less trust, because the interval is wide or the fitted decay is not the measured "
        f"one, mean absorption beside that of the measured decay: {'; '.join(parts[:_MOST_BANDS])}."
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
