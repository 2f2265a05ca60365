"""Exports: every format read back by something that roomfit did not write."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from report_cases import answer_of, scene_of
from roomfit.base.bands import bands_between
from roomfit.base.errors import InputError
from roomfit.cli.export import export_result
from roomfit.files.exports import (
    resample,
    short_names,
)
from small_campaign import run_command

OCTAVES = [125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0]
ABSORPTION = {
    "carpet, grey": [0.021, 0.06, 0.144, 0.37, 0.6, 0.65],
    "Wand grün": [0.0004, 0.012, 0.02, 0.03, 0.04, 0.05],
    "a very long name of a ceiling": [0.7, 0.75, 0.65, 0.9, 0.999, 1.0],
}


def write_result(folder: Path, scattering: float | None = None) -> Path:
    materials = {
        name: {
            "absorption": alphas,
            "lower95": [0.5 * a for a in alphas],
            "upper95": [min(1.0, 1.5 * a) for a in alphas],
            "identifiable": [name != "Wand grün" or i != 1 for i in range(6)],
            "area_m2": 10.0,
        }
        for name, alphas in ABSORPTION.items()
    }
    if scattering is not None:
        for material in materials.values():
            material["scattering"] = [scattering] * 6
    content = {
        "format": "roomfit-result",
        "format_version": 1,
        "bands_hz": OCTAVES,
        "materials": materials,
    }
    path = folder / "result.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def test_pyroomacoustics_takes_the_materials(tmp_path):
    pra = pytest.importorskip("pyroomacoustics")
    export_result(write_result(tmp_path, 0.25), "pyroomacoustics", tmp_path / "m.json")
    content = json.loads((tmp_path / "m.json").read_text(encoding="utf-8"))
    for name, alphas in ABSORPTION.items():
        material = pra.Material(**content[name])
        np.testing.assert_allclose(material.absorption_coeffs, alphas, atol=6e-6)
        np.testing.assert_allclose(material.scattering_coeffs, 0.25)
        np.testing.assert_array_equal(material.energy_absorption["center_freqs"], OCTAVES)
    room = pra.ShoeBox([4.0, 3.0, 2.5], fs=16000, materials=material, max_order=1)
    # its own bands begin at 125 Hz, too: what was written is what its walls have
    np.testing.assert_allclose(room.walls[0].absorption.ravel()[:6], alphas, atol=1e-4)


def test_catt_lines_follow_its_grammar(tmp_path):
    """Name of at most 15 letters, digits and _; six whole percents, a colon, two more; colour."""
    export_result(write_result(tmp_path, 0.3), "catt", tmp_path / "materials.geo")
    numbers = r"<((?: ?\d{1,2}){6}) :((?: \d{1,2}){2})>"
    grammar = re.compile(
        rf"ABS ([A-Za-z][A-Za-z0-9_]{{0,14}}) = {numbers} L {numbers}"
        r" \{\d{1,3} \d{1,3} \d{1,3}\} ;(.*)"
    )
    lines = (tmp_path / "materials.geo").read_bytes().decode().split("\r\n")
    found = [grammar.fullmatch(line) for line in lines if line and not line.startswith(";")]
    assert len(found) == 3
    assert all(found)
    names = [m.group(1) for m in found]
    assert len(set(names)) == 3
    assert names[0] == "carpet_grey"
    for match, alphas in zip(found, ABSORPTION.values(), strict=True):
        percents = [int(v) for v in match.group(2).split()]
        expected = np.clip(np.round(100 * np.array(alphas)), 1, 99)
        assert percents == expected.tolist()
        assert match.group(3).split() == [str(percents[-1])] * 2  # 8 and 16 kHz: held
        assert match.group(4).split() == ["30"] * 6
        exact = [float(v) for v in match.group(6).split(":")[-1].split()]
        np.testing.assert_allclose(exact[:6], alphas, atol=6e-5)
    assert any("Nothing was fitted at 8000, 16000 Hz" in line for line in lines)


ISIMPA_LINE = re.compile(r"(\w+) = <((?: \d{1,2}){6}) >(?: L <((?: \d{1,2}){6}) >)?")


def test_isimpa_lines_look_like_those_of_its_manual(tmp_path):
    manual = "linoleum = < 2 3 3 4 6 5 > L < 30 27 24 21 18 15 >"
    assert ISIMPA_LINE.fullmatch(manual)
    export_result(write_result(tmp_path, 0.3), "isimpa", tmp_path / "materials.txt")
    lines = (tmp_path / "materials.txt").read_text(encoding="ascii").splitlines()
    found = [ISIMPA_LINE.fullmatch(line) for line in lines]
    assert len(found) == 3
    assert all(found)
    assert found[0].group(2).split() == ["2", "6", "14", "37", "60", "65"]
    assert found[0].group(3).split() == ["30"] * 6


def test_odeon_rows_are_read_as_another_program_reads_its_library(tmp_path):
    """A line that begins with a tabulator holds the values, any other one number and name."""
    export_result(write_result(tmp_path), "odeon", tmp_path / "room.Li8")
    names, values = [], []
    for line in (tmp_path / "room.Li8").read_bytes().decode().splitlines():
        fields = line.split("\t")
        if fields[0]:
            names.append(fields[0].split(" ", 1))
        else:
            values.append([float(v) for v in fields[1:]])
    assert [n for _, n in names] == list(ABSORPTION)
    assert len({int(number) for number, _ in names}) == 3
    for row, alphas in zip(values, ABSORPTION.values(), strict=True):
        np.testing.assert_allclose(row, [alphas[0], *alphas, alphas[-1]], atol=6e-6)


def test_the_wide_table_holds_values_and_intervals(tmp_path):
    export_result(write_result(tmp_path), "csv", tmp_path / "wide.csv")
    with (tmp_path / "wide.csv").open(newline="", encoding="utf-8") as stream:
        rows = {(r["material"], r["quantity"]): r for r in csv.DictReader(stream)}
    assert float(rows["carpet, grey", "absorption"]["1000"]) == pytest.approx(0.37)
    assert float(rows["carpet, grey", "upper95"]["125"]) == pytest.approx(0.0315)
    assert rows["Wand grün", "identifiable"]["250"] == "false"
    assert rows["Wand grün", "identifiable"]["500"] == "true"
    assert ("Wand grün", "scattering") not in rows


def test_an_octave_is_the_mean_of_its_thirds():
    thirds, octaves = bands_between("third-octave", 100, 315), bands_between("octave", 125, 500)
    values = np.array([[0.1, 0.2, 0.3, 0.4, 0.6, 0.8]])
    got, filled = resample(values, thirds, octaves)
    np.testing.assert_allclose(got, [[0.2, 0.6, 0.8]])
    assert filled.tolist() == [False, False, True]


def test_a_gap_between_octaves_is_bridged_and_reported():
    octaves = bands_between("octave", 125, 1000)
    there = np.array([0, 3])
    bands = type(octaves)("octave", octaves.centres_hz[there])
    got, filled = resample(np.array([[0.1, 0.7]]), bands, octaves)
    # exact octaves are equally wide in the logarithm
    np.testing.assert_allclose(got, [[0.1, 0.3, 0.5, 0.7]])
    assert filled.tolist() == [False, True, True, False]


@given(
    st.sampled_from(["octave", "third-octave"]),
    st.lists(st.floats(0.0, 1.0), min_size=4, max_size=4),
)
def test_other_bands_never_leave_the_range_of_the_values(kind, values):
    bands = bands_between("octave", 250, 2000)
    wanted = bands_between(kind, 31.5, 16000)
    got, _ = resample(np.array([values]), bands, wanted)
    assert np.min(got) >= min(values) - 1e-12
    assert np.max(got) <= max(values) + 1e-12


@given(st.lists(st.text(max_size=30), max_size=12, unique=True))
def test_short_names_are_short_and_different(names):
    short = short_names(tuple(names))
    assert list(short) == names
    assert len({s.lower() for s in short.values()}) == len(names)
    for s in short.values():
        assert re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", s)
        assert len(s) <= 15


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "not JSON"),
        ("[]", "no result of roomfit"),
        ('{"format": "roomfit-result", "format_version": 2}', "not of this version"),
        ('{"format": "roomfit-result", "format_version": 1}', "incomplete"),
        (
            '{"format": "roomfit-result", "format_version": 1, "bands_hz": [125], "materials": '
            '{"a": {"absorption": [1.5], "lower95": [0], "upper95": [1], "identifiable": [true]}}}',
            "out of range",
        ),
        (
            '{"format": "roomfit-result", "format_version": 1, "bands_hz": [125], "materials": '
            '{"a": {"absorption": [NaN], "lower95": [0], "upper95": [1], "identifiable": [true]}}}',
            "out of range",
        ),
        (
            '{"format": "roomfit-result", "format_version": 1, "bands_hz": [125, 250], '
            '"materials": {"a": {"absorption": [0.1], "lower95": [0], "upper95": [1], '
            '"identifiable": [true]}}}',
            "wrong shape",
        ),
    ],
)
def test_a_result_that_cannot_be_exported_is_refused(tmp_path, text, words):
    (tmp_path / "result.json").write_text(text)
    with pytest.raises(InputError, match=words) as refused:
        export_result(tmp_path / "result.json", "csv", tmp_path / "out.csv")
    assert "result.json" in str(refused.value)
    assert [p.name for p in tmp_path.iterdir()] == ["result.json"]


def with_parameters(folder: Path) -> Path:
    """Return a result with a pair, a fit and a finding whose sentence looks like a formula."""
    path = write_result(folder)
    content = json.loads(path.read_text())
    columns = ("measured", "predicted", "jnd", "mean_of_others", "diffuse_field")
    compared = {k: [1.0] * 5 + [None] for k in columns}
    content["pairs"] = [
        {"source": "S", "receiver": "R", "use": "fit", "parameters": {"T20_s": compared}}
    ]
    content["fit"] = {"phi": [1.0] * 6, "converged": [True] * 6, "models": ["energy"] * 6}
    content["findings"] = [{"severity": "info", "code": "x", "sentence": "=cmd|'/c calc'!A1\x07"}]
    content["materials"]["=1+1"] = content["materials"].pop("carpet, grey")
    path.write_text(json.dumps(content))
    return path


def test_a_workbook_has_a_sheet_a_table_and_no_formula(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    out = tmp_path / "result.xlsx"
    export_result(with_parameters(tmp_path), "excel", out)
    book = openpyxl.load_workbook(out)
    assert book.sheetnames == [
        *("absorption", "absorption by band", "ratings", "room parameters", "fit", "findings")
    ]
    cells = [cell for sheet in book for row in sheet for cell in row]
    assert not [c for c in cells if c.data_type == "f"]
    assert not [c.value for c in cells if isinstance(c.value, str) and c.value[:1] in "=+-@"]
    rows = list(book["absorption"].values)
    assert rows[0] == ("material", "band_hz", "absorption", "lower95", "upper95", "identifiable")
    found = {(r[0], r[1]): r[2] for r in rows[1:]}
    assert found["Wand grün", 250.0] == 0.012 and found["'=1+1", 125.0] == 0.021
    assert len(found) == 18
    assert next(iter(book["absorption by band"].values))[1:] == tuple(OCTAVES)
    measured = list(book["room parameters"].values)
    assert measured[1] == ("S", "R", "fit", "T20_s", 125.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    assert measured[6][5] is None
    assert list(book["findings"].values)[1][2] == "'=cmd|'/c calc'!A1?"


def test_a_result_is_an_xarray_data_set():
    """With the intervals of materials, priors and the mean of the room."""
    pytest.importorskip("xarray")
    plain = answer_of(scene_of())
    kinds = ("gaussian", "profile", "given")
    estimates = tuple(replace(b, kinds=kinds) for b in plain.estimates)
    data = replace(plain, estimates=estimates).to_xarray()
    place = {"material": "floor", "band_hz": 500.0}
    for name, values in (
        ("absorption", plain.absorption),
        ("upper95", plain.upper95),
        ("prior_lower95", plain.prior[1]),
    ):
        assert data[name].sel(place) == values[1, 2], name
    assert data["interval"].sel(place) == "profile"
    means = [float(data[f"mean_absorption{x}"][2]) for x in ("", "_lower95", "_upper95")]
    assert means == plain.mean_absorption[:, 2].tolist()
    assert dict(data.sizes) == {"material": 3, "band_hz": 6}
    assert data["area_m2"].values.tolist() == plain.areas_m2.tolist()


def test_the_command_writes_and_keeps_what_is_there(tmp_path, monkeypatch, capsys):
    result, out = write_result(tmp_path), tmp_path / "walls.geo"
    call = ("export", result, "--format", "catt", "--out", out)
    assert run_command(monkeypatch, *call) == 0
    reported = capsys.readouterr().out
    assert str(out) in reported
    assert "does not determine Wand grün at 250 Hz" in reported
    before = out.read_bytes()
    assert run_command(monkeypatch, *call, "--scattering", "0.4") == 2
    assert "exists" in capsys.readouterr().err
    assert out.read_bytes() == before
    assert run_command(monkeypatch, *call, "--scattering", "0.4", "--overwrite") == 0
    assert b"L <40 40" in out.read_bytes()
    for wanted, place, words in (
        ("ease", tmp_path / "a", "no such format"),
        ("csv", tmp_path, "something else is in its place"),
        ("csv", tmp_path / "no" / "a.csv", "does not exist"),
    ):
        assert run_command(monkeypatch, "export", result, "--format", wanted, "--out", place) == 2
        assert words in capsys.readouterr().err
    missing = tmp_path / "missing.json"
    assert run_command(monkeypatch, "export", missing, "--format", "csv", "--out", "x") == 2
    assert "does not exist" in capsys.readouterr().err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["result.json", "walls.geo"]
