"""Tables of strangers, read by their headings: text of any separator, or an Excel workbook.

Titles above a heading, units below it, another order and more columns than needed do no harm.
Numbers have either decimal mark, and marks for "not evaluated" are no value.
"""

from __future__ import annotations

import io
import math
import re
import tomllib
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from importlib.resources import files
from itertools import zip_longest
from pathlib import Path
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
_GROUPED = re.compile(r"[-+]?[1-9]\d{0,2}([.,]\d{3})+")
_BELOW = ("8", "10", "12.5", "12,5", "16", "20")  # bands that are not used


@cache
def words_of(kind: str) -> re.Pattern[str]:
    """Return the pattern of a kind of words, see ``words.toml``."""
    known = tomllib.loads(files("roomfit.files").joinpath("words.toml").read_text("utf-8"))
    if isinstance(known[kind], dict):
        own = "|".join(f"(?P<{name}>{'|'.join(ways)})" for name, ways in known[kind].items())
        return re.compile(rf"(?<![^\W_])(?:{own})(?![^\W_])")
    return re.compile("|".join(known[kind]))


def is_word(kind: str, label: str) -> bool:
    """Whether a label is a word of a kind."""
    return bool(words_of(kind).fullmatch(label))


def length_unit(word: str) -> str:
    """Return the unit that a word in small letters stands for, "" for none."""
    match = words_of("length").fullmatch(word)
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
        if is_word("nothing", cell.lower()):
            return math.nan, ""
        match = _NUMBER.fullmatch(cell)
        value = _as_float(match[1], self.decimal) if match else None
        return None if match is None or value is None else (value, match[2].lower())

    def numbers(self, cells: Iterable[str]) -> list[str]:
        """Return the cells that are numbers, marks of no value left out."""
        return [c for c in cells if (known := self.number(c)) and not math.isnan(known[0])]


def _as_float(digits: str, decimal: str) -> float | None:
    """Return a number with either mark for decimals or for groups."""
    plain = re.sub(_GROUP_MARKS, "", digits).replace("\u2212", "-")
    marks = re.findall("[.,]", plain)
    if _GROUPED.fullmatch(plain) and len(set(marks)) == 1:
        if len(marks) > 1 or decimal not in ("", marks[0]):
            return float(re.sub("[.,]", "", plain))
    elif marks and marks.count(marks[-1]) > 1:
        return None
    other = "," if marks[-1:] == ["."] else "."
    return float(plain.replace(other, "").replace(",", "."))


def _decimal(cell: str) -> str:
    """Return the mark of decimals that a number has beyond doubt, "" without such."""
    match = _NUMBER.fullmatch(cell)
    marks = re.findall("[.,]", match[1]) if match else []
    is_clear = match and marks and (len(set(marks)) > 1 or not _GROUPED.fullmatch(match[1]))
    return str(marks[-1]) if is_clear else ""


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
        if any(own):
            text = "" if is_book else lines[number - 1]
            is_remark = own[0].startswith(("#", "%", "//"))
            if is_remark and not separator.strip() and not own[0].strip("#%/"):
                own = own[1:] or [""]
            rows.append(Row(f"{path}, line {number}", own, text, is_remark))
    marks = {mark for row in rows for cell in row.cells if (mark := _decimal(cell))}
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


class Line(NamedTuple):
    """One row below a heading."""

    where: str  # file and line
    heading: list[str]  # in small letters
    cells: list[str]  # as many as the heading has, or more

    def cell(self, *begins: str) -> str:
        """Return the cell of the first column whose name begins so; "" where there is none."""
        found = (
            c for name, c in zip(self.heading, self.cells, strict=False) if name.startswith(begins)
        )
        return next(found, "")


def table_lines(path: Path, what: str, names: Sequence[str], separator: str) -> list[Line]:
    """Return the rows below a heading that has all of some columns, by patterns of their names.

    A later heading replaces it; rows above it are left out.
    """
    rows = read_sheet(path, what, separator).rows
    heading: list[str] | None = None
    lines = []
    for row in rows:
        words = _small(row)
        if all(any(re.fullmatch(name, word) for word in words) for name in names):
            heading = words
        elif heading is not None and not row.is_remark:
            filled = row.cells + [""] * (len(heading) - len(row.cells))
            lines.append(Line(row.where, heading, filled))
    if not lines:
        raise _lacking(path, what, rows, names, "values" if heading else "a heading")
    return lines


def _small(row: Row) -> list[str]:
    return [" ".join(cell.casefold().split()) for cell in row.cells]


def _lacking(
    path: Path, what: str, rows: Sequence[Row], names: Sequence[str], lacks: str
) -> InputError:
    """Return the refusal of a table without a heading, bands or values."""
    first = " ".join(rows[0].cells)[:60] if rows else ""
    found = f"{len(rows)} line{'' if len(rows) == 1 else 's'}, the first {first!r}"
    needed = f"a line that names the columns {', '.join(names)}, and lines of values"
    hint = "write names above columns, and export all rows"
    return InputError(
        f"a {what} without {lacks}", where=str(path), found=found, needed=needed, hint=hint
    )


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


def are_summaries(labels: Sequence[str]) -> list[bool]:
    """Return which rows or columns, by their names, summarise or count others."""
    words = [re.findall(r"[^\W\d_]+|∅", label.casefold()) for label in labels]
    ends = [["".join(own), *own[:1], *own[-1:]] for own in words]
    found = [any(is_word("summary", w) for w in own) for own in ends]
    beside = [any(is_word("beside", w) for w in own if len(w) > 1 or own[0] == w) for own in ends]
    return [f or (any(found) and b) for f, b in zip(found, beside, strict=True)]


def are_units(row: Row) -> bool:
    """Whether a row holds units alone, as below a heading."""
    words = [word.strip("[]()") for word in _small(row) if word]
    own = words[1:] if words and words[0] in ("unit", "units", "einheit", "unité", "-") else words
    return any(map(str.isalpha, own)) and all(is_word("unit", word) for word in own)


def left_out(path: Path, taken: str, kinds: dict[str, Sequence[str]]) -> tuple[Finding, ...]:
    """Return the finding of what was not taken from a table, none where all of it was."""
    parts = [f"{kind} {in_short(list(dict.fromkeys(own)))}" for kind, own in kinds.items() if own]
    text = f"From {path.name} come {taken} alone; left out: {'; '.join(parts)}."
    found = Finding(Code.TABLE_PARTLY_READ, About(files=[path.name]), text)
    return (found,) if parts else ()


def quantity_in(label: str, *, in_title: bool = False) -> tuple[str, str]:
    """Return the quantity that a name or a title speaks of, and what else it says.

    "" where it names none, or several; what is in dB or percent is at least "other".
    """
    pattern, text = words_of("quantity"), label.casefold()
    found = {str(m.lastgroup) for m in pattern.finditer(text)} - ({"label"} if in_title else set())
    named = found - {"other", "label"} or found
    rest = " ".join(re.findall(r"[^\W_]+", re.sub(r"[\[(]\w+[\])]", " ", pattern.sub(" ", text))))
    return named.pop() if len(named) == 1 else "", rest


class BandRow(NamedTuple):
    """What stands of one quantity in one row, or in one column where bands are rows."""

    where: str
    names: tuple[str, ...]
    quantity: str  # "T30" and the like, "" where the table does not say
    rest: str  # of its names without the quantity
    cells: dict[float, tuple[str, str]]  # by band in Hz, with its place in messages
    is_in_ms: bool
    sheet: Sheet

    def values(self, centres_hz: Iterable[float]) -> FloatArray:
        """Return the numbers, shape (n_bands,), NaN for none; milliseconds as seconds."""
        found = []
        for cell, place in (self.cells.get(hz, ("", "")) for hz in centres_hz):
            known = self.sheet.number(cell)
            if known is None or known[1] not in ("", "s", "sec", "ms", "db", "%"):
                own, needed = repr(cell[:40]), "a number, or an empty cell"
                hint = "leave the cell empty where nothing is known"
                raise InputError("not a number", where=place, found=own, needed=needed, hint=hint)
            found.append(known[0] / (1000.0 if known[1] == "ms" or self.is_in_ms else 1.0))
        return np.array(found)


class _Bands(NamedTuple):
    """A heading of bands."""

    naming: list[int]  # columns that name a row
    at: dict[int, tuple[str, float]]  # by column, its quantity and its band in Hz
    labels: list[str]


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
    quantity, in_ms, is_title, found, others = "", False, False, list[BandRow](), list[str]()
    for row, own in zip(rows, headings, strict=True):
        is_new = heading is None or is_title or (own and own.at == heading.at)
        if own and is_new and 2 * len(own.at) >= most:
            heading, in_ms = own, in_ms or _is_in_ms(row, (*own.naming, *own.at))
            others += [c for i, c in enumerate(own.labels) if c and i not in (*own.naming, *own.at)]
        elif row.is_remark or (heading and are_units(row)):
            in_ms = in_ms or _is_in_ms(row, heading.at if heading else ())
        elif heading and (names or any("".join(row.cells[i : i + 1]) for i in heading.at)):
            is_title = False
            found += _of_row(row, heading, quantity, sheet, in_ms=in_ms)
        else:
            before = (quantity, in_ms) if is_title else ("", False)
            quantity = quantity_in(" ".join(row.cells), in_title=True)[0] or before[0]
            in_ms, is_title = _is_in_ms(row, range(len(row.cells))) or before[1], True
    if not found:
        needed = [*names, "125, 250, ..."]
        raise _lacking(path, what, sheet.rows, needed, "values" if heading else "bands")
    # a position may be called G or T, and a quantity beside others
    if all(len(row.names[0]) == 1 for row in found if row.quantity):
        found = [row._replace(quantity="", rest=row.names[0]) for row in found]
    return found, others


def _is_in_ms(row: Row, columns: Iterable[int]) -> bool:
    """Whether some cells of a row say that values are in milliseconds."""
    label = ";".join(["", *(cell for i, cell in enumerate(_small(row)) if i in columns)])
    return bool(re.search(r"[\[(;]ms([\])]|\b)|\bin ms\b", label))


def _of_row(
    row: Row, heading: _Bands, section: str, sheet: Sheet, *, in_ms: bool
) -> Iterator[BandRow]:
    """Yield what a row holds of each quantity."""
    cells = row.cells + [""] * (len(heading.labels) - len(row.cells))
    naming, at, labels = heading
    if 0 in at and len(cells) > len(labels) and not sheet.number(cells[0]):
        # names without a heading of their own
        naming, at, labels = [0], {i + 1: own for i, own in at.items()}, ["", *labels]
    blank = [c for c, label in zip_longest(cells, labels, fillvalue="") if not label]
    if sheet.numbers(c for c in blank if c not in cells[:1]):
        raise InputError(
            "a table with more values than bands",
            where=row.where,
            found=f"{len(cells) - len(naming)}",
            needed=f"{len(at)}, one for each centre",
            hint="decimal commas make two cells of one number: write a point, or semicolons",
        )
    names = tuple(cells[i] for i in naming) or ("",)
    in_ms = in_ms or _is_in_ms(row, naming)
    own, rest = quantity_in(" ".join(filter(None, names)))
    for column in dict.fromkeys(quantity for quantity, _ in at.values()):
        of = " ".join(filter(None, (names[-1], *names[:-1])))
        by_band = {}
        for i, (quantity, hz) in at.items():
            if quantity == column:
                place = row.where if "column" in row.where else f"{row.where}, column {i + 1}"
                by_band[hz] = (cells[i], f"{place} ({of} at {hz:g} Hz)")
        yield BandRow(row.where, names, column or own or section, rest, by_band, in_ms, sheet)


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
    is_data = set(sheet.numbers(others)) - set(_BELOW) or (first in at and others)
    n, n_different = len(at), len(set(at.values()))
    if -1 in naming or (not names and (is_data or n_different < max(1 + (first in at), min(n, 2)))):
        return None
    if n_different < max(n, 1):
        raise InputError(
            f"a table {'whose centres stand twice' if at else 'without bands'}",
            where=row.where,
            found=", ".join(row.cells)[:80],
            needed=f"{', '.join([*names, '125, 250'])}, ...: nominal centres in Hz",
            hint="write each band once, as 500, 500 Hz or 1 kHz",
        )
    return _Bands(naming or list(range(min(at))), at, row.cells)


def _centres_hz(labels: Sequence[str], *, is_in_khz: bool = False) -> list[float | None]:
    """Return the nominal centres that labels are, as 500, 500 Hz, 1 kHz, 1k25, 1.250 or 1258.9."""
    found: list[tuple[float | None, float | None]] = []
    for label in labels:
        match = words_of("centre").fullmatch(words_of("quantity").sub("", label))
        digits, k, decimals = match.groups() if match else ("0", "", "")
        kilo = 1000.0 if k or is_in_khz else 1.0
        hz = kilo * float(digits.replace(",", ".") + (f".{decimals}" if decimals else ""))
        grouped_hz = kilo * float(re.sub("[.,]", "", digits)) if _GROUPED.fullmatch(digits) else hz
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
    heads = {i for r in sheet.rows for i, c in enumerate(_small(r)) if is_word("frequency", c)}
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
            turned += [
                *above,
                *_turned([*head, *[""] * (n - len(head))], column, block, sheet, path),
            ]
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
                del above[at:]  # not a title
                return [f"{c} {unit}".strip() for c, unit in zip(cells, units, strict=False)]
    return []


def _turned(
    labels: list[str], column: int, block: dict[float, Row], sheet: Sheet, path: Path
) -> Iterator[Row]:
    """Yield a heading of bands, and each column of numbers of a block as a row."""
    where = next(iter(block.values())).where
    if len(labels) > column + 2 and not any(labels):
        what, hint = "columns without a heading", "name them in a line above: Hz, T30 [s], ..."
        needed, found = "bands and one column, or names of columns", f"{len(labels)} columns"
        raise InputError(what, where=where, found=found, needed=needed, hint=hint)
    yield Row(where, ["", *(f"{hz:g}" for hz in block)])
    for i, label in enumerate(labels[column + 1 :], start=column + 1):
        cells = ["".join(row.cells[i : i + 1]) for row in block.values()]
        if sheet.numbers(cells) and not is_word("frequency", label.casefold()):
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
        raise InputError(
            "this is not an Excel workbook with a table",
            where=where,
            found=" ".join(f"{type(error).__name__}: {error}".split())[:200],
            needed="a file .xlsx whose first sheet holds the table",
            hint="save the sheet as CSV, or copy its cells as text",
        ) from error


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
    return texts[int(text)] if cell.get("t") == "s" and text else text
