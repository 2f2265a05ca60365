"""A table, described once: text for a terminal, HTML, CSV, a data frame, sheets of a workbook.

Whoever has something to show says which columns there are and what stands in them; how a number
is written, what stands for an unknown one, and how columns are lined up is decided here.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib import import_module
from itertools import zip_longest
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeAlias

import numpy as np

from roomfit.base.errors import InputError

_LONGEST_CELL = 32767  # of a sheet


@dataclass(frozen=True, slots=True)
class Cell:
    """Text, smaller lines below it, the style sheet's name for what it means, link and colour."""

    text: str
    small: tuple[str, ...] = ()
    style: str = ""  # of the first cell: of its whole row
    link: str = ""  # relative address, quoted as in a URL
    colour: str = ""  # CSS, of a square before the text


Value: TypeAlias = object
"""What may stand in a table: a `Cell`, a text, a number, a truth value, or None for an unknown."""


class Column(NamedTuple):
    """A column: its name, the unit included, and how its numbers are written."""

    name: str  # a line end begins another line of the heading in a terminal
    form: str = "g"  # of numbers that are not whole, as in `format`
    align: str = ""  # "<" or ">"; "": the first column on the left, the others on the right


@dataclass(frozen=True, slots=True)
class Table:
    """A captioned table; the first column heads the rows, and notes stand below.

    A column that is a mere name has the common `form`. A row of one value is a line across all
    columns, for readers.
    """

    caption: str
    columns: Sequence[str | Column]
    rows: Sequence[Sequence[Value]]
    notes: Sequence[str] = ()
    form: str = "g"
    kind: str = ""  # the style sheet's name for it

    def described(self) -> tuple[Column, ...]:
        """Return the columns with form and alignment."""
        given = [c if isinstance(c, Column) else Column(c, self.form) for c in self.columns]
        return tuple(c._replace(align=c.align or "<>"[i > 0]) for i, c in enumerate(given))

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the columns."""
        return tuple(c.name for c in self.described())


def written(value: Value, form: str = "g", missing: str = "") -> str:
    """Return a value of a cell as text; `missing` stands for a number that is not known.

    Examples
    --------
    >>> written(0.25, ".3f"), written(float("nan"), ".3f", "-"), written(True), written("a")
    ('0.250', '-', 'true', 'a')
    """
    if isinstance(value, Cell | str):
        return value if isinstance(value, str) else value.text
    if value is None:
        return missing
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, int | np.integer):
        return str(value)
    if isinstance(value, float | np.floating):
        return format(float(value), form) if np.isfinite(value) else missing
    raise TypeError(f"no cell of a table is a {type(value).__name__}")


_WIDEST, _GAP = 100, "  "


def text_of(shown: Table, indent: str = "") -> str:
    """Return a table for a terminal: caption, heading, rows, notes.

    Smaller lines stand in brackets, or below where the table would be wider than 100 characters.
    """
    columns = shown.described()
    height = max((c.name.count("\n") for c in columns), default=0)
    heads = [("\n" * (height - c.name.count("\n")) + c.name).split("\n") for c in columns]
    head: list[tuple[str, ...]] = [*zip(*heads, strict=True)] if any(shown.names) else []
    cells = [[_lines(v, c) for v, c in zip(row, columns, strict=False)] for row in shown.rows]
    grid = head + [tuple(_beside(x) for x in r) for r in cells]
    if len(indent) + len(_GAP) * (len(columns) - 1) + sum(_widths(grid, columns)) > _WIDEST:
        grid = head + [line for row in cells for line in zip_longest(*row, fillvalue="")]
    widths = _widths(grid, columns)
    rows = [
        indent
        + _GAP.join(f"{x:{c.align}{w}}" for x, c, w in zip(row, columns, widths, strict=True))
        if len(row) == len(columns)
        else indent + row[0]
        for row in grid
    ]
    return "\n".join([*filter(None, [shown.caption]), *map(str.rstrip, rows), *shown.notes])


def _beside(lines: Sequence[str]) -> str:
    first, *small = lines
    if not first:
        return "  " * bool(small) + "; ".join(small)
    return f"{first} ({'; '.join(small)})" if small else first


def _widths(grid: Sequence[Sequence[str]], columns: Sequence[Column]) -> list[int]:
    whole = [row for row in grid if len(row) == len(columns)]
    return [max(map(len, own)) for own in zip(*whole, strict=True)]


_ASCII = str.maketrans({"\N{EN DASH}": "-", "\N{MINUS SIGN}": "-", "→": ">", "±": "+-"})


def _lines(value: Value, column: Column) -> list[str]:
    if not isinstance(value, Cell):
        return [written(value, column.form, "-")]
    return [line.translate(_ASCII) for line in (value.text, *value.small)]


def html_of(shown: Table) -> str:
    """Return a table in HTML, every text escaped."""
    columns = shown.described()
    names = [c.name.replace("\n", " ") for c in columns]
    heads = "".join(f'<th scope="col">{escape(n)}</th>' if n else "<td></td>" for n in names)
    rows = []
    for row in shown.rows:
        first, *others = map(_markup, row, columns)
        style = row[0].style if isinstance(row[0], Cell) else ""
        across = f' colspan="{len(columns)}"' if len(row) < len(columns) else ""
        cells = "".join(_element("td", x, v) for x, v in zip(others, row[1:], strict=True))
        head = f'<th scope="row"{across}>{first}</th>'
        rows.append(f"<tr{_classed(style)}>{head}\n{cells}</tr>\n")
    notes = "".join(f"<p>{escape(note)}</p>\n" for note in shown.notes)
    return (
        f"<table{_classed(shown.kind)}>\n<caption>{escape(shown.caption)}</caption>\n<thead><tr>{heads}"
        f"</tr></thead>\n<tbody>\n{''.join(rows)}</tbody>\n</table>\n{notes}"
    )


_SWATCH = (
    '<svg class="swatch" aria-hidden="true" viewBox="0 0 1 1">'
    '<rect width="1" height="1" fill="{}"/></svg>'
)


def _markup(value: Value, column: Column) -> str:
    if isinstance(value, str):
        return escape(value)
    if not isinstance(value, Cell):
        return written(value, column.form, "\N{EN DASH}").replace("-", "\N{MINUS SIGN}")
    text = escape(value.text)
    if value.link:
        text = f'<a href="{escape(value.link)}">{text}</a>'
    swatch = _SWATCH.format(escape(value.colour)) if value.colour else ""
    return swatch + text + "".join(f" <small>{escape(line)}</small>" for line in value.small)


def _element(tag: str, content: str, value: Value) -> str:
    return f"<{tag}{_classed(value.style if isinstance(value, Cell) else '')}>{content}</{tag}>"


def _classed(style: str) -> str:
    return f' class="{escape(style)}"' if style else ""


def csv_of(shown: Table, missing: str = "") -> str:
    """Return names and rows as CSV with one line a row; `missing` where a number is not known.

    A text that a spreadsheet would take for a formula gets an apostrophe in front, see
    `without_apostrophe`.

    Examples
    --------
    >>> csv_of(Table("", ("name", "a"), [("=1+1", -0.5)], form=".2f")).split()
    ['name,a', "'=1+1,-0.50"]
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    columns = shown.described()
    for row in (shown.names, *shown.rows):
        cells = zip(row, columns, strict=True)
        writer.writerow([inert(written(value, c.form, missing)) for value, c in cells])
    return stream.getvalue()


_FORMULA = re.compile(r"'*[=+\-@\t\r]")
_NUMBER = re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?|[-+]?(inf|nan)")


def inert(cell: str) -> str:
    """Return a text that no spreadsheet takes for a formula: an apostrophe stands before it."""
    return f"'{cell}" if _FORMULA.match(cell) and not _NUMBER.fullmatch(cell) else cell


def without_apostrophe(cell: str) -> str:
    """Return a text as it was before `csv_of` wrote it.

    Examples
    --------
    >>> inert("=1+1"), inert("-0.5"), without_apostrophe("'=1+1")
    ("'=1+1", '-0.5', '=1+1')
    """
    return cell[1:] if cell[:1] == "'" and _FORMULA.match(cell) else cell


def data_frame(shown: Table, file: str) -> Any:
    """Return a table as a pandas data frame, its numbers not rounded; `file` has the same table."""
    pandas = optional_package("pandas", "data frames", "to_dataframe", file)
    return pandas.DataFrame(list(shown.rows), columns=list(shown.names))


def optional_package(name: str, what: str, where: str, file: str = "result.json") -> Any:
    """Return a package on which roomfit does not depend: `what` needs it, `file` has the same."""
    try:
        return import_module(name)
    except ImportError as error:
        needed = f"the package {name}, on which roomfit does not depend"
        hint = f"pip install {name}; or read {file}, which the command line writes"
        raise InputError(
            f"{what} need {name}", where=where, found=str(error), needed=needed, hint=hint
        ) from error


def workbook_of(sheets: Mapping[str, Table]) -> bytes:
    """Return tables as the bytes of an Excel workbook, one sheet a table, by their names.

    Texts that a spreadsheet would take for a formula get an apostrophe in front; a number that is
    not known is an empty cell. Needs openpyxl, the extra ``excel``.
    """
    try:
        openpyxl: Any = import_module("openpyxl")
    except ImportError as error:
        what, needed = "an Excel workbook needs openpyxl", "the package openpyxl"
        hint = "pip install roomfit[excel]; or write --format csv"
        raise InputError(what, found=str(error), needed=needed, hint=hint) from error
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, shown in sheets.items():
        sheet = book.create_sheet(name)
        # centres of bands are numbers above a column, too
        heading = [float(n) if _NUMBER.fullmatch(n) else n for n in shown.names]
        for row in (heading, *shown.rows):
            sheet.append([_sheet_cell(cell) for cell in row])
        for cell in sheet[1]:
            cell.font = openpyxl.styles.Font(bold=True)
        sheet.freeze_panes = "A2"
    stream = io.BytesIO()
    book.save(stream)
    return stream.getvalue()


def _sheet_cell(value: Value) -> Value:
    """Return a cell as it is written: letters that steer, which no sheet may hold, as ``?``."""
    if not isinstance(value, str):
        return value
    shown = "".join(c if c.isprintable() or c == "\n" else "?" for c in value)
    return inert(shown[:_LONGEST_CELL])


if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Shown:
    """An answer that is printed, shown in a notebook, and drawn."""

    __slots__ = ()
    described_in: ClassVar[str]  # module of `roomfit.report` with `describe`
    drawn: ClassVar[str] = ""  # which of the drawings there says what it is about

    def _called(self, module: str, function: str, *arguments: Any) -> Any:
        return getattr(import_module(f"roomfit.report.{module}"), function)(*arguments)

    def __str__(self) -> str:
        """Return what the command line prints."""
        return str(self._called("text", "text", self._called(self.described_in, "describe", self)))

    def _repr_html_(self) -> str:
        """Return the same for a notebook, as a piece of HTML."""
        return str(
            self._called("html", "fragment", self._called(self.described_in, "describe", self))
        )

    def plot(self) -> Figure:
        """Return a figure of what an answer is about."""
        drawings = self._called(self.described_in, "describe", self).drawings()
        figures: list[Figure] = [d.figure for d in drawings if d.name == self.drawn]
        if not figures:
            what, found = "there is no figure of this answer", type(self).__name__
            needed, hint = "an answer that has one, as of identify", "print it: it is a table"
            raise InputError(what, found=found, needed=needed, hint=hint)
        return figures[0]
