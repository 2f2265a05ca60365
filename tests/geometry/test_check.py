"""`roomfit check` tells what a room is like and names each fault; positions are checked as well."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from roomfit.errors import InputError
from roomfit.findings import Code
from roomfit.geometry import check
from roomfit.geometry.mesh import refuse
from roomfit.io.inputs import check_room
from roomfit.io.rooms import read_room
from roomfit.io.rooms.model import RoomSpec
from roomfit.report.text import room_text
from roomfit.scene import Point, position_findings
from small_campaign import run_command

BOX = """usemtl plaster
v 0 0 0
v 5 0 0
v 0 4 0
v 5 4 0
v 0 0 3
v 5 0 3
v 0 4 3
v 5 4 3
f 1 5 7 3
f 2 4 8 6
f 1 2 6 5
f 3 7 8 4
usemtl carpet
f 1 3 4 2
usemtl tiles
f 5 6 8 7
"""


def box_file(folder: Path, text: str = BOX) -> Path:
    path = folder / "box.obj"
    path.write_text(text)
    return path


def test_a_sound_room_is_described_in_numbers_and_leaves_with_zero(tmp_path, monkeypatch, capsys):
    """V = 60 m3, S = 94 m2, 4V/S = 2.553 m; 54 m2 of wall are 57.4 %."""
    assert run_command(monkeypatch, "check", box_file(tmp_path), "--unit", "m") == 0
    output = capsys.readouterr().out
    for text in ("5.00 x 4.00 x 3.00 m", "60.00 m3", "94.00 m2", "2.553 m", "closed, no ray lost"):
        assert text in output
    assert "plaster        54.00  57.4 %" in output
    assert "The room can be traced." in output


def test_all_faults_are_listed_at_once_and_leave_with_two(tmp_path, monkeypatch, capsys):
    """The ceiling is missing, a face has no area, and one more has no material."""
    text = BOX.replace("f 5 6 8 7\n", "f 5 5 6\n").replace("usemtl carpet\n", "")
    text = "v 9 9 9\n".join(["", text.replace("usemtl plaster\n", "")]).replace("v 9 9 9\n", "", 1)
    assert run_command(monkeypatch, "check", box_file(tmp_path, text), "--unit", "m") == 2
    listed = capsys.readouterr().out.split("faults that forbid tracing")[1]
    for what in ("faces without area", "surfaces without a material", "the mesh leaks"):
        assert what in listed
    assert "(1.667, 0.000, 3.000) m" in listed


def test_a_room_with_a_leak_is_refused_with_the_other_faults_counted(tmp_path):
    """What identify sees: the first fault as an error."""
    text = BOX.replace("f 5 6 8 7\n", "f 5 5 6\n")

    with pytest.raises(InputError, match=r"faces without area(.*\n)*.*1 more faults \(leak\)"):
        read_room(RoomSpec(file=box_file(tmp_path, text), unit="m"))


def test_approximate_volumes_and_sheets_are_said_to_be(tmp_path):
    """A pinhole in the ceiling leaves a warning."""
    hole = "v 2 2 3\nv 2.05 2 3\nv 2.05 2.05 3\nv 2 2.05 3\n"
    ring = "f 5 6 10 9\nf 6 8 11 10\nf 8 7 12 11\nf 7 5 9 12\n"
    text = BOX.replace("f 1 5 7 3", hole + "f 1 5 7 3").replace("f 5 6 8 7\n", ring)
    check = check_room(RoomSpec(file=box_file(tmp_path, text), unit="m"))

    assert check.traceable
    assert not check.closed
    assert "(approximate: the mesh is not closed)" in room_text("box", check)


def test_a_missing_unit_is_one_message_and_no_traceback(tmp_path):
    """The whole program, as a user starts it."""
    command = [sys.executable, "-m", "roomfit", "check", str(box_file(tmp_path))]
    result = subprocess.run(
        command, capture_output=True, text=True, check=False, env=os.environ | {"COLUMNS": "100"}
    )

    assert result.returncode == 2
    assert result.stdout == ""
    assert result.stderr.startswith("the unit of the room file is not known\n  where ")
    assert "Traceback" not in result.stderr


def test_points_outside_in_walls_and_upon_each_other_are_faults_with_their_place():
    """A 5 x 4 x 3 m box: one good pair, one of each fault."""
    room, _ = read_room(RoomSpec(shoebox=(5, 4, 3)))
    sources = (Point("S1", np.array([1.0, 1, 1])), Point("S2", np.array([6.0, 1, 1])))
    receivers = (
        Point("R1", np.array([4.0, 3, 1])),
        Point("R2", np.array([2.0, 2, 2.996])),
        Point("R3", np.array([1.0, 1, 1.004])),
    )
    assert not position_findings(room, sources[:1], receivers[:1])

    findings = position_findings(room, sources, receivers)

    assert [f.code for f in findings] == [
        Code.POSITION_OUTSIDE, Code.POSITION_IN_WALL, Code.SOURCE_AT_RECEIVER,
    ]  # fmt: skip
    with pytest.raises(InputError, match=r"source 'S2' stands outside(.*\n)*.*1 m from .*'east'"):
        refuse(findings)
    assert "4.0 mm from surface 'ceiling'" in findings[1].sentence
    assert "4.0 mm apart" in findings[2].sentence


def test_triangles_less_high_than_a_tenth_of_a_millimetre_are_counted_and_named():
    """2 m long and 0.09 mm high, along each side; one of 0.11 mm is none."""
    high = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [1.0, 0.0, 1.1e-4]])
    thin = high * [1.0, 1.0, 0.9 / 1.1]
    for turned in range(3):
        for n_thin, said in ((1, "1 triangle is thinner"), (2, "2 triangles are thinner")):
            corners = np.concatenate([high, *n_thin * [np.roll(thin, turned, axis=0)]])
            mesh = SimpleNamespace(
                vertices_m=corners,
                triangles=np.arange(len(corners)).reshape(-1, 3),
                triangle_surface=np.array([0, *n_thin * [1]]),
                surfaces=[SimpleNamespace(name="wall"), SimpleNamespace(name="seam")],
            )
            (finding,) = check._slivers(mesh)
            assert (finding.code, finding.evidence["triangles"]) == (Code.SLIVERS, n_thin)
            assert said in finding.sentence and "seam" in finding.sentence
            assert "wall" not in finding.sentence and "(1.000, 0.000, 0.000)" in finding.sentence
            np.testing.assert_allclose(
                finding.about.points_m, n_thin * [(1.0, 0.0, 0.0)], atol=1e-3
            )
    mesh = SimpleNamespace(**{**vars(mesh), "triangles": np.array([[0, 1, 2]])})
    assert check._slivers(mesh) == []
