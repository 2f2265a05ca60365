"""Tables of positions, of decay times, and of ISO 3382 values."""

from __future__ import annotations

import re
from collections import Counter
from contextlib import suppress
from pathlib import Path

import numpy as np

from roomfit.base.arguments import check_known
from roomfit.base.bands import Bands, bands_of
from roomfit.base.errors import InputError, located
from roomfit.base.findings import Finding
from roomfit.base.typing import FloatArray
from roomfit.files.tables import BandRow, band_rows, number_in, table_rows
from roomfit.formats.model import METRES_PER_UNIT
from roomfit.signals.iso3382 import (
    MeasuredValues,
    ValueName,
    check_possible,
    contradiction_findings,
    joined_values,
)

UNIT_WORDS = {
    word: unit
    for unit, words in {
        "m": "m meter meters metre metres",
        "mm": "mm millimeter millimeters millimetre millimetres",
        "cm": "cm centimeter centimeters centimetre centimetres",
        "ft": "ft foot feet",
        "in": "in inch inches",
    }.items()
    for word in words.split()
}
_PARAMETERS: dict[str, ValueName] = {
    "T20": "T20_s",
    "T30": "T30_s",
    "EDT": "EDT_s",
    "C50": "C50_dB",
    "C80": "C80_dB",
    "D50": "D50_percent",
    "TS": "TS_ms",
    "G": "G_dB",
}


def read_positions(path: Path) -> dict[str, tuple[float, float, float]]:
    """Return positions in m by name from a table: name, x, y, z, with or without a heading.

    Separated by commas, or by tabs or semicolons with decimal commas; or an Excel workbook. A
    heading may state the unit, as in ``name,x_mm,y_mm,z_mm`` or ``x [ft]``; without, metres.
    """
    delimiter, rows = table_rows(path, "table of positions")
    found: dict[str, tuple[float, float, float]] = {}
    factor = 1.0
    needed = "lines of a name that stands once, and x, y, z, as S1,1.2,3.4,1.5"
    for place, (number, cells) in enumerate(rows):
        where = f"{path}, line {number}"
        # 1,20,1,50,1,10 is x = 1.2, y = 1.5, z = 1.1, and not x = 1, y = 20, z = 1
        are_whole = delimiter == "," and all(re.fullmatch(r"-?\d+", c) for c in cells[1:])
        is_split = are_whole and len(cells) == 7
        with suppress(InputError, ValueError):  # no number, or not three cells
            x, y, z = (number_in(c.replace(",", "."), where, needed) for c in (*cells, "")[1:4])
            if cells[0] not in found and not is_split:
                found[cells[0]] = (round(factor * x, 6), round(factor * y, 6), round(factor * z, 6))
                continue
        if found or place or is_split:
            raise InputError(
                "a line of the table of positions is not understood",
                where=where,
                found=repr(delimiter.join(cells)),
                needed=needed,
                hint="decimal commas need semicolons between columns" if is_split else "correct it",
            )
        words = re.split(r"[^a-z]+", " ".join(cells[1:4]).lower())
        units = [UNIT_WORDS[w] for w in words if w in UNIT_WORDS]
        # "x in cm" is centimetres
        unit = next((u for u in units if u != "in"), units[0] if units else "m")
        factor = METRES_PER_UNIT[unit]
    if not found:
        what, hint = "the table of positions is empty", "write one for each source and receiver"
        raise InputError(what, where=str(path), found="no line", needed=needed, hint=hint)
    return found


def read_decay_times(path: Path) -> tuple[FloatArray, Bands]:
    """Return decay times in s, shape (n_positions, n_bands), and their bands.

    The first line has nominal centres in Hz from the second column on, every further one a name
    and a time for each band; empty cells are unknown. Commas, or tabs or semicolons with decimal
    commas; or an Excel workbook.
    """
    centres_hz, rows = band_rows(path, "table of decay times", (), "s")
    table = np.array([row.values for row in rows])
    known = np.isfinite(table).any(axis=0)
    wrong = table[(table <= 0.0) | (table > 60.0)]
    if wrong.size or not known.any():
        raise InputError(
            "a decay time that no room has",
            where=str(path),
            found=f"{wrong[0]:g} s" if wrong.size else "empty cells alone",
            needed="above 0 and up to 60 s",
            hint="give seconds, not ms",
        )
    return table[:, known], bands_of(centres_hz[known])


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
    path, head = Path(path), ("source", "receiver", "parameter")
    by_pair: dict[tuple[str, str], list[BandRow]] = {}
    with located(hint="correct the table there"):
        centres_hz, rows = band_rows(path, "table of room parameters", head)
    for row in rows:
        by_pair.setdefault((row.names[0], row.names[1]), []).append(row)
    chosen = [p for p in by_pair if source in (None, p[0]) and receiver in (None, p[1])]
    if not chosen or not all(map(all, by_pair)):
        raise InputError(
            "the table of room parameters has no line of this pair"
            if all(map(all, by_pair))
            else "a line without source or receiver",
            where=str(path),
            found=", ".join(" to ".join(pair) for pair in by_pair),
            needed=f"source {source or 'any'}, receiver {receiver or 'any'}",
            hint="write source and receiver as the campaign has them: S,R,T30,0.9,...",
        )
    found: list[MeasuredValues] = []
    findings: list[Finding] = []
    for pair in chosen:
        repeated = _repeated(pair, by_pair[pair], centres_hz)
        with located(f"{path}, {pair[0]} to {pair[1]}"):
            values, doubts = joined_values(repeated)
        findings += [*doubts, *contradiction_findings(values, str(path))]
        found.append(values)
    return tuple(found), tuple(findings)


def _repeated(
    pair: tuple[str, str], rows: list[BandRow], centres_hz: FloatArray
) -> tuple[MeasuredValues, ...]:
    """Return the measurements of one pair: each repetition of a parameter is another one."""
    counts: Counter[tuple[str, bool]] = Counter()
    tables: list[tuple[dict[ValueName, FloatArray], dict[ValueName, FloatArray]]] = []
    for row in rows:
        parameter = row.names[2].upper()
        bare = parameter.removesuffix("_SD")
        hint = "leave the line out, or begin it with #"
        check_known("unknown room parameter", bare, _PARAMETERS, where=row.where, else_try=hint)
        name, is_spread = _PARAMETERS[bare], bare != parameter
        for value, place in zip(row.values.tolist(), row.labels, strict=True):
            if not np.isnan(value) and not is_spread:
                check_possible(name, value, place)
            elif value < 0.0:
                what, hint = "a standard deviation below zero", "leave the cell empty"
                raise InputError(
                    what, where=place, found=f"{value:g}", needed="0 or more", hint=hint
                )
        number = counts[name, is_spread]
        counts[name, is_spread] += 1
        if number == len(tables):
            tables.append(({}, {}))
        tables[number][is_spread][name] = row.values
    return tuple(MeasuredValues(*pair, centres_hz, v, s) for v, s in tables)
