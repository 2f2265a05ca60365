"""What still holds where findings void walls, and why predictions differ from measurements."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType

import numpy as np

from roomfit.base.air import attenuation_per_m
from roomfit.base.findings import Code
from roomfit.base.table import Cell, Table
from roomfit.base.typing import FloatArray
from roomfit.checks.decay import DECAY_SCATTER, mean_miss
from roomfit.checks.verdict import VOID_ANY_MEAN, Remaining, what_remains
from roomfit.report.tables import compared_pairs, parameter_keys
from roomfit.report.wording import (
    band_ranges,
    coefficient,
    count,
    decay_time_key,
    hertz,
    listing,
    number,
    parameter,
)
from roomfit.result import Result
from roomfit.room.mesh import volume_m3
from roomfit.room.scene import Scene
from roomfit.uncertainty.gaussian import LARGEST_CHI2_REDUCED

# Why walls are void, or predictions off, as part of a sentence; of every code that voids walls.
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
        Code.BELOW_SCHROEDER_FREQUENCY: "single modes are resolved, which the model does not "
        "contain",
        Code.DECAY_RANGE_TOO_SMALL: "noise leaves little of the decay",
    }
)
_AGREE = 0.15  # of two means, relatively: Eyring's formula is off by as much in boxes
_MOST_BANDS = 8  # named one by one


# ---------------------------------------------------------------- what is usable


def remaining_usable(result: Result) -> tuple[str, ...]:
    """Return in sentences what is not to be used and what is all the same; none: no wall is void.

    The first says which walls are taken away and why, the others what remains.
    """
    found = what_remains(result)
    taken = ""
    if found.taken:
        reasons = "; ".join(f"{code.value}: {REASONS[code]}" for code in found.codes)
        words = count(found.wanted, "value")
        taken = f"{found.taken} of {words} would be called identifiable but for {reasons}."
    if not found.voids:
        return (taken,) if taken else ()
    return tuple(filter(None, (_what_is_void(result, found), taken, *_what_is_left(result, found))))


def _what_is_void(result: Result, found: Remaining) -> str:
    centres = result.bands.centres_hz
    bands = {f for v in found.voids for f in v.about.bands_hz}
    where = ""
    if all(v.about.bands_hz for v in found.voids) and len(bands) < len(centres):
        where = f" at {band_ranges(centres, np.isin(centres, sorted(bands)))}"
    why = ""
    if not found.taken:  # else the next sentence says it
        codes = ", ".join(f.code.value for f in found.voids)
        why = f": {listing([REASONS[f.code] for f in found.voids[:2]])} [{codes}]"
    return f"The walls' absorption{where} is not to be used{why}."


def _what_is_left(result: Result, found: Remaining) -> Iterable[str]:
    """Yield what is known of the mean absorption of the room, and of its decay."""
    heads = [hertz(float(f)) for f in result.bands.centres_hz]
    means = []
    for value, low, high in result.mean_absorption.T.tolist():
        bounds = f"({coefficient(low, 1.0)} to {coefficient(high, 1.0)})"
        means.append(f"{coefficient(value, 1.0)} {bounds}")
    chosen = np.flatnonzero(found.mean_usable)
    if chosen.size:
        shown, more = chosen, ""
        if len(chosen) > _MOST_BANDS:  # the middle one of many
            distance = np.abs(np.log2(result.bands.centres_hz[chosen] / 1000.0))
            shown = chosen[[int(np.argmin(distance))]]
            more = f", and in {len(chosen) - 1} more bands"
        each = ", ".join(f"{means[band]} at {heads[band]}" for band in shown)
        yield f"Usable all the same: the mean absorption of the room, {each}{more}."
    left = np.flatnonzero(~found.mean_usable)
    void = [f for f in found.voids if f.code in VOID_ANY_MEAN]
    if void and left.size:
        where = band_ranges(result.bands.centres_hz, ~found.mean_usable)
        why = REASONS[void[0].code]
        yield f"Not the mean at {where}: {why}, so that no decay time gives it, either."
    elif left.size:
        parts = []
        for band in left[:_MOST_BANDS]:
            own = f"{heads[band]} {means[band]}"
            if result.eyring_absorption is None or not np.isfinite(found.decay_error[band]):
                parts.append(f"{own}, with nothing to compare it with")
                continue
            by_decay = float(result.eyring_absorption[band])
            agrees = abs(by_decay / result.mean_absorption[0, band] - 1.0) <= _AGREE
            word = "and" if agrees else "but"
            parts.append(f"{own}, {word} {coefficient(by_decay, 1.0)} by Eyring")
        yield (
            "With less trust, because the interval is wide or the fitted decay is not the measured "
            f"one, mean absorption beside that of the measured decay: {'; '.join(parts)}."
        )
    known = np.flatnonzero(np.isfinite(found.decay_error))[:_MOST_BANDS]
    if known.size:
        off = ", ".join(
            f"{number(100.0 * float(found.decay_error[j]), 0, signed=True)} % at {heads[j]}"
            for j in known
        )
        symbol = parameter(found.decay_name).symbol
        yield f"The predicted decay is off the measured {symbol} by {off} (median over the pairs)."


# ---------------------------------------------------------------- where predictions are off

_AUDIBLE_JND, _BEYOND_SDS = 1.0, 2.0
_INTERFERENCE = (
    "None: energies that add predict the mean over positions, and absorption is fitted to all "
    "windows together."
)
_EARLY = "early reflections, directivity or scattering are not as the model has them"
_PRESSURES = (
    "the fit added pressures: between smooth, parallel walls these decay differently from energies"
)
_NOT_THE_WALLS = (
    "None by itself: the fitted windows agree, and no check found their decay missed. Predicted "
    "decay times of this room are off by as much."
)
_MISFIT = "Not to be used: intervals are widened by the misfit, nothing is identifiable."
_UNEXPLAINED = (
    "Little: the windows that were fitted agree within their errors; predictions of single "
    "positions are as uncertain as this."
)


def disagreement_table(answer: Result, scene: Scene) -> Table | None:
    """Return where a decay time or the clarity is off by more than a listener notices, and why.

    A band is listed where the mean over pairs of predicted minus measured is more than one just
    noticeable difference and twice its own standard deviation (systematic), or where single pairs
    are off by two in the root mean square (scatter). The first is read against what absorption
    would remove it; of the second, ISO 3382-2 says how much interference makes by itself [1]_.
    None where there is neither.

    References
    ----------
    .. [1] ISO 3382-2:2008, annex A; as in `roomfit.checks.decay.decay_misses`.
    """
    pairs, centres = compared_pairs(answer), answer.bands.centres_hz
    known = parameter_keys(pairs)
    early = next((key for key in ("C80_dB", "C50_dB", "D50_percent") if key in known), None)
    alike: dict[tuple[str, str, str], list[tuple[int, str]]] = {}
    for key in filter(None, (decay_time_key(known), early)):
        compared = [pair.parameters[key] for pair in pairs if key in pair.parameters]
        rows = np.array([(c.measured, c.jnd, c.null) for c in compared], dtype=np.float64)
        for band in range(len(centres)):
            off = rows[np.isfinite(rows[:, :2, band]).all(axis=1), :, band].T
            if off.size and (said := _disagreement(answer, scene, key, band, off)) is not None:
                size, why, meaning = said
                alike.setdefault((key, why, meaning), []).append((band, size))
    if not alike:
        return None
    rows_of = []
    for (key, why, meaning), said_of in alike.items():
        bands, sizes = zip(*said_of, strict=True)
        where = band_ranges(centres, np.isin(np.arange(len(centres)), bands))
        words = ("; ".join(sizes), why, meaning)
        head = f"{parameter(key).symbol}, {where}"
        rows_of.append((head, *(Cell(text, style="words") for text in words)))
    columns = ("", "predicted minus measured", "why", "what it means for the absorption")
    which = count(len(pairs), "pair") + " not fitted" * (pairs[0].use == "validate")
    caption = f"Where model and measurement disagree audibly, {which}"
    return Table(caption, columns, rows_of, kind="reasons")


def _disagreement(
    answer: Result, scene: Scene, key: str, band: int, off: FloatArray
) -> tuple[str, str, str] | None:
    """Return how far off one parameter is in one band, why, and what follows; None: not far.

    `off` has measured values, errors in JND and the baseline of all pairs, shape (3, n_pairs).
    """
    measured, jnd, baseline = off
    is_decay = key in DECAY_SCATTER
    unit, step = {"%": ("%", 5.0), "dB": ("dB", 1.0), "points": ("points", 5.0)}[
        parameter(key).error_unit
    ]
    if is_decay:
        width_hz = float(answer.bands.upper_hz[band] - answer.bands.lower_hz[band])
        scatter = DECAY_SCATTER[key] / np.sqrt(width_hz * measured) / 0.05
    else:
        known = (measured - baseline)[np.isfinite(baseline)] / step
        scatter = np.full(measured.shape, np.sqrt(np.mean(known**2)) if known.size else np.nan)
    mean, sd = mean_miss(jnd, 0.05 * np.nan_to_num(scatter))
    rms, expected = float(np.sqrt(np.mean(jnd**2))), float(np.sqrt(np.mean(scatter**2)))
    systematic = abs(mean) > max(_AUDIBLE_JND, _BEYOND_SDS * sd)
    if not systematic and rms <= 2.0 * _AUDIBLE_JND:
        return None
    misfit = bool(answer.chi2_reduced[band] > LARGEST_CHI2_REDUCED)
    trust = _MISFIT if misfit else _UNEXPLAINED
    where, decimals = hertz(float(answer.bands.centres_hz[band])), 0 if unit == "%" else 1
    if not systematic:
        size = f"{where}: ±{number(rms * step, decimals)} {unit}"
        if np.isfinite(expected) and rms <= 1.5 * expected:
            size += f" (±{number(expected * step, decimals)} {unit} expected)"
            by = "by interference as much as ISO 3382-2 expects"
            if not is_decay:
                by = "as much about the mean of the others"
            return size, f"single positions scatter {by}", _INTERFERENCE
        return size, _reasons(answer, band, "positions differ more than the model says"), trust
    size = f"{where}: {number(mean * step, decimals, signed=True)} {unit}"
    size += " on average" if jnd.size > 1 else ""
    if not is_decay:
        return size, _reasons(answer, band, _EARLY), trust
    centre_hz = float(answer.bands.centres_hz[band])
    missed = any(
        f.code == Code.DECAY_NOT_REPRODUCED and f.about.in_band(centre_hz) for f in answer.findings
    )
    if answer.models[band : band + 1] == ("coherent",) and not misfit and not missed:
        return size, _PRESSURES, _NOT_THE_WALLS
    meaning = trust if misfit else _needed(answer, scene, band, 0.05 * mean)
    return size, _reasons(answer, band, "no finding explains it"), meaning


# Said of whole bands, in the order in which they explain most.
_EXPLAINING = (
    Code.DECAY_BENT,
    Code.DISPLACEMENT_DETECTED,
    Code.SOURCE_NOT_OMNIDIRECTIONAL,
    Code.SCATTERING_UNDERESTIMATED,
    Code.DECAY_NOT_REPRODUCED,
    Code.BELOW_SCHROEDER_FREQUENCY,
    Code.DECAY_RANGE_TOO_SMALL,
)


def _reasons(answer: Result, band: int, otherwise: str) -> str:
    """Return what findings and the fit say of a band, most telling first."""
    centre_hz = float(answer.bands.centres_hz[band])
    said = {f.code for f in answer.findings if f.about.in_band(centre_hz)}
    found = [REASONS[code] for code in _EXPLAINING if code in said]
    if answer.chi2_reduced[band] > LARGEST_CHI2_REDUCED:
        found.append(f"the model does not explain this band (φ above {LARGEST_CHI2_REDUCED:g})")
    return listing(found[:2] or [otherwise])


def _needed(answer: Result, scene: Scene, band: int, excess: float) -> str:
    """Return which mean absorption would remove a decay that is too long by a share of itself.

    By Sabine's formula with air: the time is inversely proportional to ``alpha S + 4 m V``.
    """
    value, lower, upper = (float(x) for x in answer.mean_absorption[:, band])
    air = 4.0 * float(attenuation_per_m(scene.air, answer.bands)[band])
    air *= volume_m3(scene.room.mesh) / float(np.sum(answer.areas_m2))
    needed = (value + air) * (1.0 + excess) - air
    if not (np.isfinite(needed) and 0.0 <= needed <= 1.0):
        return "No mean absorption between 0 and 1 would remove it: look at the description."
    verdict = "inside the interval: the intervals hold."
    if not lower <= needed <= upper:
        verdict = "outside the interval: early and late sound ask for different absorption: do not "
        verdict += "use it for decay times."
    return (
        f"At {hertz(float(answer.bands.centres_hz[band]))} a mean absorption of "
        f"{coefficient(needed, 1.0)} instead of {coefficient(value, 1.0)} would remove it, "
        f"{verdict}"
    )
