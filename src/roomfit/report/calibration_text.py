"""A calibration in words and tables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from roomfit.uncertainty.calibration import CalibrationRow, Share

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
    findings: Mapping[str, int],
    refused: Sequence[str],
) -> str:
    """Return everything a user must see."""
    lines = [f"{done} of {asked} replicates; made by " + _counts(roads)]
    if done < asked:
        lines.append("The calibration is not complete: run it again, or the other slices.")
    lines += ["", calibration_table(rows), "", verdict(rows[-1])]
    if findings:
        lines.append("Findings: " + _counts(findings))
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


def _counts(counted: Mapping[str, int]) -> str:
    return ", ".join(f"{name} ({n})" for name, n in counted.items())


def _told(share: Share) -> str:
    if not share.of:
        return "-"
    return f"{100 * share.value:.0f} ({100 * share.low:.0f}-{100 * share.high:.0f}) %"


def _percent(share: Share) -> str:
    return f"{100 * share.value:.0f} %" if share.of else "-"


def _short(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3f}"
