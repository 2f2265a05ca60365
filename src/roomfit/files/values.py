"""Tables of positions, of decay times, and of ISO 3382 values."""

from __future__ import annotations

import math
import re
from collections import Counter, defaultdict
from collections.abc import Sequence
from pathlib import Path

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
_SPREAD = re.compile(r"[\W_]+(sd|std|stdev|s\.d\.)\W*(?=$|[\[(]\w+[\])]$)", re.IGNORECASE)
_SIZES = {"s": tables.SECONDS, "ms": {"ms": 1.0, "s": 1e3}}
Position = tuple[float, float, float]
_Values = dict[iso3382.ValueName, FloatArray]


def read_positions(path: Path) -> tuple[dict[str, Position], tuple[Finding, ...]]:
    """Return positions in m by name, from columns of a name and x, y, z, and what was left out.

    A heading puts columns into any order among others, and may state the unit, as in
    ``name,x_mm,y_mm,z_mm`` or ``x [ft]``; without, metres. Without a heading a row is a name and
    three numbers. Between columns stands anything; or it is an Excel workbook.
    """
    sheet = tables.read_sheet(path, "table of positions")
    found: dict[str, Position] = {}
    columns: dict[str, int] = {}
    heading, units = list[str](), [""] * 3
    stated, without, above = list[str](), list[str](), tables.Row("", [])
    headings = [_position_columns(row, sheet) for row in sheet.rows]
    for row, own in zip(sheet.rows, headings, strict=True):
        cells, few = row.cells, not found and len(sheet.numbers(row.cells[1:])) < 2
        if own or (columns and tables.are_units(row)):
            columns, heading = own or columns, cells if own else heading
            padded = [*cells, *[""] * len(heading)]
            units = [_unit_in(padded[columns[axis]]) for axis in ("x", "y", "z", "name")]
            stated = [*filter(None, units)] or stated
        elif row.is_remark and (found or without):
            continue
        elif row.is_remark or (not columns and (few or any(headings))):
            stated = [*stated, *cells]
            above = above if row.is_remark or tables.are_units(row) else row
        else:
            if not columns and sum(map(bool, above.cells)) > 3:
                hint = "rename those of the position, or leave the heading out"
                raise _refused(above, "whose heading names no x, y, z", hint)
            name, coordinates = _name_and_coordinates(row, columns, len(heading), sheet)
            unit = tables.stated_unit(stated, METRES_PER_UNIT) or "m"
            own_unit = "".join({*cells[1:]} & {*METRES_PER_UNIT})
            x, y, z = (
                round(sheet.value(cell, own_unit or of or unit, METRES_PER_UNIT, row.where), 6)
                for cell, of in zip(coordinates, units, strict=False)
            )
            if name in found or not name:
                raise _refused(row, _UNCLEAR, "give each row a name of its own")
            if all(map(math.isnan, (x, y, z))):
                without.append(name)
                another = "" if name.isalpha() else tables.stated_unit([name], METRES_PER_UNIT)
                if another not in ("", unit, *units):  # of a title, or a note
                    hint = "name the unit in each heading of a column alone, as x [cm]"
                    raise _refused(row, f"in {unit} or {another}", hint)
            elif math.isnan(x + y + z):
                raise _refused(row, _UNCLEAR, "write all three, or leave the row out")
            else:
                found[name] = (x, y, z)
    left = tables.summaries([*found, *without])
    without += left - {*without}
    found = {name: at for name, at in found.items() if name not in left}
    if not found:
        what, hint = "the table of positions is empty", "write one for each source and receiver"
        raise InputError(what, where=str(path), found="no line", needed=_NEEDED, hint=hint)
    others = [c for i, c in enumerate(heading) if c and i not in columns.values()]
    return found, tables.left_out(path, "positions", {"rows": without, "columns": others})


def _position_columns(row: tables.Row, sheet: tables.Sheet) -> dict[str, int]:
    """Return the columns of "name", "x", "y", "z" where a row is a heading of positions."""
    groups: dict[tuple[str, ...], dict[str, int]] = {}
    spherical, is_twice = set(), False
    for i, cell in enumerate(row.cells):
        words = [
            tables.words_of("axis").sub(r"\1", word)
            for word in re.findall(r"[^\W\d_]+|\d+", re.sub(r"[\[(].*?[\])]", " ", cell.lower()))
            if not tables.unit_of(word) and not tables.is_word("position", word)
        ]
        rest = tuple(word for word in words if word not in ("x", "y", "z"))
        if len(words) - len(rest) == 1 and not any(tables.is_word("direction", w) for w in rest):
            axis = next(word for word in words if word not in rest)
            is_twice = is_twice or axis in groups.setdefault(rest, {})
            groups[rest][axis] = i
        elif words and tables.is_word("spherical", words[0]):
            spherical.add(cell)
    whole = {rest: at for rest, at in groups.items() if len(at) == 3}
    if (len(whole) > 1 and () not in whole) or (whole and is_twice):
        raise _refused(row, "with several in a row", "write a row for each, its columns x, y, z")
    if not whole and len(spherical) > 1:
        hint = "convert them, and add where their origin lies in the room"
        raise _refused(row, "in spherical coordinates", hint)
    by_axis = whole.get(()) or next(iter(whole.values()), {})
    return by_axis and {"name": _name_column(row, [*by_axis.values()], sheet), **by_axis}


def _name_column(row: tables.Row, at: Sequence[int], sheet: tables.Sheet) -> int:
    """Return the column of names: by its heading, else the first of words or of whole numbers."""
    others = [i for i in range(len(row.cells)) if i not in at]
    words = [i for kind in ("name", "number") for i in others if tables.is_word(kind, row.cells[i])]
    if words:
        return words[0]
    below = [r.cells for r in sheet.rows[sheet.rows.index(row) + 1 :] if not r.is_remark]
    for i in others:
        own = [cells[i] for cells in below if i < len(cells) and cells[i]]
        if own and not [c for c in sheet.numbers(own) if i or not c.isdecimal()]:
            return i
    raise _refused(row, "without names", "add a column of names: name,x,y,z")


def _unit_in(label: str) -> str:
    """Return the unit that a column's heading states, "" for none, as x [cm], x in cm or x_cm."""
    return tables.stated_unit([label, re.split(r"[\W_]+", label)[-1]], METRES_PER_UNIT)


def _refused(row: tables.Row, what: str, hint: str) -> InputError:
    """Return the refusal of a table of positions by its heading, or by one of its lines."""
    what, found = f"a table of positions {what}", row.text or ", ".join(row.cells)
    return InputError(what, where=row.where, found=repr(found[:200]), needed=_NEEDED, hint=hint)


def _name_and_coordinates(
    row: tables.Row, columns: dict[str, int], n: int, sheet: tables.Sheet
) -> tuple[str, list[str]]:
    """Return the name and the three cells of a position below `n` columns, if a heading has any."""
    if columns:
        if any(row.cells[n:]):
            raise _refused(row, _UNCLEAR, _COMMAS)
        cells = row.cells + [""] * (n - len(row.cells))
        return cells[columns["name"]], [cells[columns[axis]] for axis in "xyz"]
    own = sheet.numbers(row.cells[1:])
    if len(own) == 3:
        return row.cells[0], own
    are_whole = sheet.separator == "," and len(own) == 6 and all(c.isdecimal() for c in own)
    names = "name the columns in a line above: name,x,y,z, and others as they are"
    raise _refused(row, _UNCLEAR, _COMMAS if are_whole else names if len(own) > 3 else "correct it")


def _is_beside(row: tables.BandRow, rows: Sequence[tables.BandRow]) -> bool:
    """Whether a row is of no position: T30 r beside T30, counts, a note with one value."""
    others = [o.rest for o in rows if o.quantity == row.quantity and o.rest != row.rest]
    whole = [re.sub(r"(^|\| )…$", r"\1", rest) for rest in others if rest.endswith("…")]
    first, *cells = (cell for cell, _ in row.cells.values())
    is_note = len(cells) > 1 and not any(cells) and len(row.names) == 1 and "…" not in row.rest
    counts = row.names[-1].rstrip(" =:") in ("n", "N") and all(
        c.isdecimal() for c in (first, *cells) if c
    )
    return row.rest.startswith(tuple(whole)) or is_note or counts


def read_decay_times(path: Path) -> tuple[FloatArray, Bands, tuple[Finding, ...]]:
    """Return decay times in s, shape (n_positions, n_bands), their bands, and what was left out.

    Columns are nominal centres in Hz, rows positions, or the other way round; or rows, columns and
    titles name the quantity, as programs that measure write it: then T30 is taken, T20 where that
    was not evaluated, else the next that there is. Empty cells, 0 and marks are unknown. Rows that
    summarise others, or hold another quantity, are left out.
    """
    rows, others = tables.band_rows(path, "table of decay times")
    left = tables.summaries([row.rest for row in rows])
    own = [r for r in rows if r.rest not in left and not _is_beside(r, rows)]
    known = [r.quantity for r in own if r.quantity in tables.TIMES and np.nansum(r.values(r.cells))]
    wanted = next((quantity for quantity in tables.TIMES if quantity in known), "")
    taken = [row for row in own if row.quantity == wanted]
    taken += [row for row in own if row.quantity == "T20" and wanted == "T30"]
    if not taken:
        what = "a table of decay times that holds none"
        names = in_short([f"{' '.join(row.names)} ({row.quantity})".strip() for row in rows])
        hint = "export T30 of every position in its bands"
        needed = "rows or columns of T30 or T20 in s"
        raise InputError(what, where=str(path), found=names, needed=needed, hint=hint)
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
    has_some, is_row = (np.isfinite(table).any(axis=axis) for axis in (0, 1))
    table, names = table[np.ix_(is_row, has_some)], np.array([name for name, _ in times])[is_row]
    wrong = table[(table < 0.01) | (table > 60.0)]
    if wrong.size or not table.size:
        what = "a decay time that no room has"
        seconds = f"{wrong[0]:g} s" if wrong.size else "nothing but empty cells and 0"
        needed = "0.01 to 60 s; empty, or 0, where nothing was evaluated"
        hint = "give seconds, or say [ms] in the heading; else leave the cell empty"
        raise InputError(what, where=str(path), found=seconds, needed=needed, hint=hint)
    apart = np.nanmedian(table / np.nanmedian(table, axis=0), axis=1)
    if apart.max() > 5.0 * apart.min():
        what, needed = "decay times that no room has together", "each at most 5 times another"
        ratio = f"{names[apart.argmax()]}: {apart.max() / apart.min():.3g} times those of"
        hint = "leave out what is none, or call it: Std, Error, Limit, C80"
        found = f"{ratio} {names[apart.argmin()]}".replace("…", wanted)
        raise InputError(what, where=str(path), found=found, needed=needed, hint=hint)
    rest = [" ".join(row.names) or row.quantity for row in rows if row not in taken]
    findings = tables.left_out(path, wanted or "decay times", {"rows": rest, "columns": others})
    return table, bands_of(centres_hz[has_some]), findings


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
    with located(hint="correct the table there"):
        rows, others = tables.band_rows(path, "table of room parameters", _PAIR)
    own = [row for row in rows if _parameter(row)[0] and not tables.summaries(row.names[:2])]
    left = [" ".join(row.names) for row in rows if row not in own]
    pairs = dict.fromkeys((row.names[0], row.names[1]) for row in own)
    chosen = [p for p in pairs if source in (None, p[0]) and receiver in (None, p[1])]
    if not chosen or not all(map(all, pairs)):
        what = "the table of room parameters has no line of this pair"
        what = what if all(map(all, pairs)) else "a line without source or receiver"
        listed = ", ".join(" to ".join(pair) for pair in pairs)
        needed = f"source {source or 'any'}, receiver {receiver or 'any'}"
        hint = "write source and receiver as the campaign has them: S,R,T30,0.9,..."
        raise InputError(what, where=str(path), found=listed, needed=needed, hint=hint)
    found: list[iso3382.MeasuredValues] = []
    findings = [*tables.left_out(path, "room parameters", {"rows": left, "columns": others})]
    centres_hz = np.array(sorted({hz for row in rows for hz in row.cells}))
    for pair in chosen:
        repeated = _repeated(pair, [r for r in own if r.names[:2] == pair], centres_hz)
        with located(f"{path}, {pair[0]} to {pair[1]}"):
            values, doubts = iso3382.joined_values(repeated)
        findings += [*doubts, *iso3382.contradiction_findings(values, str(path))]
        found.append(values)
    return tuple(found), tuple(findings)


def _parameter(row: tables.BandRow) -> tuple[str, bool]:
    """Return the parameter of a line, "" for what is beside one, and whether it is its spread."""
    plain = _SPREAD.sub("", row.names[2])
    quantity, rest = tables.quantity_in(plain)
    is_other = quantity in ("other", "label") or (quantity and rest != "…")
    return "" if is_other else quantity or row.names[2].upper(), plain != row.names[2]


def _repeated(
    pair: tuple[str, str], rows: list[tables.BandRow], centres_hz: FloatArray
) -> tuple[iso3382.MeasuredValues, ...]:
    """Return the measurements of one pair: each repetition of a parameter is another one."""
    counts: Counter[tuple[str, bool]] = Counter()
    repeated: defaultdict[int, tuple[_Values, _Values]] = defaultdict(lambda: ({}, {}))
    for row in rows:
        bare, is_spread = _parameter(row)
        hint = "leave the line out, or begin it with #"
        check_known("unknown room parameter", bare, _PARAMETERS, where=row.where, else_try=hint)
        name = _PARAMETERS[bare]
        unit = name.partition("_")[2].lower()
        values = row.values(centres_hz, _SIZES.get(unit, {unit: 1.0}))
        if (
            name in _NEVER_ZERO and not is_spread
        ):  # what programs write where they evaluated nothing
            values[values == 0.0] = np.nan
        for hz, value in zip(centres_hz.tolist(), values.tolist(), strict=True):
            place = row.cells.get(hz, ("", row.where))[1]
            if not np.isnan(value) and not is_spread:
                iso3382.check_possible(name, value, place)
            elif value < 0.0:
                what, found = "a standard deviation below zero", f"{value:g}"
                hint = "leave the cell empty"
                raise InputError(what, where=place, found=found, needed="0 or more", hint=hint)
        repeated[counts[name, is_spread]][is_spread][name] = values
        counts[name, is_spread] += 1
    return tuple(iso3382.MeasuredValues(*pair, centres_hz, v, s) for v, s in repeated.values())
