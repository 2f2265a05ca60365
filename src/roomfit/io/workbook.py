"""A result as an Excel workbook, one sheet a table. Needs openpyxl, the extra ``excel``."""

from __future__ import annotations

import io
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from roomfit.errors import InputError, located
from roomfit.io.door import complete, json_content, read_text
from roomfit.io.encoding import inert
from roomfit.io.exports import MaterialTable, read_material_table

_LONGEST_CELL = 32767


def workbook_bytes(path: Path) -> bytes:
    """Return the tables of a ``result.json`` or an ``absorption.csv`` as the bytes of a workbook.

    Texts that a spreadsheet would take for a formula get an apostrophe in front; a number that is
    not known is an empty cell.

    Raises
    ------
    InputError
        The result cannot be read, or openpyxl is not installed.
    """
    try:
        openpyxl: Any = import_module("openpyxl")
    except ImportError as error:
        raise InputError(
            "an Excel workbook needs openpyxl",
            found=str(error),
            needed="the package openpyxl",
            hint="pip install roomfit[excel]; or write --format csv",
        ) from error
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, (heading, *rows) in result_tables(path).items():
        sheet = book.create_sheet(name)
        for row in (heading, *rows):
            sheet.append([_cell(cell) for cell in row])
        for cell in sheet[1]:
            cell.font = openpyxl.styles.Font(bold=True)
        sheet.freeze_panes = "A2"
    stream = io.BytesIO()
    book.save(stream)
    return stream.getvalue()


def _cell(cell: object) -> object:
    """Return a cell as it is written: letters that steer, which no sheet may hold, as ``?``."""
    if not isinstance(cell, str):
        return cell
    shown = "".join(c if c.isprintable() or c == "\n" else "?" for c in cell)
    return inert(shown[:_LONGEST_CELL])


def result_tables(path: Path) -> dict[str, list[Sequence[object]]]:
    """Return the tables of a result by name, the first row of each its heading.

    ``absorption`` has a row for each material and band, ``absorption by band`` one for each
    material. Of a ``result.json`` also ``room parameters`` (measured, predicted, and the mean of
    the others), ``fit`` (a row a band) and ``findings``.

    Raises
    ------
    InputError
        The result cannot be read.
    """
    table = read_material_table(path)
    tables = {"absorption": _long(table), "absorption by band": _wide(table)}
    if path.suffix.lower() == ".csv":
        return tables
    content = json_content(read_text(path, "result"), "result")
    with located(str(path)), complete("result", "a result.json as roomfit writes it"):
        bands = [float(f) for f in content["bands_hz"]]
        tables["room parameters"] = [
            _PARAMETER_HEADING,
            *(
                [pair["source"], pair["receiver"], pair["use"], name, band]
                + [values.get(key, [None] * len(bands))[j] for key in _PARAMETER_KEYS]
                for pair in content.get("pairs", [])
                for name, values in pair["parameters"].items()
                for j, band in enumerate(bands)
            ),
        ]
        fit = content.get("fit", {})
        columns = {key: fit[key] for key in ("phi", "converged", "models") if fit.get(key)}
        tables["fit"] = [
            ["band_hz", *columns],
            *([band, *(values[j] for values in columns.values())] for j, band in enumerate(bands)),
        ]
        tables["findings"] = [
            ["severity", "code", "sentence"],
            *([f["severity"], f["code"], f["sentence"]] for f in content.get("findings", [])),
        ]
    return tables


_PARAMETER_KEYS = ("measured", "predicted", "jnd", "mean_of_others")
_PARAMETER_HEADING = ["source", "receiver", "use", "parameter", "band_hz", *_PARAMETER_KEYS]


def _long(table: MaterialTable) -> list[Sequence[object]]:
    rows: list[Sequence[object]] = [
        ["material", "band_hz", "absorption", "lower95", "upper95", "identifiable"]
    ]
    for i, name in enumerate(table.names):
        for j, band in enumerate(table.bands.centres_hz.tolist()):
            values = (table.absorption, table.lower95, table.upper95)
            numbers = [float(v[i, j]) for v in values]
            rows.append([name, band, *numbers, bool(table.identifiable[i, j])])
    return rows


def _wide(table: MaterialTable) -> list[Sequence[object]]:
    absorption = zip(table.names, table.absorption.tolist(), strict=True)
    return [
        ["material", *table.bands.centres_hz.tolist()],
        *([name, *values] for name, values in absorption),
    ]
