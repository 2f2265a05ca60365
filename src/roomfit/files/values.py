"""Tables of positions, of decay times, and of ISO 3382 values."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from roomfit.base.arguments import check_known, in_short
from roomfit.base.bands import Bands, bands_of
from roomfit.base.errors import InputError, located
from roomfit.base.findings import Finding
from roomfit.base.typing import FloatArray
from roomfit.files import tables
from roomfit.formats.model import METRES_PER_UNIT
from roomfit.signals import iso3382

_PARAMETERS: dict[str, iso3382.ValueName] = {
    name.partition("_")[0].upper(): name for name in iso3382.VALUE_NAMES
}
_NEVER_ZERO = ("T20_s", "T30_s", "EDT_s", "TS_ms")
_PAIR = ("source", "receiver", "parameter")
_NEEDED = "a name that stands once, and x, y, z in the room's axes, as S1,1.2,3.4,1.5"
_UNCLEAR = "with a line that is not understood"
_COMMAS = "decimal commas need semicolons between columns"
Position = tuple[float, float, float]


class _Columns(NamedTuple):
    """Which columns of a table of positions are what."""

    name: int
    at: list[int]  # of x, y, z
    units: list[str]  # of each, "" where unsaid
    heading: list[str]


def read_positions(path: Path) -> tuple[dict[str, Position], tuple[Finding, ...]]:
    """Return positions in m by name, from columns of a name and x, y, z, and what was left out.

    A heading puts columns into any order among others, and may state the unit, as in
    ``name,x_mm,y_mm,z_mm`` or ``x [ft]``; without, metres. Without a heading a row is a name and
    three numbers. Between columns stands anything; or it is an Excel workbook.
    """
    sheet = tables.read_sheet(path, "table of positions")
    found: dict[str, Position] = {}
    columns: _Columns | None = None
    unit, without, above = "", list[str](), tables.Row("", [])
    for row in sheet.rows:
        cells = row.cells
        if own := _position_columns(row, sheet):
            columns, unit = own, next(filter(None, own.units), unit)
        elif row.is_remark or tables.are_units(row):
            unit = _unit_in(" ".join(cells)) or unit
            if columns and not row.is_remark:
                units = [_unit_in(c) for c in (*cells, *columns.heading)]
                columns = columns._replace(units=[units[i] for i in columns.at])
        elif not found and not columns and len(sheet.numbers(cells[1:])) < 2:
            unit, above = _unit_in(" ".join(cells)) or unit, row
        else:
            if not columns and sum(map(bool, above.cells)) > 3:
                hint = "rename those of the position, or leave the heading out"
                raise _refused(above, "whose heading names no x, y, z", hint)
            name, coordinates = _name_and_coordinates(row, columns, sheet)
            x, y, z = (
                _metres(c, (columns.units[i] if columns else "") or unit or "m", row, sheet)
                for i, c in enumerate(coordinates)
            )
            if name in found or not name:
                raise _refused(row, _UNCLEAR, "give each row a name of its own")
            if all(map(math.isnan, (x, y, z))):
                without.append(name)
            elif math.isnan(x + y + z):
                raise _refused(row, _UNCLEAR, "write all three, or leave the row out")
            else:
                found[name] = (x, y, z)
    for name, is_left in zip([*found], tables.are_summaries([*found, *without]), strict=False):
        without += [name] if is_left else []
        found = {n: at for n, at in found.items() if n != name or not is_left}
    if not found:
        what, hint = "the table of positions is empty", "write one for each source and receiver"
        raise InputError(what, where=str(path), found="no line", needed=_NEEDED, hint=hint)
    used = (columns.name, *columns.at) if columns else ()
    others = [c for i, c in enumerate(columns.heading) if c and i not in used] if columns else []
    return found, tables.left_out(path, "positions", {"rows": without, "columns": others})


def _position_columns(row: tables.Row, sheet: tables.Sheet) -> _Columns | None:
    """Return the columns of names and of x, y, z where a row is a heading of positions."""
    groups: dict[tuple[str, ...], dict[str, int]] = {}
    spherical = set()
    for i, cell in enumerate(row.cells):
        label = re.sub(r"[\[(].*?[\])]", " ", cell.lower())
        words = [w for w in re.findall(r"[^\W\d_]+", label) if not tables.length_unit(w)]
        words = [
            m[1] if (m := tables.words_of("axis").fullmatch(w)) else w
            for w in words
            if not tables.is_word("position", w)
        ]
        axes = [w for w in words if w in "xyz"]
        if len(axes) == 1:
            rest = tuple(w for w in words if w not in axes)
            groups.setdefault(rest, {}).setdefault(axes[0], i)
        elif words and tables.is_word("spherical", words[0]):
            spherical.add(cell)
    whole = {
        k: at
        for k, at in groups.items()
        if len(at) == 3 and not any(tables.is_word("direction", w) for w in k)
    }
    if () in whole:
        whole = {(): whole[()]}
    if len(whole) > 1:
        raise _refused(row, "with several in a row", "write a row for each, its columns x, y, z")
    if not whole and len(spherical) > 1:
        hint = "convert them, and add where their origin lies in the room"
        raise _refused(row, "in spherical coordinates", hint)
    if not whole:
        return None
    ((_, by_axis),) = whole.items()
    at = [by_axis[axis] for axis in "xyz"]
    return _Columns(
        _name_column(row, at, sheet), at, [_unit_in(row.cells[i]) for i in at], row.cells
    )


def _name_column(row: tables.Row, at: Sequence[int], sheet: tables.Sheet) -> int:
    """Return the column of names: by its heading, else the first of words or of whole numbers."""
    others = [i for i in range(len(row.cells)) if i not in at]
    for kind in ("name", "number"):
        for i in others:
            if tables.is_word(kind, row.cells[i].lower()):
                return i
    below = [r.cells for r in sheet.rows[sheet.rows.index(row) + 1 :] if not r.is_remark]
    for i in others:
        own = [cells[i] for cells in below if i < len(cells) and cells[i]]
        if own and not [c for c in sheet.numbers(own) if i or not c.isdecimal()]:
            return i
    raise _refused(row, "without names", "add a column of names: name,x,y,z")


def _unit_in(label: str) -> str:
    """Return the unit of length that a label names, "" for none: of "x in cm" centimetres."""
    units = [unit for w in re.split(r"[^a-z]+", label.lower()) if (unit := tables.length_unit(w))]
    return next((u for u in units if u != "in"), units[0] if units else "")


def _refused(row: tables.Row, what: str, hint: str) -> InputError:
    """Return the refusal of a table of positions by its heading, or by one of its lines."""
    what, found = f"a table of positions {what}", row.text or ", ".join(row.cells)
    return InputError(what, where=row.where, found=repr(found[:200]), needed=_NEEDED, hint=hint)


def _name_and_coordinates(
    row: tables.Row, columns: _Columns | None, sheet: tables.Sheet
) -> tuple[str, list[str]]:
    """Return the name and the three cells of a position."""
    if columns is not None:
        n = len(columns.heading)
        if any(row.cells[n:]):
            raise _refused(row, _UNCLEAR, _COMMAS)
        cells = row.cells + [""] * (n - len(row.cells))
        return cells[columns.name], [cells[i] for i in columns.at]
    own = sheet.numbers(row.cells[1:])
    if len(own) == 3:
        return row.cells[0], own
    are_whole = sheet.separator == "," and len(own) == 6 and all(c.isdecimal() for c in own)
    names = "name the columns in a line above: name,x,y,z, and others as they are"
    raise _refused(row, _UNCLEAR, _COMMAS if are_whole else names if len(own) > 3 else "correct it")


def _metres(cell: str, unit: str, row: tables.Row, sheet: tables.Sheet) -> float:
    """Return a coordinate in m, NaN for none; its cell may state another unit than its column."""
    known = sheet.number(cell)
    own = tables.length_unit(known[1]) if known else ""
    if known is None or (known[1] and not own):
        raise _refused(row, _UNCLEAR, "correct it")
    unit = own or unit
    if unit == "mm" and not sheet.decimal and re.fullmatch(r"-?[1-9]\d{0,2}[.,]\d{3}", cell):
        raise _refused(row, _UNCLEAR, f"write {cell} without the mark if it is of thousands")
    return round(METRES_PER_UNIT[unit] * known[0], 6)


def _counts(row: tables.BandRow) -> bool:
    """Whether a row is called N and holds whole numbers, as of measurements."""
    cells = [cell for cell, _ in row.cells.values() if cell]
    return row.names[-1].casefold() == "n" and all(cell.isdecimal() for cell in cells)


def read_decay_times(path: Path) -> tuple[FloatArray, Bands, tuple[Finding, ...]]:
    """Return decay times in s, shape (n_positions, n_bands), their bands, and what was left out.

    Columns are nominal centres in Hz, rows positions, or the other way round; or rows, columns and
    titles name the quantity, as programs that measure write it: then T30 is taken, T20 where that
    was not evaluated, else the next that there is. Empty cells, 0 and marks are unknown. Rows that
    summarise others, or hold another quantity, are left out.
    """
    rows, others = tables.band_rows(path, "table of decay times")
    are_left = tables.are_summaries([row.rest or row.names[0] for row in rows])
    own = [r for r, is_one in zip(rows, are_left, strict=True) if not (is_one or _counts(r))]
    known = [r.quantity for r in own if r.quantity in tables.TIMES and np.nansum(r.values(r.cells))]
    wanted = next((quantity for quantity in tables.TIMES if quantity in known), "")
    taken = [row for row in own if row.quantity == wanted]
    taken += [row for row in own if row.quantity == "T20" and wanted == "T30"]
    if not taken:
        raise InputError(
            "a table of decay times that holds none",
            where=str(path),
            found=in_short([f"{' '.join(row.names)} ({row.quantity})".strip() for row in rows]),
            needed="rows or columns of T30 or T20 in s",
            hint="export T30 of every position in its bands",
        )
    centres_hz = np.array(sorted({hz for row in taken for hz in row.cells}))
    times: dict[tuple[str, int], FloatArray] = {}
    counts: Counter[tuple[str, str]] = Counter()
    for row in taken:
        position = (row.rest, counts[row.quantity, row.rest])
        counts[row.quantity, row.rest] += 1
        values = row.values(centres_hz)
        values[values == 0.0] = np.nan  # what programs write where they evaluated nothing
        before = times.get(position, values)
        times[position] = np.where(np.isfinite(before), before, values)
    table = np.array(list(times.values()))
    has_some = np.isfinite(table).any(axis=0)
    wrong = table[(table <= 0.0) | (table > 60.0)]
    if wrong.size or not has_some.any():
        is_long = bool(wrong.size and wrong[0] > 0.0)
        raise InputError(
            "a decay time that no room has",
            where=str(path),
            found=f"{wrong[0]:g} s" if wrong.size else "nothing but empty cells and 0",
            needed="above 0 and up to 60 s; empty, or 0, where nothing was evaluated",
            hint="give seconds, or say [ms] in the heading" if is_long else "leave the cell empty",
        )
    left = [" ".join(row.names) or row.quantity for row in rows if row not in taken]
    findings = tables.left_out(path, wanted or "decay times", {"rows": left, "columns": others})
    return table[:, has_some], bands_of(centres_hz[has_some]), findings


def read_parameters(
    path: Path, source: str | None = None, receiver: str | None = None
) -> tuple[tuple[iso3382.MeasuredValues, ...], tuple[Finding, ...]]:
    """Read measured room parameters.

    A line ``source,receiver,parameter,125,250,...`` with nominal centres in Hz, in any order and
    among others. Each line below it holds one parameter of one pair: T20, T30, EDT in s, C50, C80,
    G in dB, D50 in percent, TS in ms; T20_sd and the like hold the standard deviation. Empty cells
    are unknown. Lines that begin with # are left out. Semicolons or tabs may stand for commas, and
    decimals then have commas; or it is an Excel workbook.

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
        `Code.ROOM_PARAMETERS_INCONSISTENT`, `Code.REPEATED_VALUES_DIFFER`,
        `Code.TABLE_PARTLY_READ`.

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
    by_pair: dict[tuple[str, str], list[tables.BandRow]] = {}
    with located(hint="correct the table there"):
        rows, others = tables.band_rows(path, "table of room parameters", _PAIR)
    summaries = [any(tables.are_summaries([*row.names[:2]])) for row in rows]
    is_other = [
        s or row.quantity in ("other", "label") for s, row in zip(summaries, rows, strict=True)
    ]
    left = [" ".join(row.names) for row, is_one in zip(rows, is_other, strict=True) if is_one]
    for row, is_one in zip(rows, is_other, strict=True):
        if not is_one:
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
    found: list[iso3382.MeasuredValues] = []
    findings = [*tables.left_out(path, "room parameters", {"rows": left, "columns": others})]
    centres_hz = np.array(sorted({hz for row in rows for hz in row.cells}))
    for pair in chosen:
        repeated = _repeated(pair, by_pair[pair], centres_hz)
        with located(f"{path}, {pair[0]} to {pair[1]}"):
            values, doubts = iso3382.joined_values(repeated)
        findings += [*doubts, *iso3382.contradiction_findings(values, str(path))]
        found.append(values)
    return tuple(found), tuple(findings)


def _repeated(
    pair: tuple[str, str], rows: list[tables.BandRow], centres_hz: FloatArray
) -> tuple[iso3382.MeasuredValues, ...]:
    """Return the measurements of one pair: each repetition of a parameter is another one."""
    counts: Counter[tuple[str, bool]] = Counter()
    repeated: list[
        tuple[dict[iso3382.ValueName, FloatArray], dict[iso3382.ValueName, FloatArray]]
    ] = []
    for row in rows:
        parameter = row.names[2].upper()
        plain = parameter.removesuffix("_SD")
        bare = tables.quantity_in(plain)[0] or plain
        hint = "leave the line out, or begin it with #"
        check_known("unknown room parameter", bare, _PARAMETERS, where=row.where, else_try=hint)
        name, is_spread = _PARAMETERS[bare], plain != parameter
        values = row.values(centres_hz)
        if name == "TS_ms" and (row.is_in_ms or re.search(r"[\[(]S[\])]", parameter)):
            values *= 1000.0
        elif name in _NEVER_ZERO:  # what programs write where they evaluated nothing
            values[values == 0.0] = np.nan
        for hz, value in zip(centres_hz.tolist(), values.tolist(), strict=True):
            place = row.cells.get(hz, ("", row.where))[1]
            if not np.isnan(value) and not is_spread:
                iso3382.check_possible(name, value, place)
            elif value < 0.0:
                what, hint = "a standard deviation below zero", "leave the cell empty"
                raise InputError(
                    what, where=place, found=f"{value:g}", needed="0 or more", hint=hint
                )
        number = counts[name, is_spread]
        counts[name, is_spread] += 1
        if number == len(repeated):
            repeated.append(({}, {}))
        repeated[number][is_spread][name] = values
    return tuple(iso3382.MeasuredValues(*pair, centres_hz, v, s) for v, s in repeated)
