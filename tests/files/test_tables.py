"""Tables as rows of cells: what spreadsheets write and copy, and what only calls itself one."""

from __future__ import annotations

import io
import re
import zipfile
from pathlib import Path

import numpy as np
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
    stored = [rows[0], [1.101, 120.125, 150, 110]]  # whose point is that of decimals
    assert read_positions(workbook(tmp_path, stored))[0] == {"1.101": (1.20125, 1.5, 1.1)}
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


LS1, MP1 = (1.2, 1.5, 1.1), (4.1, 2.9, 1.2)
AT = "LS1,1.2,1.5,1.1\nMP1,4.1,2.9,1.2"
PLACED = {
    "a quaternion first": "name,qx,qy,qz,x,y,z\nLS1,0,.7,0,1.2,1.5,1.1\nMP1,0,0,1,4.1,2.9,1.2",
    "another order": "z,y,x,label\n1.1,1.5,1.2,LS1\n1.2,2.9,4.1,MP1",
    "a row of units": "Name;x;y;z\n;mm;mm;mm\nLS1;1200;1500;1100\nMP1;4100;2900;1200",
    "a title with the unit": "all in [mm]\n\nname;x;y;z\nLS1;1200;1500;1100\nMP1;4100;2900;1200",
    "a remark as heading": "# name,z,y,x\nLS1,1.1,1.5,1.2\nMP1,1.2,2.9,4.1",
    "blanks": "Name  x[m]  y[m]  z[m]\nLS1   1,20  1,50  1,10\nMP1   4,10  2,90  1,20",
    "sep=": "sep=;\nname;x;y;z\nLS1;1.2;1.5;1.1\nMP1;4.1;2.9;1.2",
    "groups": "name;x [mm];y;z\nLS1;1.200,0;1.500,0;1.100,0\nMP1;4.100,0;2.900,0;1.200,0",
    "groups in quotes": 'name,x_mm,y,z\nLS1,"1,200.0",1500,1100\nMP1,"4,100.0",2900,1200',
    "numbers and directions": "ID;Name;X (m);Y;Z;Yaw\n1;LS1;1.2;1.5;1.1;9\n2;MP1;4.1;2.9;1.2;0",
    "directions called x": "name,x,y,z,dir x,dir y,dir z\nLS1,1.2,1.5,1.1,0,0,1\nMP1,4.1,2.9,1.2",
    "a mean below": "name,x,y,z\nLS1,1.2,1.5,1.1\nMP1,4.1,2.9,1.2\nMean,2.65,2.2,1.15\nMP2,-,n/a,",
    "units in cells": "name;x;y;z\nLS1;1,2 m;1,5 m;1,1 m\nMP1;410 cm;290 cm;120 cm",
    "words among numbers": "LS1,source,1.2,1.5,1.1\nMP1,mic,4.1,2.9,1.2",
    "positions in words": "In the hall\nname,x in hall,y in hall,z in hall\n" + AT,
    "a remark below the first": "name,x,y,z\n" + AT.replace("\nMP", "\n# floor in cm\nMP"),
    "a size above": "Room,12,8,5\nLength,12,m\nname,x,y,z\n" + AT,
    "no row of units": "name,x,y,z\nM,,,\nIN,-,-,-\n" + AT,
    "signs alone": "#\n# \n" + AT.replace(",", " "),
    "in words of others": "Maße in Zentimetern\nname;x;y;z\nLS1;120;150;110\nMP1;410;290;120",
    "units behind numbers": "LS1 120 cm 150 cm 110 cm\nMP1 4.1 m 2.9 m 1.2 m",
    "a column of units": "name;x;y;z;unit\nLS1;120;150;110;cm\nMP1;4,1;2,9;1,2;m",
    "alone in a cell": "Unit;cm\nname;x;y;z\nLS1;120;150;110\nMP1;410;290;120",
}  # fmt: skip


@pytest.mark.parametrize("kind", PLACED)
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_positions_are_read_by_their_heading(tmp_path, kind, encoding):
    file = tmp_path / "p.csv"
    file.write_text(PLACED[kind], encoding=encoding)
    assert read_positions(file)[0] == {"LS1": LS1, "MP1": MP1}


@pytest.mark.parametrize(
    ("content", "what", "hint"),
    [
        ("name,azimuth,elevation,distance\nLS1,30,0,1.5", "spherical", "origin"),
        ("LS1,1.2,1.5,1.1,90", "not understood", "name,x,y,z"),
        ("x,y,z\n1.2,1.5,1.1", "without names", "column of names"),
        ("name,T30,C80,D50\nLS1,1.2,1.5,1.1", "names no x, y, z", "rename"),
        ("a,src x,src y,src z,mic x,mic y,mic z\na,1,1,1,2,2,2", "several", "row for each"),
        ("name;x [mm];y;z\nLS1;1.200;1.500;1.100", "not understood", "thousands"),
        ("name;x [cm];y;z\nLS1;1.200;1.500;1.100", "not understood", "thousands"),
        ("name;x;y;z\nLS1;1,200 in;1,500 in;100 in", "not understood", "thousands"),
        ("LS1,1.2,x,1.1\nMP1,4.1,2.9,1.2", "not understood", "correct"),
        ("in cm or in m\nname,x,y,z\n" + AT, "not understood", "name its unit"),
        ("name,x [cm] [m],y,z\n" + AT, "not understood", "name its unit"),
        ("in m\nname,x,y,z\n" + AT + "\nOrigin: corner; all in cm", "in m or cm", "each heading"),
        ("name,x0,y0,z0,x1,y1,z1\na,1,1,1,2,2,2", "several", "row for each"),
        (";at;;;to\nno,x,y,z,x,y,z\na,1,1,1,2,2,2", "several", "row for each"),
    ],
)  # fmt: skip
def test_positions_that_may_be_anything_are_refused_with_a_cure(tmp_path, content, what, hint):
    file = tmp_path / "p.csv"
    file.write_text(content)
    error = refusal(read_positions, file)
    assert what in error.what and hint in error.hint


HZ = "place;125;250;500\n"
P1, P2 = "P1;1,91;1,73;1,53\n", "P2;1,85;1,70;1,50\n"
BOTH, FIRST = [1.88, 1.715, 1.515], [1.91, 1.73, 1.53]
DOWN = "125\t{0}1.91\t2\n250\t{0}1.73\t2\n500\t{0}1.53\t3\n"
REW = """RT60 data saved by REW V5.40
Dated: Mar 3, 2026
Format is freq (Hz), BW (octaves), EDT (s), r, T20 (s), r, T30 (s), r, T60M (s), C80 (dB)

125 1/1 1.811 -0.976 1.91 -0.983 0.000 -0.993 0.000 1.09
250 1/1 1.581 -0.913 1.672 -0.984 1.73 -0.990 0.000 3.39
500 1/1 1.481 -0.913 1.472 -0.984 1.53 -0.990 0.000 3.39

full 1/1 1.225 -0.979 1.290 -0.991 1.312 -0.993 0.000 4.00
"""
DECAYS = {
    "mean and deviation": (HZ + P1 + P2 + "Mittelwert;9;9;9\nStabw.;9;9;9\nN;2;2;2", BOTH),
    "mean between": ("place;Mean;125;250;500;x\nP1;9;1,91;1,73;1,53;\nP2;9;1,85;1,7;1,5;x", BOTH),
    "clarity among": (HZ + P1 + P2 + "C80 [dB];2,1;2,1;2,1", BOTH),
    "quantities below titles": ("T30 [s]\n" + HZ + P1 + P2 + "C80 [dB]\n" + HZ + "P1;2;2;2", BOTH),
    "quantities in a column": ("at;of;125;250;500\nP1;C80;2;2;2\nP1;T30;1,91;1,73;1,53", FIRST),
    "Room EQ Wizard": (REW, FIRST),
    "EASERA": ("Frequency [Hz]\tEDT [s]\tT30 [s]\tC50 [dB]\n" + DOWN.format("1.6\t"), FIRST),
    "ODEON": ("Band (Hz)\t125\t250\t500\nT(30) (s)\t1.91\t1.73\t1.53\nTs\t125\t125\t125", FIRST),
    "ARTA": ("Freq.(Hz)  125  250  500\nT30(s)  1.910  1.730  1.530\nr30  -0.9  -0.9  -0.9", FIRST),
    "bands as programs compute them": ("place;125.9;0.2512 kHz;501.2\n" + P1, FIRST),
    "kilohertz": ("f [kHz];0,125;0,25;0,5\n" + P1, FIRST),
    "milliseconds": ("T30 in ms\n" + HZ + "P1;1910;1730;1530", FIRST),
    "blocks named in the corner": ("T30 [s];" + HZ[6:] + P1 + P2 + "C80;125;250\nP1;2;2\n", BOTH),
    "clarity first": ("C80;" + HZ[6:] + P1 + P2 + "T30;" + HZ[6:] + P1 + P2, BOTH),
    "turned blocks": ("T30;P1\n125;1.91\n250;1.73\n500;1.53\nC80;P1\n125;1\n250;1", FIRST),
    "blocks below remarks": ("# T30\n" + HZ + P1 + "# C80\n" + HZ + "P1;2;2;2", FIRST),
    "areas of positions": ("T30\n" + HZ + "Parkett;;;\n" + P1 + "Rang;;;\n" + P2, BOTH),
    "both units in a title": ("T30 [s], Ts [ms]\n" + HZ + P1, FIRST),
    "subscripts": ("of;" + HZ[6:] + "T₃₀ [s]" + P1[2:] + "C_{80};2;2;2\nEDT;1;1;1", FIRST),
    "a column of units": ("of;;" + HZ[6:] + "T30;ms;1910;1730;1530\nC80;dB;2;2;2", FIRST),
    "two heads": (";T30;;C80\nf;P1;P2;P1\n125;1,91;1,85;1\n250;1,73;1,7;1\n500;1,53;1,5;1", BOTH),
    "CATT": ("f (Hz);" + HZ[6:] + "T-30" + P1[2:] + "T-15;1;1;1\nEDT;1;1;1", FIRST),
    "notes below": (HZ + P1 + P2 + "\nHeight;7,5\nTemperature;21,5;22;22\nat 3 p.m.", BOTH),
    "two numbers in a label": ("1.5 12;" + HZ[6:-1] + "\nP1;1,91;1,73;1,53", FIRST),
    "no band of two numbers": ("place;125;250;500;125 3\nP1;1,91;1,73;1,53;9", FIRST),
    "centre time like bands": ("of;125;250;500\nT30;1,91;1,73;1,53\nTs;125;125;100", FIRST),
    "spreads": (HZ + P1 + "P1 ±;9;9;9\n" + P2 + "P2 ±;9;9;9\nAnforderung;1;1;1", BOTH),
    "a spread each": ("f;P1;s;P2;s\n125;1,91;9;1,85;9\n250;1,73;9;1,7;9\n500;1,53;9;1,5;", BOTH),
    "not evaluated": ("place;63;125;250;500\nP1;0.00;1.91;1.73;1.53\nP2;-1.#IND;n/a;;*", FIRST),
}  # fmt: skip


@pytest.mark.parametrize("kind", DECAYS)
def test_decay_times_are_those_of_positions_and_what_is_left_out_is_said(tmp_path, kind):
    content, expected = DECAYS[kind]
    file = tmp_path / "t.csv"
    file.write_text(content)
    times, bands, findings = read_decay_times(file)
    assert bands.centres_hz.tolist() == [125.0, 250.0, 500.0]
    assert np.nanmean(times, axis=0) == pytest.approx(expected)
    if "Mittelwert" in content or "C80" in content:
        assert "left out" in findings[0].sentence


BESIDE = ("error [s]", "±", "r", "corr", "(std)", "sd", "Fehler", "R²", "95% CI", "[%]", "JND")
BEFORE = ("s(T30)", "± T30", "\N{GREEK SMALL LETTER SIGMA}(T30)", "Δ T30")


@pytest.mark.parametrize("label", [*(f"T30 {word}" for word in BESIDE), *BEFORE])
def test_what_stands_beside_a_quantity_is_no_value_of_it(tmp_path, label):
    """As a column, as a row, as a row of a position, and as a line of room parameters."""
    file = tmp_path / "t.csv"
    for content in (
        f"f;T30 [s];{label}\n125;1,91;9\n250;1,73;9\n500;1,53;9",
        HZ + "T30" + P1[2:] + f"{label};9;9;9",
        "at;of;" + HZ[6:] + "P1;T30" + P1[2:] + f"P1;{label};9;9;9",
    ):
        file.write_text(content, encoding="utf-8")
        assert read_decay_times(file)[0].tolist() == [FIRST], content
    file.write_text(ISO + f"S,R,T30,0.9,0.8\nS,R,{label},0.1,0.1", encoding="utf-8")
    ((values,), _) = read_parameters(file)
    assert values.values["T30_s"].tolist() == [0.9, 0.8]


@pytest.mark.parametrize(
    "names",
    ["R1 R2 R10", "M1 S1 K1", "N1 N2 H2", "MW1 SD1 CV1", "ST1 BR TR", "R G T", "C1 C50 C80",
     "Mittelschiff Mittelgang M", "T1 T10 T20", "Nr1 S M", "Maximilian Meander Corridor"],
)  # fmt: skip
@pytest.mark.parametrize("mean", ["", "Mean;9;9;9\nStd;9;9;9\n"])
def test_a_position_has_any_name(tmp_path, names, mean):
    """In rows and columns of decay times, in positions and in room parameters."""
    a, b, c = names.split()
    file = tmp_path / "t.csv"
    file.write_text(HZ + f"{a};1,9;1,7;1,5\n{b};1,8;1,6;1,4\n{c};1;1;1\n" + mean)
    assert read_decay_times(file)[0].tolist() == [[1.9, 1.7, 1.5], [1.8, 1.6, 1.4], [1, 1, 1]]
    file.write_text(f"f;{a};{b};{c}\n125;1,9;1,8;1\n250;1,7;1,6;1\n500;1,5;1,4;1")
    assert read_decay_times(file)[0].tolist() == [[1.9, 1.7, 1.5], [1.8, 1.6, 1.4], [1, 1, 1]]
    file.write_text(f"name;x;y;z\n{a};1;2;3\n{b};2;3;4\n{c};3;4;5\n" + mean)
    assert read_positions(file)[0] == {a: (1, 2, 3), b: (2, 3, 4), c: (3, 4, 5)}
    file.write_text(ISO + "".join(f"S,{name},T30,0.9,0.8\n" for name in (a, b, c)))
    assert [values.receiver for values in read_parameters(file)[0]] == [a, b, c]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("TS [ms],90,80", [90, 80]), ("TS [s],.09,.08", [90, 80]), ("Ts,90 ms,80 ms", [90, 80]),
        ("Ts,.09 s,80", [90, 80]), ("T30 [ms],900,800", [0.9, 0.8]), ("G [dB],3,4", [3, 4]),
        ("D50,50 %,60 %", [50, 60]), ("T30,9 dB,8 dB", None), ("C80,9 s,8 s", None),
        ("C80,5 ms,6", None), ("D50,5 dB,6", None), ("D50,0.5,0.6", None),
        ('TS [ms],"1,250","1,100"', None),
    ],
)  # fmt: skip
def test_a_parameter_is_read_in_the_unit_of_its_cell_or_its_name(tmp_path, line, expected):
    file = tmp_path / "t.csv"
    file.write_text(ISO + f"S,R,{line}\n")
    if expected is None:
        assert re.search("not understood|implausible", refusal(read_parameters, file).what)
    else:
        ((values,), _) = read_parameters(file)
        assert next(iter(values.values.values())).tolist() == pytest.approx(expected)
    sd = line.partition(",")[0].replace(" ", "_sd ") + ",1,1\n"
    if expected and "TS" in line:
        file.write_text(ISO + f"S,R,{line}\nS,R,{sd}")
        assert read_parameters(file)[0][0].values["TS_ms"].tolist() == pytest.approx(expected)


@pytest.mark.parametrize(
    ("content", "found"),
    [
        ("Clarity C80 [dB]\n" + HZ + P1, "C80"), ("C80 [dB];" + HZ[6:] + P1, "C80"),
        ("Clarity C80 [dB]\n" + HZ + "A;1;1;1", "C80"), ("# C80\n" + HZ + P1, "C80"),
        ("T30 std;" + HZ[6:] + P1, "other"), (HZ + "P1;12 dB;12 dB;12 dB", "12 dB"),
        (HZ + "P1;5 %;5 %;5 %", "5 %"), ("T30 in ms\n" + HZ + "P1;1.910;1.730;1.530", "1.910"),
        (HZ + "P1;0,00191;0,002;0,002", "0.00191 s"),
        (HZ + P1 + "Chance;0,1;0,1;0,1", "P1: 17.3 times those of Chance"),
    ],
)  # fmt: skip
def test_a_table_of_another_quantity_is_refused_by_it(tmp_path, content, found):
    file = tmp_path / "t.csv"
    file.write_text(content)
    assert found in str(refusal(read_decay_times, file).found)
