"""Tables of strangers as rows of cells: text with commas, semicolons or tabs, or an Excel workbook.

What a spreadsheet copies has tabs between its columns.
"""

from __future__ import annotations

import io
import math
import re
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from roomfit.base.arguments import ARCHIVE_DAMAGE
from roomfit.base.door import csv_rows, read_bytes, read_text, unpacked_limit_bytes
from roomfit.base.errors import InputError

TABLE_SUFFIXES = (".csv", ".tsv", ".txt", ".xlsx")
"""Endings under which tables are offered to be dropped; every other one is read as text."""
_MAIN = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}"
_MOST_COLUMNS = 16_384  # of a sheet of Excel


def table_rows(path: Path, what: str) -> tuple[str, list[tuple[int, list[str]]]]:
    """Return what stands between columns, and number and cells of each row that is not empty.

    Rows that begin with # are left out. Semicolons decide, or else tabs, so that commas are those
    of decimals. Of a workbook it is the first sheet, as if with tabs.

    Parameters
    ----------
    path : Path
        Ends with ``.xlsx`` for a workbook.
    what : str
        What the file is called in messages: "table of positions".

    Raises
    ------
    InputError
        The file cannot be read, or is no such table.
    """
    if path.suffix.lower() == ".xlsx":
        delimiter, rows = "\t", _sheet_rows(read_bytes(path, what, most="text_bytes"), str(path))
    else:
        text = read_text(path, what)
        bare = re.sub(r"^#.*", "", text, flags=re.MULTILINE)
        delimiter = next((d for d in ";\t" if d in bare), ",")
        rows = csv_rows(text, str(path), delimiter)
    stripped = ((number, [cell.strip() for cell in cells]) for number, cells in rows)
    return delimiter, [(n, c) for n, c in stripped if any(c) and not c[0].startswith("#")]


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
    except (*ARCHIVE_DAMAGE, ElementTree.ParseError) as error:
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
    """Return the number of a cell's column, from 0; the following one where it names none.

    Examples
    --------
    >>> _column("A1", 5), _column("AB12", 0), _column("", 3)
    (0, 27, 3)
    """
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
