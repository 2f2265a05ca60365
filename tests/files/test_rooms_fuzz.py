"""Whatever a room file holds, a reader answers with a room or with a clear error."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from box_files import corners, obj, planes, ply, stl
from roomfit.base.errors import RoomfitError
from roomfit.files.inputs import check_room
from roomfit.files.rooms.model import PolygonSpec, RoomSpec

NASTY = '0 -1 1 7 9 nan inf -inf 1e400 99999999999 0x10 x \x00 " / // . , - + \\ # kids refs f'


def box_glb() -> bytes:
    import trimesh

    return bytes(trimesh.Scene(trimesh.creation.box((5, 4, 3))).export(file_type="glb"))


GOOD = {
    "box.obj": obj(),
    "text.ply": ply("ascii"),
    "binary.ply": ply("binary_little_endian"),
    "box.stl": stl(),
    "box.glb": box_glb(),
    "corners.csv": corners(),
    "planes.csv": planes(),
}

HERE = ("box.obj", "corners.csv", "planes.csv")  # others are read in a process each


def answer(name: str, content: bytes) -> bool:
    """Check a room with this content and return whether it is sound; any other error escapes."""
    with TemporaryDirectory() as folder:
        files = {"corners.csv": corners(), "planes.csv": planes(), name: content}
        for key, value in files.items():
            Path(folder, key).write_bytes(value)
        tables = PolygonSpec((Path(folder, "corners.csv"),), (Path(folder, "planes.csv"),))
        spec = RoomSpec(polygons=tables)
        if not name.endswith(".csv"):
            spec = RoomSpec(file=Path(folder, name), unit="m")
        try:
            return check_room(spec).traceable
        except RoomfitError as error:
            assert str(error)
            return False


@st.composite
def mutated(draw: st.DrawFn, good: bytes) -> bytes:
    """Cut, overwrite, swap words or repeat lines of a good file, once to three times."""
    content = good
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(content)))
        match draw(st.sampled_from(["cut", "overwrite", "word", "line"])):
            case "cut":
                content = content[:at]
            case "overwrite":
                content = content[:at] + draw(st.binary(max_size=8)) + content[at + 4 :]
            case "word":
                words = content.split(b" ")
                words[at % len(words)] = draw(st.sampled_from(NASTY.split(" "))).encode()
                content = b" ".join(words)
            case "line":
                lines = content.split(b"\n")
                lines.insert(at % len(lines), lines[(at * 7) % len(lines)])
                content = b"\n".join(lines)
    return content


@pytest.mark.parametrize("name", GOOD)
def test_the_files_that_are_mutated_are_good_ones(name):
    """All are the same box; those without materials lack only these."""
    has_materials = name in ("box.obj", "corners.csv", "planes.csv")

    assert answer(name, GOOD[name]) == has_materials


@pytest.mark.parametrize("name", HERE)
@given(data=st.data())
def test_a_damaged_file_gives_a_room_or_a_clear_error(name, data):
    """Taken through reading, repair and examination."""
    answer(name, data.draw(mutated(GOOD[name])))


@pytest.mark.parametrize("name", [name for name in GOOD if name not in HERE])
@settings(max_examples=4, deadline=None)
@given(data=st.data())
def test_a_damaged_file_for_a_process_apart_gives_a_room_or_a_clear_error(name, data):
    answer(name, data.draw(mutated(GOOD[name])))


@pytest.mark.parametrize("name", HERE)
@given(content=st.binary(max_size=300))
def test_random_bytes_are_never_a_sound_room(name, content):
    """Alone, and behind the format's own first line."""
    first_line = GOOD[name].split(b"\n")[0][:80] + b"\n"

    assert not answer(name, content)
    assert not answer(name, first_line + content)
