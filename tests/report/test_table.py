"""One table is rendered everywhere with the same content, and each format keeps its own rules."""

from __future__ import annotations

import csv
import io

import pytest

from report_cases import read_page
from roomfit.base.table import (
    Cell,
    Column,
    Table,
    csv_of,
    data_frame,
    html_of,
    text_of,
    workbook_of,
)
from roomfit.report.wording import DASH

NAN = float("nan")
SHOWN = Table(
    "Two walls",
    ("wall", Column("band_hz"), "value\nin m²", Column("said", align="<")),
    [
        ("=a <b>", 125.0, 0.25, Cell("2", (f"1{DASH}3",))),
        ("b-c", 1000.0, NAN, "-"),
        ["a line across"],
    ],
    ("a note",),
    ".3f",
)
RECORDS = Table("", SHOWN.columns, SHOWN.rows[:2], form=".3f")


def test_text_is_lined_up_and_smaller_lines_stand_in_brackets():
    assert text_of(SHOWN).splitlines() == [
        "Two walls",
        "                 value",
        "wall    band_hz  in m²  said",
        "=a <b>      125  0.250  2 (1-3)",
        "b-c        1000      -  -",
        "a line across",
        "a note",
    ]


def test_html_has_every_cell_and_no_text_of_a_user_as_markup():
    rows = read_page(html_of(SHOWN)).tables["Two walls"]
    assert "<b>" not in html_of(SHOWN) and "=a &lt;b&gt;" in html_of(SHOWN)
    assert len(rows) == 4
    assert 'colspan="4"' in html_of(SHOWN)


def test_csv_rounds_leaves_unknown_cells_empty_and_disarms_formulas():
    rows = list(csv.reader(io.StringIO(csv_of(RECORDS))))
    assert rows[1] == ["'=a <b>", "125", "0.250", "2"]
    assert rows[2][2] == ""
    assert list(csv.reader(io.StringIO(csv_of(RECORDS, missing="nan"))))[2][2] == "nan"


def test_a_data_frame_has_numbers_that_are_not_rounded():
    pandas = pytest.importorskip("pandas")
    frame = data_frame(Table("", ("a",), [(1.0 / 3.0,)], form=".1f"), "a.csv")
    assert isinstance(frame, pandas.DataFrame) and frame["a"][0] == 1.0 / 3.0


def test_a_sheet_has_numbers_as_numbers_and_no_formula():
    openpyxl = pytest.importorskip("openpyxl")
    heads = ("material", "125", "1000")
    book = workbook_of({"one": Table("", heads, [("=a", 0.123456, None)], form=".1f")})
    sheet = openpyxl.load_workbook(io.BytesIO(book))["one"]
    assert [[c.value for c in row] for row in sheet] == [
        ["material", 125, 1000],
        ["'=a", 0.123456, None],
    ]
