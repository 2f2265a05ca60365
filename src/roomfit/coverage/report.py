"""A calibration in words and tables.

What `roomfit coverage` leaves beside its replicates: JSON, table, picture.

A calibration in a picture: what intervals of every level hold, and those of 95 % by band.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from roomfit.cache import write_bytes_atomically, write_json_atomically, write_text_atomically
from roomfit.coverage.calibrate import CoverageResult, estimate_coverage
from roomfit.coverage.statistics import (
    CoverageRow,
    CoverageSample,
    Proportion,
    coverage_at,
    coverage_rows,
)
from roomfit.coverage.truth import CoverageSettings
from roomfit.findings import Code
from roomfit.io.campaign import read_campaign
from roomfit.io.encoding import number_or_null
from roomfit.report.figures import OKABE_ITO, new_figure
from roomfit.typing import Progress

_NOMINAL = np.concatenate((np.linspace(0.05, 0.95, 19), [0.98, 0.99]))


def coverage_figure(found: CoverageSample) -> Figure:
    """Return coverage over nominal level, and coverage and false certainty of every band."""
    figure = new_figure(9.6, 4.8)
    left, right = figure.subplots(1, 2)
    _levels(left, coverage_at(found, _NOMINAL))
    _bands(right, coverage_rows(found)[:-1])
    n = len(found.true)
    figure.suptitle(f"{n} replicate{'' if n == 1 else 's'} with a known truth", fontsize=10)
    return figure


def _levels(axes: Axes, proportions: tuple[Proportion, ...]) -> None:
    percent = 100.0 * _NOMINAL
    axes.plot([0, 100], [0, 100], color="black", lw=1.0, ls="--", label="as promised")
    if proportions[0].of:
        low, high = (
            100.0 * np.array([getattr(s, n) for s in proportions]) for n in ("low", "high")
        )
        axes.fill_between(
            *(percent, low, high), color=OKABE_ITO[0], alpha=0.25, lw=0.0, label="range of chance"
        )
        values = [100.0 * s.value for s in proportions]
        axes.plot(percent, values, "o-", color=OKABE_ITO[0], ms=3.5, lw=1.4, label="found")
    axes.set_xlabel("level of the interval (%)")
    axes.set_ylabel("intervals that hold the truth (%)")
    axes.set_xlim(0, 100)
    axes.set_ylim(0, 101)
    axes.grid(alpha=0.25)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False, fontsize=8.5)


def _bands(axes: Axes, rows: tuple[CoverageRow, ...]) -> None:
    positions = np.arange(len(rows))
    axes.axhspan(90, 98, color="0.9", lw=0.0, zorder=0)
    axes.axhspan(0, 5, color="0.9", lw=0.0, zorder=0, label="aimed at")
    marks = (
        ([r.holds for r in rows], "o", OKABE_ITO[0], -0.08, "95 % intervals that hold"),
        ([r.outside for r in rows], "s", OKABE_ITO[1], 0.08, "identifiable but outside"),
    )
    for proportions, mark, colour, shift, label in marks:
        known = [i for i, s in enumerate(proportions) if s.of]
        value = np.array([100.0 * proportions[i].value for i in known])
        low, high = (
            np.array([100.0 * getattr(proportions[i], n) for i in known]) for n in ("low", "high")
        )
        axes.errorbar(
            positions[known] + shift,
            value,
            yerr=np.abs(np.array([value - low, high - value])),
            fmt=mark,
            color=colour,
            ms=5,
            capsize=2.5,
            lw=1.2,
            label=label,
        )
    axes.set_xticks(positions, [f"{r.band_hz:g}" for r in rows])
    if len(rows) > 10:
        axes.tick_params(axis="x", labelrotation=90)
    axes.set_xlabel("band (Hz)")
    axes.set_ylabel("share of values (%)")
    axes.set_xlim(-0.5, len(rows) - 0.5)
    axes.set_ylim(-2, 102)
    axes.grid(alpha=0.25, axis="y")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False, fontsize=8.5)


PROMISED = 0.95
_TOLERATED_WRONG = 0.05
CSV_HEAD = (
    *("band_hz", "values", "hold", "hold_low", "hold_high"),
    *("identifiable", "identifiable_wrong", "wrong_low", "wrong_high"),
    *("median_width", "median_error", "median_error_prior", "median_error_uniform"),
)


def coverage_table(rows: Sequence[CoverageRow]) -> str:
    """Return the table for a terminal; shares in percent, with their own 95 % intervals."""
    lines = [
        "             95 % intervals      called           of these        median    "
        "median |error|",
        "   band      hold the truth   identifiable     outside theirs     width    "
        "answer  prior  uniform",
    ]
    for row in rows:
        name = "all" if row.band_hz is None else f"{row.band_hz:g} Hz"
        lines.append(
            f"{name:>8}  {_fraction(row.holds):>18}  {_percent(row.identifiable):>10}  "
            f"{_fraction(row.outside):>18}  {_short(row.width):>8}  {_short(row.error):>8} "
            f"{_short(row.error_prior):>6}  {_short(row.error_uniform):>6}"
        )
    return "\n".join(lines)


def verdict(row: CoverageRow) -> str:
    """Return in words whether the intervals of all bands together hold what they promise."""
    if not row.holds.of:
        return "No absorption was fitted: nothing can be said of intervals."
    share = f"{100 * row.holds.value:.0f} % of 95 % intervals hold the truth"
    if row.holds.low <= PROMISED <= row.holds.high:
        first = f"{share}, which so many replicates cannot tell from 95 %."
    elif row.holds.value < PROMISED:
        first = f"{share}: they are too narrow for this campaign. Do not rely on them."
    else:
        first = f"{share}: they are wider than they need be for this campaign."
    if not row.outside.of:
        return f"{first} Nothing is called identifiable."
    second = f"Of what is called identifiable {100 * row.outside.value:.0f} % lies outside"
    if row.outside.low > _TOLERATED_WRONG:
        return f"{first} {second}: more than the 5 % that 95 % intervals leave."
    return f"{first} {second}."


def coverage_text(
    rows: Sequence[CoverageRow],
    done: int,
    asked: int,
    syntheses: Mapping[str, int],
    findings: Mapping[Code, int],
    refused: Sequence[str],
) -> str:
    """Return everything a user must see."""
    lines = [f"{done} of {asked} replicates; made by " + _counts(syntheses.items())]
    if done < asked:
        lines.append("The calibration is not complete: run it again, or the other slices.")
    lines += ["", coverage_table(rows), "", verdict(rows[-1])]
    if findings:
        lines.append("Findings: " + _counts(findings.items()))
    if refused:
        lines.append(_refusals(refused))
    return "\n".join(lines)


def _refusals(refused: Sequence[str]) -> str:
    """Return how many replicates got no answer, and what the first was refused for."""
    what, *more = refused[0].splitlines()
    # where it was, a folder that is gone, says nothing
    found = [line.split(maxsplit=1)[1] for line in more if line.split()[:1] == ["found"]]
    number = "1 replicate was" if len(refused) == 1 else f"{len(refused)} replicates were"
    return f"{number} refused; the first: {what}" + "".join(f" ({f})" for f in found)


def coverage_csv(rows: Sequence[CoverageRow]) -> str:
    """Return the table as CSV; empty cells where nothing can be counted."""
    lines = [",".join(CSV_HEAD)]
    for row in rows:
        numbers = (
            *(row.holds.value, row.holds.low, row.holds.high),
            *(row.identifiable.value, row.outside.value, row.outside.low, row.outside.high),
            *(row.width, row.error, row.error_prior, row.error_uniform),
        )
        band = "all" if row.band_hz is None else f"{row.band_hz:g}"
        cells = ["" if math.isnan(x) else f"{x:.4f}" for x in numbers]
        lines.append(",".join((band, str(row.holds.of), *cells)))
    return "\n".join(lines) + "\n"


def _counts(counted: Iterable[tuple[str, int]]) -> str:
    return ", ".join(f"{name} ({n})" for name, n in counted)


def _fraction(proportion: Proportion) -> str:
    if not proportion.of:
        return "-"
    return (
        f"{100 * proportion.value:.0f} ({100 * proportion.low:.0f}-{100 * proportion.high:.0f}) %"
    )


def _percent(proportion: Proportion) -> str:
    return f"{100 * proportion.value:.0f} %" if proportion.of else "-"


def _short(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3f}"


def estimate_coverage_to_folder(
    campaign_file: Path,
    out: Path,
    settings: CoverageSettings | None = None,
    *,
    progress: Progress | None = None,
) -> CoverageResult:
    """Calibrate a campaign and write calibration.json, calibration.csv and calibration.png.

    They tell of all replicates in the folder, whichever run has made them.

    Raises
    ------
    InputError, CannotTell, StoreError
        See `calibrate`.
    """
    from roomfit.report.figures import png

    result = estimate_coverage(read_campaign(campaign_file), out, settings, progress=progress)
    write_text_atomically(out / "calibration.csv", coverage_csv(coverage_rows(result.found)))
    write_bytes_atomically(out / "calibration.png", png(coverage_figure(result.found)))
    write_json_atomically(out / "calibration.json", coverage_json(result))
    return result


def result_text(result: CoverageResult) -> str:
    """Return everything a user must see."""
    return coverage_text(
        coverage_rows(result.found),
        result.done,
        result.requested,
        result.syntheses,
        result.findings,
        result.refused,
    )


def coverage_json(result: CoverageResult) -> dict[str, Any]:
    """Return the content of calibration.json."""
    *bands, together = coverage_rows(result.found)
    return {
        "format": "roomfit-calibration",
        "format_version": 1,
        "replicates": {
            "asked": result.requested,
            "done": result.done,
            "refused": list(result.refused),
        },
        "drawn_from": result.drawn_from,
        "made_by": result.syntheses,
        "materials": list(result.found.materials),
        "bands": [_row(row) for row in bands],
        "all": _row(together),
        "findings": result.findings,
    }


def _row(row: CoverageRow) -> dict[str, Any]:
    band_entry = {} if row.band_hz is None else {"band_hz": row.band_hz}
    return {
        **band_entry,
        "hold": _proportion(row.holds),
        "identifiable": _proportion(row.identifiable),
        "identifiable_wrong": _proportion(row.outside),
        "median_width": number_or_null(row.width),
        "median_error": number_or_null(row.error),
        "median_error_prior": number_or_null(row.error_prior),
        "median_error_uniform": number_or_null(row.error_uniform),
    }


def _proportion(proportion: Proportion) -> dict[str, Any]:
    return {
        "count": proportion.count,
        "of": proportion.of,
        "share": number_or_null(proportion.value),
        "lower95": proportion.low,
        "upper95": proportion.high,
    }
