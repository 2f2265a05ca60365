"""Tables of strangers, read by their headings: text of any separator, or an Excel workbook.

Titles above a heading, units below it, another order and more columns than needed do no harm.
Numbers have either decimal mark, and marks for "not evaluated" are no value.
"""

from __future__ import annotations

import io
import math
import re
import zipfile
from collections.abc import Iterable, Iterator, Sequence
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
_MAIN = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}"
_MOST_COLUMNS = 16_384  # of a sheet of Excel
_SEPARATORS = (";", "\t", ",", "  ", " ")
_LOOKED_AT = 400  # lines, by which the separator is known
_DIGITS = r"[-+\u2212]?(?:\d+(?:['\u2019 \xa0\u202f]\d{3})*(?:[.,]\d+)*[.,]?|[.,]\d+)(?:e[-+]?\d+)?"
_NUMBER = re.compile(rf"({_DIGITS})\s*([^\W\d_]{{0,4}}|%)", re.IGNORECASE)
_GROUPED = re.compile(r"[-+]?[1-9]\d{0,2}([.,]\d{3})+")
_NOTHING = re.compile(
    r"[-\u2013—_.*?/\s]*|n\W?/?\W?[av]\.?|nan|null|none|k\W*a\W*|[-+]?1\.#\w+|#\S+",
    re.IGNORECASE,
)  # also what C and spreadsheets write of 0/0
_UNIT = re.compile(r"[\[(]?(s|sec\w*|ms|k?hz|db|%|m|mm|cm|ft|in|deg|°|rad|-|)[\])]?")


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
        if _NOTHING.fullmatch(cell):
            return math.nan, ""
        match = _NUMBER.fullmatch(cell)
        value = math.nan if match is None else _as_float(match[1], self.decimal)
        return None if match is None or math.isnan(value) else (value, match[2].lower())


def _as_float(digits: str, decimal: str) -> float:
    """Return a number with either mark for decimals or for groups; NaN for none."""
    plain = re.sub(r"['\u2019 \xa0\u202f]", "", digits).replace("\u2212", "-")
    marks = re.findall("[.,]", plain)
    if marks:
        last, is_grouped = marks[-1], bool(_GROUPED.fullmatch(plain))
        alike = len(set(marks)) == 1
        if (alike and len(marks) > 1 and not is_grouped) or (not alike and marks.count(last) > 1):
            return math.nan
        groups = alike and is_grouped and (len(marks) > 1 or decimal not in ("", last))
        plain = re.sub("[.,]", "", plain) if groups else plain
        plain = plain.replace("," if last == "." else ".", "").replace(",", ".")
    return float(plain)


def read_sheet(path: Path, what: str, separator: str = "") -> Sheet:
    """Return the rows of a table; of a workbook (``.xlsx``) those of the first sheet.

    Without a `separator` it is the one between which most numbers stand, and semicolons and tabs
    before commas, so that commas are those of decimals. `what` is what the file is called in
    messages: "table of positions".
    """
    is_book = path.suffix.lower() == ".xlsx"
    lines: list[str] = []
    if is_book:
        separator, found = "\t", _sheet_rows(read_bytes(path, what, most="text_bytes"), str(path))
    else:
        text = read_text(path, what)
        lines = text.split("\n")
        if stated := re.fullmatch(r'"?sep=(.)"?\s*', lines[0]):
            separator, lines[0] = stated[1], ""
        separator = separator or _separator(lines[:_LOOKED_AT])
        found = _split("\n".join(lines), separator, str(path))
    rows = []
    for number, cells in found:
        own = [cell.strip() for cell in cells]
        if any(own):
            raw = lines[number - 1] if number <= len(lines) else ""
            is_remark = bool(re.match(r"#|%|//", own[0]))
            rows.append(Row(f"{path}, line {number}", own, raw, is_remark))
    decimals = {mark for row in rows for cell in row.cells for mark in _decimal(cell)}
    return Sheet(separator, rows, "".join(decimals) if len(decimals) == 1 and not is_book else "")


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


def _decimal(cell: str) -> str:
    """Return the mark of decimals that a number has beyond doubt, "" without such."""
    match = _NUMBER.fullmatch(cell)
    marks = re.findall("[.,]", match[1]) if match else []
    if not match or not marks or (len(set(marks)) == 1 and _GROUPED.fullmatch(match[1])):
        return ""
    return str(marks[-1])


def _words(cell: str) -> str:
    return " ".join(cell.casefold().split())


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


def table_lines(path: Path, what: str, names: Sequence[str], separator: str = "") -> list[Line]:
    """Return the rows below a heading that has all of some columns, by patterns of their names.

    A later heading replaces it; rows above it are left out.
    """
    rows = read_sheet(path, what, separator).rows
    heading: list[str] | None = None
    lines = []
    for where, cells, _, is_remark in rows:
        words = [_words(cell) for cell in cells]
        if all(any(re.fullmatch(name, word) for word in words) for name in names):
            heading = words
        elif heading is not None and not is_remark:
            filled = cells + [""] * (len(heading) - len(cells))
            lines.append(Line(where, heading, filled))
    if not lines:
        raise without(path, what, rows, names, "values" if heading else "a heading")
    return lines


def without(
    path: Path, what: str, rows: Sequence[Row], names: Sequence[str], lacking: str
) -> InputError:
    """Return the refusal of a table, with its first words."""
    first = next((" ".join(row.text.split() or row.cells) for row in rows), "")[:60]
    return InputError(
        f"a {what} without {lacking}",
        where=str(path),
        found=f"{len(rows)} line{'' if len(rows) == 1 else 's'}, the first {first!r}",
        needed=f"a line that names the columns {', '.join(names)}, and lines of values",
        hint="write names above columns, and export all rows",
    )


def number_in(
    cell: str, where: str, needed: str, hint: str = "leave the cell empty where nothing is known"
) -> float:
    """Return the finite number in a cell, with a decimal point."""
    try:
        value = float(cell)
    except ValueError:
        value = math.inf
    if not math.isfinite(value):
        found = repr(cell.strip()[:40])
        raise InputError("not a number", where=where, found=found, needed=needed, hint=hint)
    return value


# What rows and columns are called that hold no position of their own; the last are such beside
# another one only.
_SUMMARY = re.compile(
    r"averag.*|standard(dev|abw|av|af|err).*|std.*|stdev.*|stabw.*|mittel.*|mean.*|minim.*|maxim.*|"
    r"m[eé]dian.*|medelv.*|anzahl|aantal|count|varian.*|moyenn.*|[eé]cart.*|promedi.*|desv.*|devst.*|"
    r"gemiddeld.*|gj?enn?o?msnitt.*|keski(arv|haj).*|średni.*|odchyl.*|průměr.*|streuung.*|uncert.*|"
    r"quartil.*|percentil.*|confiden.*|arithm.*|avg|sd|min|max|mw|rms|cv|ø|∅|summe"
)
_BESIDE = re.compile(r"[nskmu]|nr|sum|total|media|range|number|limit|target|soll|\u03c3")


def are_summaries(labels: Sequence[str]) -> list[bool]:
    """Return which rows or columns, by their names, summarise or count others."""
    words = [re.findall(r"[^\W\d_]+|∅", label.casefold()) for label in labels]
    found = [any(map(_SUMMARY.fullmatch, ["".join(own), *own[:1], *own[-1:]])) for own in words]
    return [
        f or (any(found) and bool(_BESIDE.fullmatch("".join(own))))
        for f, own in zip(found, words, strict=True)
    ]


def are_units(cells: Iterable[str]) -> bool:
    """Whether a row holds units alone, as below a heading."""
    words = [_words(cell).strip("[]()") for cell in cells if cell]
    own = words[1:] if words and words[0] in ("unit", "units", "einheit", "unité", "-") else words
    return any(re.search(r"\w", word) for word in own) and all(map(_UNIT.fullmatch, own))


# Quantities by words that stand for them, the times of decay in the order in which they are taken;
# words of one letter, and the last, are none in titles.
TIMES = {
    "T30": "t30 rt30",
    "T20": "t20 rt20",
    "T": "rt rt60 t60 topt t60m t reverberationtime nachhallzeit nachhall reverberation",
    "T15": "t15 rt15",
    "T10": "t10 rt10",
    "EDT": "edt edt10 earlydecaytime",
}
_OTHERS = {
    "C50": "c50",
    "C80": "c80 clarity klarheitsmass klarheitsmaß",
    "D50": "d50 definition deutlichkeit deutlichkeitsgrad",
    "TS": "ts centretime centertime schwerpunktzeit",
    "G": "g strength",
    "another quantity": "c7 c20 c35 d80 lf lfc lf80 lfc80 jlf jlfc iacc sti stipa rasti alcons spl",
    "something else": "leq laeq inr snr pnr br tr st1 st2 stearly stlate corr correlation curvature"
    " xi r r2 n h bw bandwidth noise alpha temperature humidity toptstart toptend nonlinearity",
}
OTHERS = ("another quantity", "something else")
_QUANTITIES = {w: q for q, words in {**TIMES, **_OTHERS}.items() for w in words.split()}
_WITH_NUMBER = re.compile(r"(?<![^\W_])(edt|rt|lfc?|t|c|d|st)[\s_]*\(?(\d\d?)\)?(?![^\W_])")
_FREQUENCIES = re.compile(
    r"(.*fr[eé][qc]\w*|f|fc|fm|band\w*|k?hz|okta?v\w*|octav\w*|terz\w*|third\w*)\b.*"
)
_CENTRE = re.compile(
    r"(?:(?:1/[13]|oct\w*|okt\w*|terz\w*|third|band|at|bei)\b|(?:freq|fc?|hz)(?=\W*\d)|[\W_])*"
    r"(\d+(?:[.,]\d+)?)\s*(k?)(\d{0,2})\s*(?:hz)?[\W_]*(?:oct\w*|okt\w*|terz\w*|band|m?s)?\W*"
)
_QUANTITY = re.compile(r"(?<![^\W_])(edt|r?t[\W_]?\d\d|rt|c[\W_]?[58]0|d[\W_]?50|ts)(?![^\W_])")
_BELOW = ("8", "10", "12.5", "12,5", "16", "20")  # bands that are not used
_NEAR = 0.017  # by which exact mid-bands, of base two as well, lie beside nominal ones


class BandRow(NamedTuple):
    """What stands of one quantity in one row, or in one column where bands are rows."""

    where: str
    names: tuple[str, ...]
    quantity: str  # "T30" and the like, "" where the table does not say
    rest: str  # of its names without the quantity
    cells: dict[float, tuple[str, str]]  # by band in Hz, with its place in messages
    is_in_ms: bool
    sheet: Sheet

    @property
    def has_values(self) -> bool:
        """Whether some cell holds a number other than 0."""
        known = [self.sheet.number(cell) for cell, _ in self.cells.values()]
        return any(k is not None and not math.isnan(k[0]) and k[0] != 0.0 for k in known)

    def placed(self, centres_hz: Iterable[float]) -> list[tuple[str, str]]:
        """Return the cell of each band, with its place in messages."""
        return [self.cells.get(hz, ("", "")) for hz in centres_hz]

    def values(self, centres_hz: Iterable[float]) -> FloatArray:
        """Return the numbers, shape (n_bands,), NaN for none; milliseconds as seconds."""
        found = []
        for cell, place in self.placed(centres_hz):
            known = self.sheet.number(cell)
            if known is None or known[1] not in ("", "s", "sec", "ms", "db", "%"):
                needed, hint = "a number, or an empty cell", "leave unknown cells empty"
                own = repr(cell[:40])
                raise InputError("not a number", where=place, found=own, needed=needed, hint=hint)
            found.append(known[0] / (1000.0 if known[1] == "ms" or self.is_in_ms else 1.0))
        return np.array(found)


class _Bands(NamedTuple):
    """A heading of bands."""

    naming: list[int]  # columns that name a row
    at: dict[int, tuple[str, float]]  # by column, its quantity and its band in Hz
    labels: list[str]
    in_ms: bool


def band_rows(path: Path, what: str, names: Sequence[str] = ()) -> tuple[list[BandRow], list[str]]:
    """Return rows, and columns left out, of a table with a column for each band.

    `names`: patterns of the columns that name a row; without, those before the bands do, and bands
    may be rows as well. A title names the quantity of the rows below that do not name their own.
    """
    sheet = read_sheet(path, what)
    heading: _Bands | None = None
    section, is_title, found, others = ("", False), False, list[BandRow](), list[str]()
    rows = sheet.rows if names else _bands_across(sheet, path)
    headings = [_bands(row, names, sheet) for row in rows]
    most = max((len(own.at) for own in headings if own), default=0)
    for row, own in zip(rows, headings, strict=True):
        filled = heading and any(row.cells[i : i + 1] not in ([], [""]) for i in heading.at)
        is_new = heading is None or is_title or (own and own.at == heading.at)
        if own and is_new and 2 * len(own.at) >= most:
            heading = own
            used = {*own.naming, *own.at}
            others += [label for i, label in enumerate(own.labels) if label and i not in used]
        elif row.is_remark or (heading and are_units(row.cells)):
            section = (section[0], section[1] or _is_in_ms(row.cells))
        elif heading and (filled or names):
            is_title = False
            found += _of_row(row, heading, section, sheet)
        else:
            before = section if is_title else ("", False)
            quantity, _ = quantity_in(" ".join(row.cells), in_title=True)
            section, is_title = (quantity or before[0], _is_in_ms(row.cells) or before[1]), True
    if heading is None or not found:
        lacking = "values" if heading else "bands"
        raise without(path, what, sheet.rows, [*names, "125, 250, ..."], lacking)
    # a position may be called G or T, and a quantity beside others
    if not any(len(row.names[0].strip()) > 1 and row.quantity for row in found):
        found = [r._replace(quantity="") if len(r.names[0]) == 1 else r for r in found]
    return found, others


def _of_row(
    row: Row, heading: _Bands, section: tuple[str, bool], sheet: Sheet
) -> Iterator[BandRow]:
    """Yield what a row holds of each quantity."""
    cells = row.cells + [""] * (len(heading.labels) - len(row.cells))
    if 0 in heading.at and len(cells) > len(heading.labels) and not sheet.number(cells[0]):
        heading = heading._replace(
            naming=[0],
            at={i + 1: band for i, band in heading.at.items()},
            labels=["", *heading.labels],
        )
    blank = [i for i, c in enumerate(cells) if c and not "".join(heading.labels[i : i + 1])]
    if any(sheet.number(cells[i]) and i not in heading.naming for i in blank):
        raise InputError(
            "a table with more values than bands",
            where=row.where,
            found=f"{len(cells) - len(heading.naming)}",
            needed=f"{len(heading.at)}, one for each centre",
            hint="decimal commas make two cells of one number: write a point, or semicolons",
        )
    names = tuple(cells[i] for i in heading.naming) or ("",)
    own, rest = quantity_in(" ".join(filter(None, names)))
    for column in dict.fromkeys(quantity for quantity, _ in heading.at.values()):
        of = " ".join(filter(None, (names[-1], *names[:-1])))
        by_band = {}
        for i, (quantity, hz) in heading.at.items():
            if quantity == column:
                place = row.where if "column" in row.where else f"{row.where}, column {i + 1}"
                by_band[hz] = (cells[i], f"{place} ({of} at {hz:g} Hz)")
        in_ms = heading.in_ms or section[1] or _is_in_ms(names)
        quantity = column or own or section[0]
        yield BandRow(row.where, names, quantity, rest, by_band, in_ms, sheet)


def _is_in_ms(cells: Iterable[str]) -> bool:
    return bool(re.search(r"[\[(]ms[\])]|\bin ms\b|(?<![^;\s])ms$", ";".join(cells).casefold()))


def quantity_in(label: str, *, in_title: bool = False) -> tuple[str, str]:
    """Return the quantity that a name or a title speaks of, and what else it says.

    "" where it names none, or several; what is in dB or percent is at least no time.
    """
    text = _WITH_NUMBER.sub(r" \1\2 ", label.casefold())
    is_level = bool(re.search(r"[\[(/]\s*(db|%)|\bin (db|%)", text))
    words = re.findall(r"[^\W_]+", re.sub(r"[\[(](m?s|sec|db|%|k?hz|-|1)[\])]", " ", text))
    found: dict[str, list[str]] = {}
    for n in (3, 2, 1):
        for i in range(len(words) - n + 1):
            quantity = _QUANTITIES.get("".join(words[i : i + n]), "")
            plain = len(words[i]) > 1 and quantity != "something else"
            if quantity and (plain or (not in_title and (len(words) == 1 or len(words[i]) > 1))):
                found.setdefault(quantity, words[i : i + n])
    if len(found) != 1:
        return "something else" if is_level and not found else "", " ".join(words)
    ((quantity, own),) = found.items()
    rest = " ".join(w for w in words if w not in own)
    return "something else" if is_level and quantity in TIMES else quantity, rest


def _bands(row: Row, names: Sequence[str], sheet: Sheet) -> _Bands | None:
    """Return a row as a heading of bands, None where it is none."""
    words = [_words(cell) for cell in row.cells]
    naming = [next((i for i, w in enumerate(words) if re.fullmatch(n, w)), -1) for n in names]
    if -1 in naming:
        return None
    centres = _centres_hz(words, is_in_khz="khz" in "".join(words[:1]))
    at = {
        i: ("" if sheet.number(words[i]) else quantity_in(words[i])[0], hz)
        for i, hz in enumerate(centres)
        if hz and i not in naming
    }
    first = next(i for i, word in enumerate(words) if word)
    others = [w for i, w in enumerate(words) if w and i not in at and i not in naming]
    is_data = any(sheet.number(w) and w not in _BELOW for w in others) or (first in at and others)
    if not names and (
        not at
        or is_data
        or len(set(at.values())) < min(len(at), 2 if first in at or len(at) > 1 else 1)
    ):
        return None
    if not at or len(set(at.values())) < len(at):
        raise InputError(
            f"a table {'whose centres stand twice' if at else 'without bands'}",
            where=row.where,
            found=", ".join(row.cells)[:80],
            needed=f"{', '.join([*names, '125, 250'])}, ...: nominal centres in Hz",
            hint="write each band once, as 500, 500 Hz or 1 kHz",
        )
    return _Bands(naming or list(range(min(at))), at, row.cells, _is_in_ms(words))


def _centres_hz(labels: Sequence[str], *, is_in_khz: bool = False) -> list[float | None]:
    """Return the nominal centres that labels are, as 500, 500 Hz, 1 kHz, 1k25, 1.250 or 1258.9."""
    found: list[tuple[float | None, float | None]] = []
    for label in labels:
        match = _CENTRE.fullmatch(_QUANTITY.sub("", label))
        if match is None:
            found.append((None, None))
            continue
        digits, k, decimals = match.groups()
        kilo = 1000.0 if k or is_in_khz else 1.0
        plain = kilo * float(f"{digits.replace(',', '.')}{'.' * bool(decimals)}{decimals}")
        grouped = kilo * float(re.sub("[.,]", "", digits)) if _GROUPED.fullmatch(digits) else plain
        found.append((_nominal_hz(plain), _nominal_hz(grouped)))
    # 1.250 is 1250 where it cannot be 1.25, and then 12.500 beside it is 12500
    has_groups = any(plain is None and grouped for plain, grouped in found)
    return [grouped if has_groups else plain for plain, grouped in found]


def _nominal_hz(hz: float) -> float | None:
    near = min(THIRD_OCTAVES_HZ, key=lambda nominal: abs(math.log(max(hz, 1e-9) / nominal)))
    is_year = 2000.0 < hz < 2040.0
    return near if abs(hz / near - 1.0) <= _NEAR and not is_year else None


def _bands_across(sheet: Sheet, path: Path) -> list[Row]:
    """Return the rows of a table with bands in columns, those turned that have them in rows.

    A band that stood already begins another table of the same columns.
    """
    heads = {
        i for r in sheet.rows for i, c in enumerate(r.cells) if _FREQUENCIES.fullmatch(_words(c))
    }
    ways = {column: _bands_below(sheet, column) for column in (0, *sorted(heads))}
    column, banded = max(ways.items(), key=lambda way: len(way[1]) - way[1].count(None))
    n_below = len(banded) - banded.count(None)
    across = [_bands(r, (), sheet) for r, hz in zip(sheet.rows, banded, strict=True) if hz is None]
    if n_below < (1 if heads else 2) or max((len(a.at) for a in across if a), default=0) >= n_below:
        return sheet.rows
    turned: list[Row] = []
    head, above, block = Row("", []), list[Row](), dict[float, Row]()
    for row, hz in [*zip(sheet.rows, banded, strict=True), (Row("", []), None)]:
        numbers = [c for c in row.cells if c and sheet.number(c)]
        if block and (hz in block or (hz is None and len(numbers) < 2)):
            head = _head_of(block, above, sheet) or head
            turned += [*above, *_turned(head.cells, column, block, sheet, path)]
            above, block = [], {}
        if hz:
            block[hz] = row
        elif not block:
            above.append(row)
    return turned


def _bands_below(sheet: Sheet, column: int) -> list[float | None]:
    """Return the band of each row by one column, None where it has none or nothing else."""
    labels = [_words("".join(row.cells[column : column + 1])) for row in sheet.rows]
    centres = _centres_hz(labels, is_in_khz=any("khz" in label for label in labels))
    own = [len([c for c in row.cells if c]) > 1 and not row.is_remark for row in sheet.rows]
    return [hz if is_one else None for hz, is_one in zip(centres, own, strict=True)]


def _head_of(block: dict[float, Row], above: Sequence[Row], sheet: Sheet) -> Row | None:
    """Return the last line of words above rows that has as many cells, with units behind them.

    Room EQ Wizard writes commas between its headings, and blanks between the values below.
    """
    n, units = max(len(row.cells) for row in block.values()), list[str]()
    for row in reversed(above):
        if are_units(row.cells):
            units = row.cells
            continue
        text = re.sub(r"^\W*format is\s+", "", row.text, flags=re.IGNORECASE)
        ways = [next(iter(_split(text, s, "")))[1] for s in _SEPARATORS] if text else []
        for cells in (row.cells, *ways):
            is_same = len(cells) == n or (sheet.separator.strip() and 1 < len(cells) < n)
            if is_same and not any(sheet.number(c) for c in cells if c):
                both = [
                    f"{c.strip()} {u}" for c, u in zip(cells, [*units, *[""] * n], strict=False)
                ]
                return row._replace(cells=both)
    return None


def _turned(
    head: Sequence[str], column: int, block: dict[float, Row], sheet: Sheet, path: Path
) -> Iterator[Row]:
    """Yield a heading of bands, and each column of numbers of a block as a row."""
    n = max(len(row.cells) for row in block.values())
    labels = [*head, *[""] * (n - len(head))]
    if n > column + 2 and not any(labels):
        what, hint = "columns without a heading", "name them in a line above: Hz, T30 [s], ..."
        where, needed = (
            next(iter(block.values())).where,
            "bands and one column, or names of columns",
        )
        raise InputError(what, where=where, found=f"{n} columns", needed=needed, hint=hint)
    yield Row(next(iter(block.values())).where, ["", *(f"{hz:g}" for hz in block)])
    for i in range(column + 1, n):
        cells = ["".join(row.cells[i : i + 1]) for row in block.values()]
        if any(sheet.number(c) for c in cells if c) and not _FREQUENCIES.fullmatch(
            _words(labels[i])
        ):
            yield Row(f"{path}, column {i + 1}", [labels[i], *cells])


def left_out(path: Path, taken: str, kinds: dict[str, Sequence[str]]) -> tuple[Finding, ...]:
    """Return the finding of what was not taken from a table, none where all of it was."""
    parts = [f"{kind} {in_short(list(dict.fromkeys(own)))}" for kind, own in kinds.items() if own]
    if not parts:
        return ()
    text = f"From {path.name} come {taken} alone; left out: {'; '.join(parts)}."
    return (Finding(Code.TABLE_PARTLY_READ, About(files=[path.name]), text),)


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
    letters = re.match(r"[A-Z]*", reference)
    column = 0
    for letter in letters[0] if letters else "":
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
