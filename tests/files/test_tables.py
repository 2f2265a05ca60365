"""Tables as rows of cells: what spreadsheets write and copy, and what only calls itself one."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import pytest

from roomfit.base.errors import InputError
from roomfit.files.results import read_materials as read_table
from roomfit.files.tables import read_sheet
from roomfit.files.values import read_decay_times, read_parameters, read_positions


def workbook(folder: Path, rows: list[list[object]], *, before: str = "") -> Path:
    """Return an Excel workbook, the table in the sheet that is shown first."""
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    sheet = book.active
    for row in rows:
        sheet.append(row)
    if before:  # made later, shown earlier
        book.create_sheet(before, 0).append(["S1", 9, 9, 9])
    file = folder / "table.xlsx"
    book.save(file)
    return file


def test_a_workbook_a_copy_of_its_cells_and_a_text_give_the_same_positions(tmp_path: Path) -> None:
    rows: list[list[object]] = [["Name", "x [cm]", "y", "z"], [], ["Bühne", 120.5, 150, "110,25"]]
    expected = {"Bühne": (1.205, 1.5, 1.1025)}
    assert read_positions(workbook(tmp_path, rows))[0] == expected
    for text in (
        "Name\tx [cm]\ty\tz\n\nBühne\t120,5\t150\t110,25\n",
        "Name;x in cm;y in cm;z in cm\nBühne;120,5;150;110,25\n",
        "# of a survey\nName,x_cm,y_cm,z_cm\nBühne,120.5,150,110.25\n",
    ):
        file = tmp_path / "table.csv"
        file.write_text(text, encoding="utf-8")
        assert read_positions(file)[0] == expected, text


def test_cells_keep_their_columns_and_the_first_sheet_is_the_one_that_is_shown_first(
    tmp_path: Path,
) -> None:
    file = workbook(tmp_path, [["place", 500, 1000], ["A", None, 1.25]])
    rows = read_sheet(file, "table").rows
    assert [row.cells for row in rows] == [["place", "500", "1000"], ["A", "", "1.25"]]
    times, bands, _ = read_decay_times(file)
    assert times.tolist() == [[1.25]] and bands.centres_hz.tolist() == [1000.0]
    assert read_positions(workbook(tmp_path, [["S2", 1, 2, 3]], before="new"))[0] == {
        "S1": (9, 9, 9)
    }


def test_decay_times_that_were_copied_from_a_spreadsheet_are_read(tmp_path: Path) -> None:
    file = tmp_path / "t30.csv"
    file.write_text("place\t500 Hz\t1 kHz\nA\t1,3\t1,2\n")
    assert read_decay_times(file)[0].tolist() == [[1.3, 1.2]]


def _book(sheet: str, workbook_xml: str = "") -> bytes:
    main = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as book:
        book.writestr(
            "xl/workbook.xml",
            workbook_xml or f'<workbook {main} xmlns:r="r"><sheet r:id="a"/></workbook>',
        )
        book.writestr("xl/_rels/workbook.xml.rels", '<r><x Id="a" Target="sheet.xml"/></r>')
        book.writestr("xl/sheet.xml", sheet.replace("MAIN", main))
    return file.getvalue()


ROW = '<row r="1"><c r="A1"><v>1</v></c></row>'
TEXT = ROW.replace("r=", 't="s" r=')  # the second of texts, of which there are none
HOSTILE = {
    "text": b"name;x;y;z\n",
    "no sheet": _book("<s MAIN/>", "<workbook/>"),
    "entities": _book('<!DOCTYPE a [<!ENTITY b "1">]><s MAIN>&b;</s>'),
    "far column": _book(f"<s MAIN>{ROW.replace('A1', 'ZZZZZZ1')}</s>"),
    "no such text": _book(f"<s MAIN>{TEXT}</s>"),
    "unfolds": _book(f"<s MAIN>{' ' * 2**27}</s>"),
    "cut": _book(f"<s MAIN>{ROW}")[:-40],
}  # fmt: skip


@pytest.mark.parametrize("kind", HOSTILE)
def test_a_workbook_that_is_none_or_unfolds_to_anything_is_refused(
    tmp_path: Path, kind: str
) -> None:
    file = tmp_path / "table.xlsx"
    file.write_bytes(_book(f"<s MAIN>{ROW}</s>"))
    assert [r.cells for r in read_sheet(file, "table").rows] == [["1"]]
    file.write_bytes(HOSTILE[kind])
    with pytest.raises(InputError, match="not an Excel workbook") as caught:
        read_sheet(file, "table")
    assert caught.value.found and caught.value.needed and caught.value.hint


HEAD = "material,band_hz,absorption,lower95,upper95,identifiable\n"
ISO = "source,receiver,parameter,500,1000\n"


def refusal(call, *arguments) -> InputError:
    with pytest.raises(InputError) as caught:
        call(*arguments)
    return caught.value


@pytest.mark.parametrize(
    ("read", "content", "what", "found", "needed"),
    [
        (
            read_parameters, "source,receiver,parameter\nS,R,T30\n",
            "without bands", "parameter", "125, 250",
        ),
        (read_parameters, ISO + ",R,T30,1,1\n", "without source", " to R", "source any"),
        (read_parameters, ISO + "S,R,T30,much,1\n", "not a number", "'much'", "a number, or an"),
        (read_parameters, ISO, "without values", "1 line", "lines of values"),
        (read_parameters, ISO + "S,R,T30_sd,-1,1\nS,R,T30,1,1\n", "below zero", "-1", "0 or more"),
        (read_decay_times, "name,500\nA,1.0,2.0\n", "more values", "2", "1, one for each"),
        (read_decay_times, "name,500\nA,long\n", "not a number", "'long'", "a number, or an"),
        (read_decay_times, "name,500\n", "without values", "1 line", "lines of values"),
        (read_positions, "# nothing\n", "is empty", "no line", "x, y, z"),
        (read_table, HEAD + "a,500,a lot,0.1,0.2,true\n", "not a number", "'a lot'", "a number"),
        (read_table, HEAD + "brick,500,0.1,0.1\n", "not a number", "''", "a number"),
    ],
)  # fmt: skip
def test_a_table_that_is_refused_says_found_needed_and_what_to_try(
    tmp_path, read, content, what, found, needed
):
    file = tmp_path / "table.csv"
    file.write_text(content, encoding="utf-8")
    error = refusal(read, file)
    assert what in error.what
    assert error.found and found in error.found, error
    assert error.needed and needed in error.needed, error
    assert error.hint and len(error.hint.split()) > 2, error


def test_a_cell_that_is_no_number_is_named_by_row_and_column(tmp_path):
    file = tmp_path / "absorption.csv"
    row = "brick,500,0.1,0.1,0.2,true\n"
    file.write_text(HEAD + row + row.replace("500,0.1,0.1", "1000,0.1,,"), encoding="utf-8")
    assert "line 3, column lower95" in str(refusal(read_table, file).where)
    file = tmp_path / "times.csv"
    file.write_text("name,500,1000\nA,1.0,1.0\nB,1.0,one\n", encoding="utf-8")
    assert "line 3, column 3" in str(refusal(read_decay_times, file).where)
