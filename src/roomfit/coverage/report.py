"""A calibration in words and tables.

What `roomfit calibrate` leaves beside its replicates: JSON, table, picture.

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
from roomfit.coverage.calibrate import CalibrationResult, calibrate
from roomfit.coverage.statistics import (
    Calibration,
    CalibrationRow,
    Share,
    calibration_rows,
    coverage_at,
)
from roomfit.coverage.truth import CalibrationSettings
from roomfit.findings import Code
from roomfit.io.campaign import read_campaign
from roomfit.report.figures import OKABE_ITO, new_figure
from roomfit.typing import Progress

_NOMINAL = np.concatenate((np.linspace(0.05, 0.95, 19), [0.98, 0.99]))


def calibration_figure(found: Calibration) -> Figure:
    """Return coverage over nominal level, and coverage and false certainty of every band."""
    figure = new_figure(9.6, 4.8)
    left, right = figure.subplots(1, 2)
    _levels(left, coverage_at(found, _NOMINAL))
    _bands(right, calibration_rows(found)[:-1])
    n = len(found.true)
    figure.suptitle(f"{n} replicate{'' if n == 1 else 's'} with a known truth", fontsize=10)
    return figure


def _levels(axes: Axes, shares: tuple[Share, ...]) -> None:
    percent = 100.0 * _NOMINAL
    axes.plot([0, 100], [0, 100], color="black", lw=1.0, ls="--", label="as promised")
    if shares[0].of:
        low, high = (100.0 * np.array([getattr(s, n) for s in shares]) for n in ("low", "high"))
        axes.fill_between(
            *(percent, low, high), color=OKABE_ITO[0], alpha=0.25, lw=0.0, label="range of chance"
        )
        values = [100.0 * s.value for s in shares]
        axes.plot(percent, values, "o-", color=OKABE_ITO[0], ms=3.5, lw=1.4, label="found")
    axes.set_xlabel("level of the interval (%)")
    axes.set_ylabel("intervals that hold the truth (%)")
    axes.set_xlim(0, 100)
    axes.set_ylim(0, 101)
    axes.grid(alpha=0.25)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False, fontsize=8.5)


def _bands(axes: Axes, rows: tuple[CalibrationRow, ...]) -> None:
    places = np.arange(len(rows))
    axes.axhspan(90, 98, color="0.9", lw=0.0, zorder=0)
    axes.axhspan(0, 5, color="0.9", lw=0.0, zorder=0, label="aimed at")
    marks = (
        ([r.holds for r in rows], "o", OKABE_ITO[0], -0.08, "95 % intervals that hold"),
        ([r.wrong for r in rows], "s", OKABE_ITO[1], 0.08, "identifiable but outside"),
    )
    for shares, mark, colour, shift, label in marks:
        known = [i for i, s in enumerate(shares) if s.of]
        value = np.array([100.0 * shares[i].value for i in known])
        low, high = (
            np.array([100.0 * getattr(shares[i], n) for i in known]) for n in ("low", "high")
        )
        axes.errorbar(
            places[known] + shift,
            value,
            yerr=np.abs(np.array([value - low, high - value])),
            fmt=mark,
            color=colour,
            ms=5,
            capsize=2.5,
            lw=1.2,
            label=label,
        )
    axes.set_xticks(places, [f"{r.band_hz:g}" for r in rows])
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


def calibration_table(rows: Sequence[CalibrationRow]) -> str:
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
            f"{name:>8}  {_told(row.holds):>18}  {_percent(row.identifiable):>10}  "
            f"{_told(row.wrong):>18}  {_short(row.width):>8}  {_short(row.error):>8} "
            f"{_short(row.error_prior):>6}  {_short(row.error_uniform):>6}"
        )
    return "\n".join(lines)


def verdict(row: CalibrationRow) -> str:
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
    if not row.wrong.of:
        return f"{first} Nothing is called identifiable."
    second = f"Of what is called identifiable {100 * row.wrong.value:.0f} % lies outside"
    if row.wrong.low > _TOLERATED_WRONG:
        return f"{first} {second}: more than the 5 % that 95 % intervals leave."
    return f"{first} {second}."


def calibration_text(
    rows: Sequence[CalibrationRow],
    done: int,
    asked: int,
    roads: Mapping[str, int],
    findings: Mapping[Code, int],
    refused: Sequence[str],
) -> str:
    """Return everything a user must see."""
    lines = [f"{done} of {asked} replicates; made by " + _counts(roads.items())]
    if done < asked:
        lines.append("The calibration is not complete: run it again, or the other slices.")
    lines += ["", calibration_table(rows), "", verdict(rows[-1])]
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


def calibration_csv(rows: Sequence[CalibrationRow]) -> str:
    """Return the table as CSV; empty cells where nothing can be counted."""
    lines = [",".join(CSV_HEAD)]
    for row in rows:
        numbers = (
            *(row.holds.value, row.holds.low, row.holds.high),
            *(row.identifiable.value, row.wrong.value, row.wrong.low, row.wrong.high),
            *(row.width, row.error, row.error_prior, row.error_uniform),
        )
        band = "all" if row.band_hz is None else f"{row.band_hz:g}"
        cells = ["" if math.isnan(x) else f"{x:.4f}" for x in numbers]
        lines.append(",".join((band, str(row.holds.of), *cells)))
    return "\n".join(lines) + "\n"


def _counts(counted: Iterable[tuple[str, int]]) -> str:
    return ", ".join(f"{name} ({n})" for name, n in counted)


def _told(share: Share) -> str:
    if not share.of:
        return "-"
    return f"{100 * share.value:.0f} ({100 * share.low:.0f}-{100 * share.high:.0f}) %"


def _percent(share: Share) -> str:
    return f"{100 * share.value:.0f} %" if share.of else "-"


def _short(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3f}"


def calibrate_to_folder(
    campaign_file: Path,
    out: Path,
    settings: CalibrationSettings | None = None,
    *,
    progress: Progress | None = None,
) -> CalibrationResult:
    """Calibrate a campaign and write calibration.json, calibration.csv and calibration.png.

    They tell of all replicates in the folder, whichever run has made them.

    Raises
    ------
    InputError, CannotTell, StoreError
        See `calibrate`.
    """
    from roomfit.report.figures import png

    result = calibrate(read_campaign(campaign_file), out, settings, progress=progress)
    write_text_atomically(out / "calibration.csv", calibration_csv(calibration_rows(result.found)))
    write_bytes_atomically(out / "calibration.png", png(calibration_figure(result.found)))
    write_json_atomically(out / "calibration.json", calibration_json(result))
    return result


def result_text(result: CalibrationResult) -> str:
    """Return everything a user must see."""
    return calibration_text(
        calibration_rows(result.found),
        result.done,
        result.asked,
        result.roads,
        result.findings,
        result.refused,
    )


def calibration_json(result: CalibrationResult) -> dict[str, Any]:
    """Return the content of calibration.json."""
    *bands, together = calibration_rows(result.found)
    return {
        "format": "roomfit-calibration",
        "format_version": 1,
        "replicates": {
            "asked": result.asked,
            "done": result.done,
            "refused": list(result.refused),
        },
        "drawn_from": result.drawn_from,
        "made_by": result.roads,
        "materials": list(result.found.materials),
        "bands": [_row(row) for row in bands],
        "all": _row(together),
        "findings": result.findings,
    }


def _row(row: CalibrationRow) -> dict[str, Any]:
    told = {} if row.band_hz is None else {"band_hz": row.band_hz}
    return {
        **told,
        "hold": _share(row.holds),
        "identifiable": _share(row.identifiable),
        "identifiable_wrong": _share(row.wrong),
        "median_width": _number(row.width),
        "median_error": _number(row.error),
        "median_error_prior": _number(row.error_prior),
        "median_error_uniform": _number(row.error_uniform),
    }


def _share(share: Share) -> dict[str, Any]:
    return {
        "count": share.count,
        "of": share.of,
        "share": _number(share.value),
        "lower95": share.low,
        "upper95": share.high,
    }


def _number(value: float) -> float | None:
    return None if math.isnan(value) else value
