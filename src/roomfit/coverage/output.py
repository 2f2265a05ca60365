"""An estimate of coverage as coverage.json, coverage.csv, text, and a figure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from roomfit.base.table import Column, Table, html_of, text_of
from roomfit.coverage.statistics import (
    CoverageRow,
    CoverageSample,
    Proportion,
    coverage_at,
    coverage_rows,
)
from roomfit.files.encoding import number_or_null
from roomfit.report.figures import OKABE_ITO, new_figure

if TYPE_CHECKING:
    from roomfit.coverage.estimate import CoverageResult

_NOMINAL = np.concatenate((np.linspace(0.05, 0.95, 19), [0.98, 0.99]))


def coverage_figure(found: CoverageSample) -> Figure:
    """Return coverage over the nominal level, and in every band, with what is wrongly certain."""
    figure = new_figure(9.6, 4.8)
    left, right = figure.subplots(1, 2)
    _levels(left, coverage_at(found, _NOMINAL))
    _bands(right, coverage_rows(found)[:-1])
    n = len(found.true)
    figure.suptitle(f"{n} replicate{'' if n == 1 else 's'} of known absorption", fontsize=10)
    return figure


def _levels(axes: Axes, proportions: tuple[Proportion, ...]) -> None:
    percent = 100.0 * _NOMINAL
    axes.plot([0, 100], [0, 100], color="black", lw=1.0, ls="--", label="nominal")
    if proportions[0].of:
        low, high, values = 100.0 * np.array([[s.low, s.high, s.value] for s in proportions]).T
        axes.fill_between(
            percent, low, high, color=OKABE_ITO[0], alpha=0.25, lw=0.0, label="range of chance"
        )
        axes.plot(percent, values, "o-", color=OKABE_ITO[0], ms=3.5, lw=1.4, label="found")
    axes.set_xlabel("level of the interval (%)")
    axes.set_ylabel("intervals that hold the true value (%)")
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
    style: dict[str, Any] = {"ms": 5, "capsize": 2.5, "lw": 1.2}
    for proportions, mark, colour, shift, label in marks:
        known = [i for i, s in enumerate(proportions) if s.of]
        table = [[p.value, p.low, p.high] for p in (proportions[i] for i in known)]
        value, low, high = 100.0 * np.array(table).reshape(-1, 3).T
        reach = np.abs(np.array([value - low, high - value]))
        axes.errorbar(
            positions[known] + shift, value, reach, fmt=mark, color=colour, label=label, **style
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


_NOMINAL_COVERAGE = 0.95
_TOLERATED_WRONG = 0.05
_HEADINGS = (
    *("band", "95 % intervals\nhold true value", "called\nidentifiable"),
    *("of these\noutside theirs", "median\nwidth"),
    *("median |error|\nof the answer", "of the\nprior", "of a uniform\nabsorption"),
)


def coverage_table(rows: Sequence[CoverageRow], caption: str = "") -> Table:
    """Return the table for readers; shares in percent, with their own 95 % intervals."""
    shown = []
    for row in rows:
        band = "all" if row.band_hz is None else f"{row.band_hz:g} Hz"
        identifiable = f"{100 * row.identifiable.value:.0f} %" if row.identifiable.of else "-"
        shares = (_fraction(row.holds), identifiable, _fraction(row.outside))
        errors = (row.width, row.error, row.error_prior, row.error_uniform)
        shown.append((band, *shares, *errors))
    return Table(caption, _HEADINGS, shown, form=".3f")


def verdict(row: CoverageRow) -> str:
    """Return in words whether the intervals of all bands together have their nominal coverage."""
    if not row.holds.of:
        return "No absorption was fitted: nothing can be said of intervals."
    share = f"{100 * row.holds.value:.0f} % of 95 % intervals hold the true value"
    if row.holds.low <= _NOMINAL_COVERAGE <= row.holds.high:
        first = f"{share}, which so many replicates cannot distinguish from 95 %."
    elif row.holds.value < _NOMINAL_COVERAGE:
        first = f"{share}: they are too narrow for this campaign. Do not rely on them."
    else:
        first = f"{share}: they are wider than they need be for this campaign."
    if not row.outside.of:
        return f"{first} Nothing is called identifiable."
    second = f"Of what is called identifiable {100 * row.outside.value:.0f} % lies outside"
    if row.outside.low > _TOLERATED_WRONG:
        return f"{first} {second}: more than the 5 % that 95 % intervals leave."
    return f"{first} {second}."


def coverage_text(result: CoverageResult) -> str:
    """Return the table, what it means, and what was doubtful or refused."""
    rows = coverage_rows(result.found)
    lines = [
        f"{result.done} of {result.requested} replicates; simulated by "
        + _counts(result.syntheses.items())
    ]
    if result.done < result.requested:
        lines.append("The estimate is not complete: run it again, or the other slices.")
    lines += ["", text_of(coverage_table(rows)), "", verdict(rows[-1])]
    if result.findings:
        lines.append("Findings: " + _counts(result.findings.items()))
    if result.refused:
        lines.append(_refusals(result.refused))
    return "\n".join(lines)


def coverage_html(result: CoverageResult) -> str:
    """Return the table and what it means in HTML."""
    rows = coverage_rows(result.found)
    caption = f"{result.done} of {result.requested} replicates"
    return html_of(coverage_table(rows, caption)) + f"<p>{escape(verdict(rows[-1]))}</p>"


def _refusals(refused: Sequence[str]) -> str:
    """Return how many replicates got no answer, and what the first was refused for."""
    what, *more = refused[0].splitlines()
    # where it was, a folder that is gone, says nothing
    found = [line.split(maxsplit=1)[1] for line in more if line.split()[:1] == ["found"]]
    number = "1 replicate was" if len(refused) == 1 else f"{len(refused)} replicates were"
    return f"{number} refused; the first: {what}" + "".join(f" ({f})" for f in found)


def coverage_records(result: CoverageResult) -> Table:
    """Return the content of coverage.csv: one row a band, then all of them."""
    columns = (
        *(Column("band_hz", "g"), "values", "hold", "hold_low", "hold_high"),
        *("identifiable", "identifiable_wrong", "wrong_low", "wrong_high"),
        *("median_width", "median_error", "median_error_prior", "median_error_uniform"),
    )
    rows = []
    for row in coverage_rows(result.found):
        holds, outside = row.holds, row.outside
        rows.append(
            (
                *("all" if row.band_hz is None else row.band_hz, holds.of),
                *(holds.value, holds.low, holds.high),
                *(row.identifiable.value, outside.value, outside.low, outside.high),
                *(row.width, row.error, row.error_prior, row.error_uniform),
            )
        )
    return Table("", columns, rows, form=".4f")


def _counts(counted: Iterable[tuple[str, int]]) -> str:
    return ", ".join(f"{name} ({n})" for name, n in counted)


def _fraction(proportion: Proportion) -> str:
    if not proportion.of:
        return "-"
    return (
        f"{100 * proportion.value:.0f} ({100 * proportion.low:.0f}-{100 * proportion.high:.0f}) %"
    )


def coverage_json(result: CoverageResult) -> dict[str, Any]:
    """Return the content of coverage.json."""
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
