"""Tables as rows of cells: what spreadsheets write and copy, and what only calls itself one."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import pytest

from roomfit.base.errors import InputError
from roomfit.files.draft import read_positions
from roomfit.files.reverberation import read_decay_times
from roomfit.files.tables import table_rows


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
    assert read_positions(workbook(tmp_path, rows)) == expected
    for text in (
        "Name\tx [cm]\ty\tz\n\nBühne\t120,5\t150\t110,25\n",
        "Name;x in cm;y in cm;z in cm\nBühne;120,5;150;110,25\n",
        "# of a survey\nName,x_cm,y_cm,z_cm\nBühne,120.5,150,110.25\n",
    ):
        file = tmp_path / "table.csv"
        file.write_text(text, encoding="utf-8")
        assert read_positions(file) == expected, text


def test_cells_keep_their_columns_and_the_first_sheet_is_the_one_that_is_shown_first(
    tmp_path: Path,
) -> None:
    file = workbook(tmp_path, [["place", 500, 1000], ["A", None, 1.25]])
    assert table_rows(file, "table")[1] == [(1, ["place", "500", "1000"]), (2, ["A", "", "1.25"])]
    times, bands = read_decay_times(file)
    assert times.tolist() == [[1.25]] and bands.centres_hz.tolist() == [1000.0]
    assert read_positions(workbook(tmp_path, [["S2", 1, 2, 3]], before="new")) == {"S1": (9, 9, 9)}


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
    assert table_rows(file, "table") == ("\t", [(1, ["1"])])
    file.write_bytes(HOSTILE[kind])
    with pytest.raises(InputError, match="not an Excel workbook") as caught:
        table_rows(file, "table")
    assert caught.value.found and caught.value.needed and caught.value.hint
