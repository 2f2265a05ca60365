"""Where predicted room parameters differ from measured ones: why, and what that means for walls."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roomfit.base.air import attenuation_per_m
from roomfit.base.findings import Code
from roomfit.base.table import Cell, Table
from roomfit.base.typing import FloatArray
from roomfit.checks.decay import DECAY_SCATTER, mean_miss
from roomfit.report.tables import parameter_keys
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
from roomfit.result import ComparedPair, Result
from roomfit.room.mesh import volume_m3
from roomfit.room.scene import Scene
from roomfit.uncertainty.gaussian import LARGEST_CHI2_REDUCED

_AUDIBLE_JND, _BEYOND_SDS = 1.0, 2.0
# Said of whole bands, in the order in which they explain most.
_REASONS = {
    Code.DECAY_BENT: "the files contain a bent decay",
    Code.DISPLACEMENT_DETECTED: "positions or walls are not where they were specified",
    Code.SOURCE_NOT_OMNIDIRECTIONAL: "a source is directional and was taken for omnidirectional",
    Code.SCATTERING_UNDERESTIMATED: "walls scatter more than was specified",
    Code.DECAY_NOT_REPRODUCED: "the fitted decay is not that of the measurement, see the finding",
    Code.BELOW_SCHROEDER_FREQUENCY: "single modes are resolved, which the model does not contain",
    Code.DECAY_RANGE_TOO_SMALL: "noise leaves little of the decay",
}


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
    kept = [pair for pair in answer.pairs if pair.use == "validate"]
    pairs = kept or list(answer.pairs)
    known = parameter_keys(pairs)
    early = next((key for key in ("C80_dB", "C50_dB", "D50_percent") if key in known), None)
    groups: dict[tuple[str, str, str], list[int]] = {}
    sizes: dict[tuple[str, str, str], list[str]] = {}
    for key in filter(None, (decay_time_key(known), early)):
        for band in range(len(answer.bands)):
            said = _band(answer, scene, pairs, key, band)
            if said is not None:
                size, why, meaning = said
                groups.setdefault((key, why, meaning), []).append(band)
                sizes.setdefault((key, why, meaning), []).append(size)
    if not groups:
        return None
    centres = answer.bands.centres_hz
    rows = []
    for (key, why, meaning), bands in groups.items():
        where = band_ranges(centres, np.isin(np.arange(len(centres)), bands))
        words = ("; ".join(sizes[key, why, meaning]), why, meaning)
        head = f"{parameter(key).symbol}, {where}"
        rows.append((head, *(Cell(text, style="words") for text in words)))
    columns = ("", "predicted minus measured", "why", "what it means for the absorption")
    which = count(len(pairs), "pair") + (" not fitted" if kept else "")
    caption = f"Where model and measurement disagree audibly, {which}"
    return Table(caption, columns, rows, kind="reasons")


def _band(
    answer: Result, scene: Scene, pairs: Sequence[ComparedPair], key: str, band: int
) -> tuple[str, str, str] | None:
    """Return how far off one parameter is in one band, why, and what follows; None: not far."""
    both = [
        (c.measured[band], c.jnd[band], c.null[band])
        for c in (pair.parameters[key] for pair in pairs if key in pair.parameters)
    ]
    measured, jnd, baseline = np.array(both, dtype=np.float64).reshape(-1, 3).T
    off = np.isfinite(measured) & np.isfinite(jnd)
    if not off.any():
        return None
    measured, jnd, baseline = measured[off], jnd[off], baseline[off]
    scatter = _scatter_jnd(answer, key, band, measured, baseline)
    mean, sd = mean_miss(jnd, 0.05 * np.nan_to_num(scatter))
    rms = float(np.sqrt(np.mean(jnd**2)))
    systematic = abs(mean) > max(_AUDIBLE_JND, _BEYOND_SDS * sd)
    if not systematic and rms <= 2.0 * _AUDIBLE_JND:
        return None
    where = hertz(float(answer.bands.centres_hz[band]))
    unit = {"%": ("%", 5.0), "dB": ("dB", 1.0), "points": ("points", 5.0)}
    words, step = unit[parameter(key).error_unit]
    decimals = 0 if words == "%" else 1
    expected = float(np.sqrt(np.mean(scatter**2)))
    if not systematic:
        size = f"{where}: ±{number(rms * step, decimals)} {words}"
        if np.isfinite(expected) and rms <= 1.5 * expected:
            return (
                f"{size} (±{number(expected * step, decimals)} {words} expected)",
                "single positions scatter by interference as much as ISO 3382-2 expects"
                if key in DECAY_SCATTER
                else "single positions scatter as much about the mean of the others",
                "None: energies that add predict the mean over positions, and absorption is "
                "fitted to all windows together.",
            )
        return (
            size,
            _reasons(answer, band, ["positions differ more than the model says"]),
            _trust(answer, band),
        )
    size = f"{where}: {number(mean * step, decimals, signed=True)} {words}"
    size += " on average" if jnd.size > 1 else ""
    if key not in DECAY_SCATTER:
        doubt = "early reflections, directivity or scattering are not as the model has them"
        return size, _reasons(answer, band, [doubt]), _trust(answer, band)
    if _by_pressures(answer, band):
        added = answer.by_pressures is not None and bool(answer.by_pressures[band])
        until = "the last of the decay" if added else "the prediction"
        return (
            size,
            f"{until} adds energies, the fit added pressures: between smooth, parallel walls these "
            "decay differently",
            "None by itself: the fitted windows agree, and no check found their decay missed. "
            "Predicted decay times of this room are off by as much.",
        )
    return (
        size,
        _reasons(answer, band, ["no finding explains it"]),
        _needed(answer, scene, band, 0.05 * mean),
    )


def _scatter_jnd(
    answer: Result, key: str, band: int, measured: FloatArray, baseline: FloatArray
) -> FloatArray:
    """Return how much each pair's value is expected to scatter, in JND, shape (n_pairs,)."""
    if key in DECAY_SCATTER:
        bandwidth_hz = float(answer.bands.upper_hz[band] - answer.bands.lower_hz[band])
        return np.asarray(DECAY_SCATTER[key] / np.sqrt(bandwidth_hz * measured) / 0.05)
    step = 5.0 if parameter(key).error_unit == "points" else 1.0
    known = np.isfinite(baseline)
    spread = float(np.sqrt(np.mean((measured - baseline)[known] ** 2))) if known.any() else np.nan
    return np.full(measured.shape, spread / step)


def _reasons(answer: Result, band: int, otherwise: list[str]) -> str:
    """Return what findings and the fit say of a band, most telling first."""
    centre = float(answer.bands.centres_hz[band])
    said = {f.code for f in answer.findings if f.about.in_band(centre)}
    found = [words for code, words in _REASONS.items() if code in said]
    chi2 = float(answer.chi2_reduced[band])
    if chi2 > LARGEST_CHI2_REDUCED:
        found.append(f"the model does not explain this band (φ above {LARGEST_CHI2_REDUCED:g})")
    return listing(found[:2] or otherwise)


def _by_pressures(answer: Result, band: int) -> bool:
    """Return whether pressures were fitted, and reproduce the decay as far as was checked."""
    centre = float(answer.bands.centres_hz[band])
    return (
        len(answer.models) > band
        and answer.models[band] == "coherent"
        and bool(answer.chi2_reduced[band] <= LARGEST_CHI2_REDUCED)
        and not any(
            f.code == Code.DECAY_NOT_REPRODUCED and f.about.in_band(centre) for f in answer.findings
        )
    )


def _trust(answer: Result, band: int) -> str:
    if answer.chi2_reduced[band] > LARGEST_CHI2_REDUCED:
        return "Not to be used: intervals are widened by the misfit, nothing is identifiable."
    return (
        "Little: the windows that were fitted agree within their errors (φ up to "
        f"{LARGEST_CHI2_REDUCED:g}); predictions of single positions are as uncertain as this."
    )


def _needed(answer: Result, scene: Scene, band: int, excess: float) -> str:
    """Return which mean absorption would remove a decay that is too long by a share of itself.

    By Sabine's formula with air: the time is inversely proportional to ``alpha S + 4 m V``.
    """
    if answer.chi2_reduced[band] > LARGEST_CHI2_REDUCED:
        return _trust(answer, band)
    value, lower, upper = (float(x) for x in answer.mean_absorption[:, band])
    air = 4.0 * float(attenuation_per_m(scene.air, answer.bands)[band])
    air *= volume_m3(scene.room.mesh) / float(np.sum(answer.areas_m2))
    needed = (value + air) * (1.0 + excess) - air
    if not (np.isfinite(needed) and 0.0 <= needed <= 1.0):
        return "No mean absorption between 0 and 1 would remove it: look at the description."
    within = "inside" if lower <= needed <= upper else "outside"
    verdict = (
        "the intervals hold."
        if within == "inside"
        else "early and late sound ask for different absorption: do not use it for decay times."
    )
    return (
        f"At {hertz(float(answer.bands.centres_hz[band]))} a mean absorption of "
        f"{coefficient(needed, 1.0)} instead of {coefficient(value, 1.0)} would remove it, "
        f"{within} the interval: {verdict}"
    )
