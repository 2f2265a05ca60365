"""ISO 3382 values from a table of comma-separated values."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import numpy as np

from roomfit.base.arguments import did_you_mean
from roomfit.base.errors import InputError, located
from roomfit.base.findings import Finding
from roomfit.base.typing import FloatArray
from roomfit.files.tables import number_in, table_rows
from roomfit.signals.iso3382 import (
    MeasuredValues,
    ValueName,
    check_possible,
    contradiction_findings,
    joined_values,
)

NAMES: dict[str, ValueName] = {
    "T20": "T20_s",
    "T30": "T30_s",
    "EDT": "EDT_s",
    "C50": "C50_dB",
    "C80": "C80_dB",
    "D50": "D50_percent",
    "TS": "TS_ms",
    "G": "G_dB",
}
_SPREAD = "_sd"
_HEAD = "source,receiver,parameter,125,250,..."
# One line: a parameter, whether it is the spread of one, and its values by band, NaN for none.
_Row = tuple[ValueName, bool, FloatArray]


def read_parameters(
    path: Path, source: str | None = None, receiver: str | None = None
) -> tuple[tuple[MeasuredValues, ...], tuple[Finding, ...]]:
    """Read measured room parameters.

    The first line is ``source,receiver,parameter,125,250,...`` with nominal centres in Hz. Each
    further line holds one parameter of one pair: T20, T30, EDT in s, C50, C80, G in dB, D50 in
    percent, TS in ms; T20_sd and the like hold the standard deviation. Empty cells are unknown.
    Lines that begin with # are left out. Semicolons or tabs may stand for commas, and decimals then
    have commas; or it is an Excel workbook.

    Parameters
    ----------
    path : Path
    source, receiver : str, optional
        Only the lines of this source, of this receiver.

    Returns
    -------
    values : tuple of MeasuredValues
        One a pair, in the order in which the pairs first occur. A pair whose lines occur more than
        once is joined, see `roomfit.signals.iso3382.joined_values`.
    findings : tuple of Finding
        `Code.ROOM_PARAMETERS_INCONSISTENT`, `Code.REPEATED_VALUES_DIFFER`.

    Raises
    ------
    InputError
        No such file, a line that is not understood, a value that no room has, values that
        contradict each other, or no line of the asked pair.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "measured.csv"
    ...     _ = file.write_text("source,receiver,parameter,500,1000\\nS,R,T30,0.9,0.8\\n")
    ...     (values,), findings = read_parameters(file)
    >>> values.source, values.values["T30_s"]
    ('S', array([0.9, 0.8]))
    """
    path = Path(path)
    with located(hint="correct the table there"):
        centres_hz, rows = _rows_by_pair(path)
    chosen = [pair for pair in rows if source in (None, pair[0]) and receiver in (None, pair[1])]
    if not chosen:
        raise InputError(
            "the table of room parameters has no line of this pair",
            where=str(path),
            found=", ".join(" to ".join(pair) for pair in rows),
            needed=f"source {source or 'any'}, receiver {receiver or 'any'}",
            hint="write source and receiver as the table has them, or add the line",
        )
    found: list[MeasuredValues] = []
    findings: list[Finding] = []
    for pair in chosen:
        values, doubts = _pair(pair, rows[pair], centres_hz, str(path))
        findings += [*doubts, *contradiction_findings(values, str(path))]
        found.append(values)
    return tuple(found), tuple(findings)


def _rows_by_pair(path: Path) -> tuple[FloatArray, dict[tuple[str, str], list[_Row]]]:
    """Return the centre frequencies, and the lines of each source and receiver."""
    delimiter, lines = table_rows(path, "table of room parameters")
    if delimiter != ",":
        lines = [(number, [c.replace(",", ".") for c in cells]) for number, cells in lines]
    if len(lines) < 2:
        raise InputError(
            "a table of room parameters without values",
            where=str(path),
            found=f"{len(lines)} line{'' if len(lines) == 1 else 's'}",
            needed=f"a line {_HEAD} and lines of values",
            hint="export the parameters of every pair, one a line",
        )
    centres_hz = _centres_hz(lines[0][1], f"{path}, line {lines[0][0]}")
    rows: dict[tuple[str, str], list[_Row]] = {}
    for number, cells in lines[1:]:
        pair, row = _row(cells, centres_hz, f"{path}, line {number}")
        rows.setdefault(pair, []).append(row)
    return centres_hz, rows


def _centres_hz(cells: list[str], where: str) -> FloatArray:
    begins = [c.lower() for c in cells[:3]] == _HEAD.split(",")[:3]
    if not begins or len(cells) == 3:
        raise InputError(
            f"a table of room parameters {'without bands' if begins else 'begins otherwise'}",
            where=where,
            found=",".join(cells)[:80],
            needed=f"{_HEAD}: centre frequencies from the fourth column on",
            hint="name the first three columns so, and the others by their bands",
        )
    needed = "nominal centres in Hz, low to high"
    hint = "write the bands in rising order, each once"
    centres = [
        number_in(cell, f"{where}, column {column}", needed, hint)
        for column, cell in enumerate(cells[3:], start=4)
    ]
    if np.any(np.diff([0.0, *centres]) <= 0.0):
        found = ",".join(cells[3:])
        what = "centre frequencies must rise"
        raise InputError(what, where=where, found=found[:80], needed=needed, hint=hint)
    return np.array(centres)


def _row(cells: list[str], centres_hz: FloatArray, where: str) -> tuple[tuple[str, str], _Row]:
    """Return source and receiver, and what the line says of them."""
    if any(cells[3 + centres_hz.size :]):
        raise InputError(
            "more values than bands",
            where=where,
            found=f"{len(cells) - 3}",
            needed=f"{centres_hz.size}",
            hint="decimal commas make two cells of one number: write a point",
        )
    source, receiver, parameter = (*cells, "", "", "")[:3]
    if not (source and receiver):
        raise InputError(
            "a line without source or receiver",
            where=where,
            found=",".join(cells)[:80],
            needed="source,receiver,parameter first, as the campaign names them",
            hint="write S,R,T30,0.9,... for T30 from S to R",
        )
    name, is_spread = _name(parameter, where)
    values: FloatArray = np.full(centres_hz.size, np.nan)
    for band, cell in enumerate(cells[3 : 3 + centres_hz.size]):
        if not cell:
            continue
        at = f"{where}, column {band + 4} ({parameter} of {source} to {receiver} at "
        at += f"{centres_hz[band]:g} Hz)"
        values[band] = number_in(cell, at, "a number, or an empty cell where it is unknown")
        if not is_spread:
            check_possible(name, float(values[band]), at)
        elif values[band] < 0.0:
            what, hint = "a standard deviation below zero", "leave the cell empty"
            raise InputError(what, where=at, found=cell, needed="0 or more", hint=hint)
    return (source, receiver), (name, is_spread, values)


def _name(parameter: str, where: str) -> tuple[ValueName, bool]:
    """Return the value that a line is of, and whether it is the spread of it."""
    bare = re.sub(f"{_SPREAD}$", "", parameter, flags=re.IGNORECASE)
    known = {k.upper(): v for k, v in NAMES.items()}
    if bare.upper() not in known:
        raise InputError(
            "unknown room parameter",
            where=where,
            found=repr(parameter),
            needed=f"{', '.join(NAMES)}, or one of them with {_SPREAD}",
            hint=did_you_mean(bare.upper(), NAMES) or "leave the line out, or begin it with #",
        )
    return known[bare.upper()], bare != parameter


def _pair(
    pair: tuple[str, str], rows: list[_Row], centres_hz: FloatArray, where: str
) -> tuple[MeasuredValues, tuple[Finding, ...]]:
    """Return the values of one pair; each repetition of a parameter is another measurement."""
    counts: Counter[tuple[str, bool]] = Counter()
    tables: list[tuple[dict[ValueName, FloatArray], dict[ValueName, FloatArray]]] = []
    for name, is_spread, values in rows:
        number = counts[name, is_spread]
        counts[name, is_spread] += 1
        if number == len(tables):
            tables.append(({}, {}))
        tables[number][is_spread][name] = values
    with located(f"{where}, {pair[0]} to {pair[1]}"):
        return joined_values(tuple(MeasuredValues(*pair, centres_hz, v, s) for v, s in tables))
