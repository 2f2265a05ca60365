"""`roomfit check` tells what a room is like and names each fault; positions are checked as well."""

from __future__ import annotations

from pathlib import Path

import pytest

from roomfit.base.errors import InputError
from roomfit.files.rooms import read_room
from roomfit.files.schema import RoomSpec
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
    """The ceiling is missing, and a face has no material."""
    text = BOX.replace("f 5 6 8 7\n", "").replace("usemtl plaster\n", "")
    assert run_command(monkeypatch, "check", box_file(tmp_path, text), "--unit", "m") == 2
    listed = capsys.readouterr().out.split("Faults forbid tracing")[1]
    for what in ("surfaces without a material", "the mesh leaks", "an opening of about"):
        assert what in listed
    # four fifths of what a ceiling of 20 m2 takes: the rest is seen from beside it alone
    assert "3.000) m" in listed


def test_a_room_with_a_leak_is_refused_with_the_other_faults_counted(tmp_path):
    """What identify sees: the first fault as an error."""
    text = BOX.replace("f 5 6 8 7\n", "").replace("usemtl plaster\n", "")

    with pytest.raises(InputError, match=r"the mesh leaks(.*\n)*.*1 more faults \(no-material\)"):
        read_room(RoomSpec(file=box_file(tmp_path, text), unit="m"))
