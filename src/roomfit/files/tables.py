"""Tables of strangers, read by their headings: text of any separator, or an Excel workbook.

Titles above a heading, units below it, another order and more columns than needed do no harm.
Numbers have either decimal mark, and marks for "not evaluated" are no value.
"""

from __future__ import annotations

import io
import math
import re
import tomllib
import unicodedata
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from importlib.resources import files
from itertools import accumulate, zip_longest
from pathlib import Path
from string import digits
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from roomfit.base.arguments import in_short
from roomfit.base.bands import THIRD_OCTAVES_HZ
from roomfit.base.door import csv_rows, read_bytes, read_text, unpacked_limit_bytes
from roomfit.base.errors import DAMAGE, InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import FloatArray

TABLE_SUFFIXES = (".csv", ".tsv", ".txt", ".xlsx")
"""Endings under which tables are offered to be dropped; every other one is read as text."""
TIMES = ("T30", "T20", "T", "T15", "T10", "EDT")
"""Times of decay, in the order in which they are taken."""
_MAIN = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}"
_MOST_COLUMNS = 16_384  # of a sheet of Excel
_SEPARATORS = (";", "\t", "|", ",", "  ", " ")
_GROUP_MARKS = "['\\u2019 \\xa0\\u202f]"
_NUMBER = re.compile(
    rf"([-+\u2212]?(?:\d+(?:{_GROUP_MARKS}\d{{3}})*(?:[.,]\d+)*[.,]?|[.,]\d+)(?:e[-+]?\d+)?)"
    r"\s*([^\W\d_]{0,4}|%)",
    re.IGNORECASE,
)
_GROUPED = re.compile(r"[-+]?[1-9]\d{0,2}((\.\d{3})+|(,\d{3})+)")
Sizes = Mapping[str, float]  # of units
SECONDS: Sizes = {"s": 1.0, "ms": 0.001}
_SMALL = ("mm", "cm", "in", "ms")  # units in which 1.200 may be 1200
_UNCLEAR = re.compile(r"[-+]?[1-9]\d{0,2}[.,]\d{3}\s*[^\W\d]*")
_BELOW = ("8", "10", "12.5", "12,5", "16", "20")  # bands that are not used


@cache
def words_of(kind: str) -> re.Pattern[str]:
    """Return the pattern of a kind of words, see ``words.toml``."""
    known = tomllib.loads(files("roomfit.files").joinpath("words.toml").read_text("utf-8"))
    if isinstance(known[kind], dict):
        own = "|".join(f"(?P<{name}>{'|'.join(ways)})" for name, ways in known[kind].items())
        return re.compile(rf"(?<![^\W_])(?:{own})(?![^\W_])", re.IGNORECASE)
    return re.compile("|".join(known[kind]), re.IGNORECASE)


def is_word(kind: str, label: str) -> bool:
    """Whether a label is a word of a kind."""
    return bool(words_of(kind).fullmatch(label))


def unit_of(word: str) -> str:
    """Return the unit that a word stands for, "" for none."""
    match = words_of("units").fullmatch(word)
    return str(match.lastgroup) if match else ""


class Row(NamedTuple):
    """One line that is not empty."""

    where: str  # file and line
    cells: list[str]
    text: str = ""  # as it stands in a file of text
    is_remark: bool = False


class Sheet(NamedTuple):
    """All rows of a table."""

    separator: str
    rows: list[Row]
    decimal: str  # its mark, "" where cells do not agree or say nothing

    def number(self, cell: str) -> tuple[float, str] | None:
        """Return a number and the unit behind it, NaN for a mark of no value, None for text."""
        if is_word("nothing", cell):
            return math.nan, ""
        match = _NUMBER.fullmatch(cell)
        value = _as_float(match[1], self.decimal) if match else None
        return None if match is None or value is None else (value, match[2].lower())

    def value(self, cell: str, unit: str, sizes: Sizes, where: str) -> float:
        """Return the number in a cell times the size of its unit, NaN for none.

        `unit` is that of cells that state none. Refused are units without a size, and 1.200 of
        small units, whose mark may be of thousands.
        """
        number, behind = self.number(cell) or (math.nan, "?")
        own = unit_of(behind) if behind else unit
        is_unclear = own in _SMALL and not self.decimal and _UNCLEAR.fullmatch(cell)
        if own in sizes and not is_unclear:
            return sizes[own] * number
        what = "not a number, or one that is not understood"
        needed = f"a number, or an empty cell, in {' or '.join(sizes)}"
        hint = "leave the cell empty where nothing is known, or name its unit in the heading"
        if is_unclear:
            hint = f"write {cell} without the mark if it is of thousands, else with more decimals"
        raise InputError(what, where=where, found=repr(cell[:40]), needed=needed, hint=hint)

    def numbers(self, cells: Iterable[str]) -> list[str]:
        """Return the cells that are numbers, marks of no value left out."""
        return [c for c in cells if (known := self.number(c)) and not math.isnan(known[0])]


def _as_float(number: str, decimal: str) -> float | None:
    """Return a number with either mark for decimals or for groups."""
    plain = re.sub(_GROUP_MARKS, "", number).replace("\u2212", "-")
    marks = re.findall("[.,]", plain)
    if _GROUPED.fullmatch(plain):
        if len(marks) > 1 or decimal not in ("", marks[0]):
            return float(re.sub("[.,]", "", plain))
    elif marks and marks.count(marks[-1]) > 1:
        return None
    other = "," if marks[-1:] == ["."] else "."
    return float(plain.replace(other, "").replace(",", "."))


def read_sheet(path: Path, what: str, separator: str = "") -> Sheet:
    """Return the rows of a table; of a workbook (``.xlsx``) those of the first sheet.

    Without a `separator` it is the one between which most numbers stand, and semicolons and tabs
    before commas, so that commas are those of decimals. `what` is what the file is called in
    messages: "table of positions".
    """
    is_book = path.suffix.lower() == ".xlsx"
    lines: list[str] = []
    found: Iterable[tuple[int, list[str]]]
    if is_book:
        separator, found = "\t", _sheet_rows(read_bytes(path, what, most="text_bytes"), str(path))
    else:
        lines = read_text(path, what).split("\n")
        if stated := re.fullmatch(r'"?sep=(.)"?\s*', lines[0]):
            separator, lines[0] = stated[1], ""
        separator = separator or _separator(lines[:400])
        found = _split("\n".join(lines), separator, str(path))
    rows = []
    for number, cells in found:
        own = [cell.strip() for cell in cells]
        is_remark = "".join(own[:1]).startswith(("#", "%", "//"))
        if is_remark and not separator.strip() and not own[0].strip("#%/"):
            own = own[1:]
        if any(own):
            text = "" if is_book else lines[number - 1]
            rows.append(Row(f"{path}, line {number}", own, text, is_remark))
    numbers = [m[1] for row in rows for cell in row.cells if (m := _NUMBER.fullmatch(cell))]
    marks = {re.sub("[^.,]", "", n)[-1:] for n in numbers if not _GROUPED.fullmatch(n)} - {""}
    return Sheet(separator, rows, "".join(marks) if len(marks) == 1 and not is_book else "")


def _split(text: str, separator: str, where: str) -> Iterable[tuple[int, list[str]]]:
    """Return number of the line and cells of each row of a text."""
    if separator.strip() or separator == "\t":
        return csv_rows(text, where, separator)
    pattern = r"\s{2,}|\t" if separator == "  " else r"\s+(?=(?:[^\"]*\"[^\"]*\")*[^\"]*$)"
    lines = enumerate(text.split("\n"), start=1)
    return [(n, [c.strip('"') for c in re.split(pattern, line.strip())]) for n, line in lines]


def _separator(lines: Sequence[str]) -> str:
    """Return what stands between columns: between which most numbers stand."""
    text = "\n".join(line for line in lines if not line.startswith("#"))
    counts = {}
    for separator in _SEPARATORS:
        rows = [cells for _, cells in _split(text, separator, "") if len(cells) > 1]
        counts[separator] = sum(bool(_NUMBER.fullmatch(c.strip())) for row in rows for c in row)
    most = max(counts.values())
    if not most:
        return next((s for s in _SEPARATORS[:2] if s in text), ",")
    return next(s for s in _SEPARATORS if 2 * counts[s] >= most)


def _small(row: Row) -> list[str]:
    return [" ".join(cell.casefold().split()) for cell in row.cells]


def lacking(path: Path, what: str, rows: Sequence[Row], names: Sequence[str]) -> InputError:
    """Return the refusal of a table without a heading, bands or values."""
    first = " ".join(rows[0].cells)[:60] if rows else ""
    found = f"{len(rows)} line{'' if len(rows) == 1 else 's'}, the first {first!r}"
    needed = f"a line that names the columns {', '.join(names)}, and lines of values"
    hint = "write names above columns, and export all rows"
    return InputError(what, where=str(path), found=found, needed=needed, hint=hint)


def number_in(cell: str, where: str, needed: str, hint: str) -> float:
    """Return the finite number in a cell, with a decimal point."""
    try:
        value = float(cell)
    except ValueError:
        value = math.inf
    if not math.isfinite(value):
        found = repr(cell.strip()[:40])
        raise InputError("not a number", where=where, found=found, needed=needed, hint=hint)
    return value


def summaries(labels: Sequence[str]) -> set[str]:
    """Return the names of rows or columns that summarise or count others."""
    words = {label: re.findall(r"[^\W_]+|∅", label) for label in labels}
    ends = {label: ["".join(own), *own[:1], *own[-1:]] for label, own in words.items()}
    found = {label for label, own in ends.items() if any(is_word("summary", w) for w in own)}
    beside = {label for label in words if is_word("beside", label)}
    return found | {label for label in beside if found or labels.count(label) > 1}


def are_units(row: Row) -> bool:
    """Whether a row holds units alone, as below a heading: not only in its first cell, a name."""
    first, *others = (word.strip("[]()") for word in _small(row))
    is_head = first in ("unit", "units", "einheit", "unité") or is_word("unit", first)
    are = [is_word("unit", word) for word in others]
    return is_head and all(are) and any(not is_word("nothing", word) for word in others)


def stated_unit(cells: Iterable[str], sizes: Sizes) -> str:
    """Return the unit in brackets, after "in", alone in a cell; "" for none, "cm or m" for two."""
    found = words_of("stated").findall(";".join(["", *cells, ""]))
    return " or ".join(sorted({unit_of(word) for words in found for word in words} & {*sizes}))


def left_out(path: Path, taken: str, kinds: dict[str, Sequence[str]]) -> tuple[Finding, ...]:
    """Return the finding of what was not taken from a table, none where all of it was."""
    parts = [f"{kind} {in_short(list(dict.fromkeys(own)))}" for kind, own in kinds.items() if own]
    text = f"From {path.name} come {taken} alone; left out: {'; '.join(parts)}."
    found = Finding(Code.TABLE_PARTLY_READ, About(files=[path.name]), text)
    return (found,) if parts else ()


def quantity_in(label: str, *, in_title: bool = False) -> tuple[str, str]:
    """Return the quantity that a label speaks of, and its other words, with … for the quantity.

    "" where it names none, or several; "other", "label": see ``words.toml``.
    """
    pattern = words_of("quantity")
    plain = unicodedata.normalize("NFKC", label)  # T\u2083\u2080 is T30
    text = words_of("seconds").sub(" ", plain.replace("±", " ± "))
    found = {str(m.lastgroup) for m in pattern.finditer(text)}
    named = found - {"other", "label"}
    signs = {"other": " "} | dict.fromkeys(named, " … ")
    plain = pattern.sub(lambda m: signs.get(str(m.lastgroup), m[0]), text)
    rest = " ".join(re.findall(r"[^\W_]+|[…|∅]", plain))
    if len(named) == 1 and not ("other" in found and named <= {*TIMES}):
        return named.pop(), rest
    if "other" in found and len(named) < 2 and (named or not in_title or not rest):
        return "other", rest
    return "label" if found == {"label"} and not in_title else "", rest


class BandRow(NamedTuple):
    """What stands of one quantity in one row, or in one column where bands are rows."""

    where: str
    names: tuple[str, ...]
    quantity: str  # "T30" and the like, "" where the table does not say
    rest: str  # of its names, with … for the quantity
    section: str  # the quantity of the title or the column
    cells: dict[float, tuple[str, str]]  # by band in Hz, with its place in messages
    unit: str  # "s" or "ms", "" where the table does not say
    sheet: Sheet

    def values(self, centres_hz: Iterable[float], sizes: Sizes = SECONDS) -> FloatArray:
        """Return the numbers, shape (n_bands,), NaN for none; `sizes` of units, the usual first."""
        unit = self.unit if self.unit in sizes else next(iter(sizes))
        cells = (self.cells.get(hz, ("", "")) for hz in centres_hz)
        return np.array([self.sheet.value(cell, unit, sizes, where) for cell, where in cells])


class _Bands(NamedTuple):
    """A heading of bands."""

    naming: list[int]  # columns that name a row
    at: dict[int, tuple[str, float]]  # by column, its quantity and its band in Hz
    labels: list[str]
    quantity: str  # of the columns that name


def band_rows(path: Path, what: str, names: Sequence[str] = ()) -> tuple[list[BandRow], list[str]]:
    """Return rows, and columns left out, of a table with a column for each band.

    `names`: kinds of the columns that name a row; without, those before the bands do, and bands may
    be rows as well. A title names quantity and unit of the rows below that do not name their own.
    """
    sheet = read_sheet(path, what)
    rows = sheet.rows if names else _bands_across(sheet, path)
    headings = [_bands(row, names, sheet) for row in rows]
    most = max((len(own.at) for own in headings if own), default=0)
    heading: _Bands | None = None
    found, others = list[BandRow](), list[str]()
    section, title = ("", ""), None  # quantities and units of time
    for row, own in zip(rows, headings, strict=True):
        is_new = heading is None or title or (own and own.at == heading.at)
        # no row of times in s, or of levels, looks like this
        is_sure = own and own.quantity in (*TIMES, "C50", "C80", "G") and section[1] != "ms"
        if own and (is_sure or (is_new and 2 * len(own.at) >= most)):
            unit = stated_unit((row.cells[i] for i in (*own.naming, *own.at)), SECONDS)
            section = _filled((own.quantity, unit), title or section)
            heading, title = own, None
            others += [c for i, c in enumerate(own.labels) if c and i not in (*own.naming, *own.at)]
        elif heading and are_units(row):
            section = _filled(("", stated_unit(row.cells, SECONDS)), section)
        elif row.is_remark and (names or sheet.numbers(row.cells)):
            continue  # a row that somebody took out
        elif heading and (names or any("".join(row.cells[i : i + 1]) for i in heading.at)):
            # a title that names nothing may be that of some positions
            section, title = _filled(title or ("", ""), section), None
            found += _of_row(row, heading, section, sheet)
        else:
            unit = stated_unit(row.cells, SECONDS)
            named = quantity_in(" ".join(row.cells), in_title=True)[0], unit
            if any(named) or not row.is_remark:
                title = _filled(named, title or ("", ""))
    if not found:
        what = f"a {what} without {'values' if heading else 'bands'}"
        raise lacking(path, what, sheet.rows, [*names, "125, 250, ..."])
    return _called(found), others


def _called(rows: list[BandRow]) -> list[BandRow]:
    """Return rows, those as of their section that may be positions: R10, G, or C50 beside C1."""
    series = {r.names[0][:-1] for r in rows if not r.quantity and r.names[0][-1:].isdigit()}
    plain = [
        row._replace(quantity=row.section, rest=" ".join(row.names))
        if row.quantity in ("", "label", *(n.upper() for n in row.names if len(n) == 1))
        or (row.names[0][-1:].isdigit() and row.names[0].rstrip(digits) in series)
        else row
        for row in rows
    ]
    # unless others there are called by times
    sure = {row.section for row in plain if row.quantity in TIMES and "…" in row.rest}
    return [row if row.section in sure else own for row, own in zip(rows, plain, strict=True)]


def _filled(named: tuple[str, str], other: tuple[str, str]) -> tuple[str, str]:
    return named[0] or other[0], named[1] or other[1]


def _of_row(row: Row, heading: _Bands, section: tuple[str, str], sheet: Sheet) -> Iterator[BandRow]:
    """Yield what a row holds of each quantity."""
    cells = row.cells + [""] * (len(heading.labels) - len(row.cells))
    naming, at, labels, _ = heading
    if 0 in at and len(cells) > len(labels) and not sheet.number(cells[0]):
        # names without a heading of their own
        naming, at, labels = [0], {i + 1: own for i, own in at.items()}, ["", *labels]
    blank = [c for c, label in zip_longest(cells, labels, fillvalue="") if not label]
    if sheet.numbers(c for c in blank if c not in cells[:1]):
        what, needed = "a table with more values than bands", f"{len(at)}, one for each centre"
        hint = "decimal commas make two cells of one number: write a point, or semicolons"
        n = f"{len(cells) - len(naming)}"
        raise InputError(what, where=row.where, found=n, needed=needed, hint=hint)
    names = tuple(cells[i] for i in naming) or ("",)
    stating = [c for c in cells if c in SECONDS] or [n for n in names if not is_word("unit", n)]
    unit = stated_unit(stating, SECONDS) or section[1]
    own, rest = quantity_in(" | ".join(filter(None, names)))
    of = " ".join(filter(None, (names[-1], *names[:-1])))
    columns: dict[str, dict[float, tuple[str, str]]] = {}
    for i, (column, hz) in at.items():
        place = row.where if "column" in row.where else f"{row.where}, column {i + 1}"
        columns.setdefault(column, {})[hz] = (cells[i], f"{place} ({of} at {hz:g} Hz)")
    for column, by_band in columns.items():
        of_column = (column or own, rest, column or section[0])
        yield BandRow(row.where, names, *of_column, by_band, unit, sheet)


def _bands(row: Row, names: Sequence[str], sheet: Sheet) -> _Bands | None:
    """Return a row as a heading of bands, None where it is none."""
    words = _small(row)
    naming = [next((i for i, w in enumerate(words) if is_word(n, w)), -1) for n in names]
    at = {
        i: ("" if sheet.number(words[i]) else quantity_in(words[i])[0], hz)
        for i, hz in enumerate(_centres_hz(words, is_in_khz="khz" in words[0]))
        if hz and i not in naming
    }
    first = next(i for i, word in enumerate(words) if word)
    others = [w for i, w in enumerate(words) if w and i not in (*at, *naming)]
    is_data = bool(set(sheet.numbers(others)) - set(_BELOW) or (first in at and others))
    n, n_different = len(at), len(set(at.values()))
    is_data |= n_different < n and bool(quantity_in(words[0])[0])  # Ts of 125, 125 and 80 ms
    if -1 in naming or (not names and (is_data or n_different < max(1 + (first in at), min(n, 2)))):
        return None
    if n_different < max(n, 1):
        what = f"a table {'whose centres stand twice' if at else 'without bands'}"
        found, hint = ", ".join(row.cells)[:80], "write each band once, as 500, 500 Hz or 1 kHz"
        needed = f"{', '.join([*names, '125, 250'])}, ...: nominal centres in Hz"
        raise InputError(what, where=row.where, found=found, needed=needed, hint=hint)
    naming = naming or list(range(min(at)))
    quantity, _ = quantity_in(" | ".join(row.cells[i] for i in naming), in_title=True)
    return _Bands(naming, at, row.cells, quantity)


def _centres_hz(labels: Sequence[str], *, is_in_khz: bool = False) -> list[float | None]:
    """Return the nominal centres that labels are, as 500, 500 Hz, 1 kHz, 1k25, 1.250 or 1258.9."""
    found: list[tuple[float | None, float | None]] = []
    for label in labels:
        plain = re.sub(r"(?<![\d.,])(\d+)k(\d+)", r"\1.\2k", words_of("quantity").sub("", label))
        match = words_of("centre").fullmatch(plain)
        number, k = match.groups() if match else ("0", "")
        kilo = 1000.0 if k or is_in_khz else 1.0
        hz = kilo * float(number.replace(",", "."))
        grouped_hz = kilo * float(re.sub("[.,]", "", number)) if _GROUPED.fullmatch(number) else hz
        found.append((_nominal_hz(hz), _nominal_hz(grouped_hz)))
    # 1.250 is 1250 where it cannot be 1.25, and then 12.500 beside it is 12500
    has_groups = any(plain is None and grouped for plain, grouped in found)
    return [grouped if has_groups else plain for plain, grouped in found]


def _nominal_hz(hz: float) -> float | None:
    near = min(THIRD_OCTAVES_HZ, key=lambda nominal: abs(hz - nominal))
    # exact mid-bands lie 1 % beside nominal ones, those of base two 1.7 %, and so do years
    return near if abs(hz / near - 1.0) <= 0.017 and not 2000.0 < hz < 2040.0 else None


def _bands_across(sheet: Sheet, path: Path) -> list[Row]:
    """Return the rows of a table with bands in columns, those turned that have them in rows.

    A band that stood already begins another table of the same columns.
    """
    named = [row.cells for row in sheet.rows if not are_units(row)]
    heads = {i for cells in named for i, cell in enumerate(cells) if is_word("frequency", cell)}
    ways = {column: _bands_below(sheet, column) for column in (0, *sorted(heads))}
    column, below = max(ways.items(), key=lambda way: len(way[1]) - way[1].count(None))
    n_below = len(below) - below.count(None)
    across = [_bands(r, (), sheet) for r, hz in zip(sheet.rows, below, strict=True) if hz is None]
    if n_below < (1 if heads else 2) or max((len(a.at) for a in across if a), default=0) >= n_below:
        return sheet.rows
    turned: list[Row] = []
    head, above, block = list[str](), list[Row](), dict[float, Row]()
    for row, hz in [*zip(sheet.rows, below, strict=True), (Row("", []), None)]:
        if block and (hz in block or (hz is None and len(sheet.numbers(row.cells)) < 2)):
            n = max(len(own.cells) for own in block.values())
            head = _head_of(n, above, sheet) or head
            labels = [*head, *[""] * (n - len(head))]
            turned += [*above, *_turned(labels, column, block, sheet, path)]
            above, block = [], {}
        if hz:
            block[hz] = row
        elif not block:
            above.append(row)
    return turned


def _bands_below(sheet: Sheet, column: int) -> list[float | None]:
    """Return the band of each row by one column, None where it has none or nothing else."""
    labels = ["".join(_small(row)[column : column + 1]) for row in sheet.rows]
    centres = _centres_hz(labels, is_in_khz=any("khz" in label for label in labels))
    own = [len([c for c in row.cells if c]) > 1 and not row.is_remark for row in sheet.rows]
    return [hz if is_one else None for hz, is_one in zip(centres, own, strict=True)]


def _head_of(n: int, above: list[Row], sheet: Sheet) -> list[str]:
    """Return the last line of words above rows that has as many cells, with units behind them.

    Room EQ Wizard writes commas between its headings, and blanks between the values below.
    """
    units = [""] * n
    for at, row in reversed(list(enumerate(above))):
        if are_units(row):
            units = [*row.cells, *units]
            continue
        text = re.sub(r"^\W*format is\s+", "", row.text, flags=re.IGNORECASE)
        ways = [next(iter(_split(text, s, "")))[1] for s in _SEPARATORS] if text else []
        for cells in (row.cells, *ways):
            is_same = len(cells) == n or (sheet.separator.strip() and 1 < len(cells) < n)
            if is_same and not any(sheet.number(c) for c in cells if c):
                groups = [*above[at - 1].cells, *[""] * n] if at else []
                del above[at:]  # not a title
                if len([c for c in groups if quantity_in(c)[0]]) > 1:  # of columns below each
                    filled: Iterable[str] = accumulate(groups, lambda last, own: own or last)
                    cells = [f"{g} {c}".strip() for g, c in zip(filled, cells, strict=False)]
                return [f"{c} {unit}".strip() for c, unit in zip(cells, units, strict=False)]
    return []


def _turned(
    labels: list[str], column: int, block: dict[float, Row], sheet: Sheet, path: Path
) -> Iterator[Row]:
    """Yield a heading of bands, and each column of numbers of a block as a row."""
    where = next(iter(block.values())).where
    corner = re.sub("khz", "Hz", labels[column], flags=re.IGNORECASE)
    yield Row(where, [corner, *(f"{hz:g}" for hz in block)])
    for i, label in enumerate(labels[column + 1 :], start=column + 1):
        cells = ["".join(row.cells[i : i + 1]) for row in block.values()]
        if sheet.numbers(cells) and not label and len(labels) > column + 2:
            what, hint = "columns without a heading", "name them in a line above: Hz, T30 [s], ..."
            needed, found = "bands and one column, or names of columns", f"{len(labels)} columns"
            raise InputError(what, where=where, found=found, needed=needed, hint=hint)
        if sheet.numbers(cells) and not is_word("frequency", label):
            yield Row(f"{path}, column {i + 1}", [label, *cells])


def _sheet_rows(content: bytes, where: str) -> Iterator[tuple[int, list[str]]]:
    """Yield number and cells of each row of a workbook's first sheet."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as book:
            if sum(e.file_size for e in book.infolist()) > unpacked_limit_bytes(len(content)):
                raise ValueError("it unpacks to more than is read")
            names = book.namelist()
            texts = []
            if "xl/sharedStrings.xml" in names:
                strings = _tree(book.read("xl/sharedStrings.xml"))
                texts = [_text(item) for item in strings.iter(f"{_MAIN}si")]
            sheet = _tree(book.read(_first_sheet(book)))
        for number, row in enumerate(sheet.iter(f"{_MAIN}row"), start=1):
            cells: list[str] = []
            for cell in row.iter(f"{_MAIN}c"):
                column = _column(cell.get("r", ""), len(cells))
                cells += [""] * (column + 1 - len(cells))
                cells[column] = _cell(cell, texts)
            yield int(row.get("r", number)), cells
    except (*DAMAGE, ElementTree.ParseError) as error:
        what, needed = "this is not an Excel workbook with a table", "a .xlsx file, its table first"
        found, hint = f"{type(error).__name__}: {error}", "save the sheet as CSV, or copy its cells"
        found = " ".join(found.split())[:200]
        raise InputError(what, where=where, found=found, needed=needed, hint=hint) from error


def _tree(content: bytes) -> Any:
    """Return the root of an XML text; one with declarations of its own may unfold to anything."""
    if b"<!" in content:
        raise ValueError("XML with declarations, which no workbook has")
    return ElementTree.fromstring(content)


def _first_sheet(book: zipfile.ZipFile) -> str:
    """Return the part that is the first sheet of a workbook, as its lists of sheets and parts say.

    Sheets that were moved or deleted have other numbers than their places.
    """
    first = _tree(book.read("xl/workbook.xml")).find(f".//{_MAIN}sheet")
    own = {key.rpartition("}")[2]: value for key, value in first.attrib.items()}
    parts = _tree(book.read("xl/_rels/workbook.xml.rels"))
    target = str({part.get("Id"): part.get("Target") for part in parts}[own["id"]])
    return target.lstrip("/") if target.startswith("/") else f"xl/{target}"


def _column(reference: str, following: int) -> int:
    """Return the number of a cell's column, from 0; the following one where it names none."""
    column = 0
    for letter in re.findall(r"[A-Z]", reference):
        column = 26 * column + ord(letter) - ord("A") + 1
    if column > _MOST_COLUMNS:
        raise ValueError(f"a cell {reference[:20]}")
    return column - 1 if column else following


def _text(item: Any) -> str:
    return "".join(part.text or "" for part in item.iter(f"{_MAIN}t"))


def _cell(cell: Any, texts: list[str]) -> str:
    """Return a cell as text; a number as it is stored, which is with a decimal point."""
    if cell.get("t") == "inlineStr":
        return _text(cell)
    value = cell.find(f"{_MAIN}v")
    text = "" if value is None or value.text is None else str(value.text)
    if cell.get("t") == "s" and text:
        return texts[int(text)]
    # a fourth decimal, so that its point is none of thousands; column A holds names
    is_name = cell.get("r", "A").startswith("A")
    return text if is_name else re.sub(r"\.\d{3}$", r"\g<0>0", text)
