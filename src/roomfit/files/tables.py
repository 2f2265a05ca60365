"""Tables of strangers as rows of cells: text with commas, semicolons or tabs, or an Excel workbook.

What a spreadsheet copies has tabs between its columns.
"""

from __future__ import annotations

import io
import math
import re
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from roomfit.base.door import csv_rows, read_bytes, read_text, unpacked_limit_bytes
from roomfit.base.errors import DAMAGE, InputError
from roomfit.base.typing import FloatArray

TABLE_SUFFIXES = (".csv", ".tsv", ".txt", ".xlsx")
"""Endings under which tables are offered to be dropped; every other one is read as text."""
_MAIN = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}"
_MOST_COLUMNS = 16_384  # of a sheet of Excel


def table_rows(
    path: Path, what: str, delimiter: str = ""
) -> tuple[str, list[tuple[int, list[str]]]]:
    """Return what stands between columns, and number and cells of each row that is not empty.

    Rows that begin with # are left out. Where `delimiter` is "", semicolons decide, or else tabs,
    so that commas are those of decimals. Of a workbook (``.xlsx``) it is the first sheet, as if
    with tabs. `what` is what the file is called in messages: "table of positions".
    """
    if path.suffix.lower() == ".xlsx":
        delimiter, rows = "\t", _sheet_rows(read_bytes(path, what, most="text_bytes"), str(path))
    else:
        text = read_text(path, what)
        bare = re.sub(r"^#.*", "", text, flags=re.MULTILINE)
        delimiter = delimiter or next((d for d in ";\t" if d in bare), ",")
        rows = csv_rows(text, str(path), delimiter)
    stripped = ((number, [cell.strip() for cell in cells]) for number, cells in rows)
    return delimiter, [(n, c) for n, c in stripped if any(c) and not c[0].startswith("#")]


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


def table_lines(path: Path, what: str, names: Sequence[str], delimiter: str = "") -> list[Line]:
    """Return the rows below a heading that has all of some columns, by patterns of their names.

    Without names the first row is the heading. A later heading replaces it; rows above it are left
    out. Commas of decimals are points where something else stands between columns.
    """
    delimiter, rows = table_rows(path, what, delimiter)
    heading: list[str] | None = None
    lines = []
    for number, cells in rows:
        words = [" ".join(cell.lower().split()) for cell in cells]
        begins = all(any(re.fullmatch(name, word) for word in words) for name in names)
        if begins and (names or heading is None):
            heading = words
        elif heading is not None:
            filled = cells + [""] * (len(heading) - len(cells))
            own = filled if delimiter == "," else [cell.replace(",", ".") for cell in filled]
            lines.append(Line(f"{path}, line {number}", heading, own))
    if not lines:
        raise InputError(
            f"a {what} {'without values' if heading else 'without a heading'}",
            where=str(path),
            found=f"{len(rows)} line{'' if len(rows) == 1 else 's'}",
            needed=f"a line that names the columns {', '.join(names)}, and lines of values",
            hint="write names above columns, and export all rows",
        )
    return lines


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


class BandRow(NamedTuple):
    """One row of a table whose columns are bands."""

    where: str
    names: tuple[str, ...]
    values: FloatArray  # (n_bands,); nan: an empty cell
    labels: list[str]  # of each value, in messages


def band_rows(
    path: Path, what: str, names: Sequence[str], unit: str = ""
) -> tuple[FloatArray, list[BandRow]]:
    """Return centres in Hz, and rows, of a table with a column for each band.

    `names` are of columns that name a row, without any the first one; `unit` may stand behind
    values.
    """
    lines = table_lines(path, what, names)
    heading = lines[0].heading
    naming = [heading.index(name) for name in names] or [0]
    centres = {
        i: _centre_hz(name, f"{path}, column {i + 1} of the heading")
        for i, name in enumerate(heading)
        if name and i not in naming
    }
    if not centres or np.any(np.diff([0.0, *centres.values()]) <= 0.0):
        raise InputError(
            f"a {what} {'whose centres do not rise' if centres else 'without bands'}",
            where=str(path),
            found=", ".join(heading)[:80],
            needed=f"{', '.join([*names, '125, 250'])}, ...: nominal centres in Hz, low to high",
            hint="write the bands in rising order, each once",
        )
    rows = []
    for where, _, cells in lines:
        own = tuple(cells[i] for i in naming)
        if any(cell for i, cell in enumerate(cells) if i not in (*naming, *centres)):
            raise InputError(
                f"a {what} has more values than bands",
                where=where,
                found=f"{len(cells) - len(naming)}",
                needed=f"{len(centres)}, one for each centre",
                hint="decimal commas make two cells of one number: write a point, or semicolons",
            )
        of = " ".join(filter(None, (own[-1], *own[:-1])))
        labels = [f"{where}, column {i + 1} ({of} at {hz:g} Hz)" for i, hz in centres.items()]
        values = [
            number_in(
                re.sub(f"{unit}$", "", cells[i]).rstrip(), place, "a number, or an empty cell"
            )
            if cells[i]
            else math.nan
            for i, place in zip(centres, labels, strict=True)
        ]
        rows.append(BandRow(where, own, np.array(values), labels))
    return np.array(list(centres.values())), rows


def _centre_hz(name: str, where: str) -> float:
    """Return a centre that is written as 500, 500 Hz or 1 kHz."""
    number = name.removesuffix("hz").rstrip()
    kilo = 1000.0 if number.endswith("k") else 1.0
    needed, hint = "a centre as 500, 500 Hz or 1 kHz", "leave out columns that are no bands"
    return kilo * number_in(number.removesuffix("k").replace(",", "."), where, needed, hint)


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
