"""Whatever a room file holds, a reader answers with a room or with a clear error."""

from __future__ import annotations

import struct
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roomfit.commands import check_room
from roomfit.errors import RoomfitError
from roomfit.io.rooms.model import PolygonSpec, RoomSpec

QUADS = ((0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6))
POINTS = [(x, y, z) for z in (0, 3) for y in (0, 4) for x in (0, 5)]
NASTY = '0 -1 1 7 9 nan inf -inf 1e400 99999999999 0x10 x \x00 " / // . , - + \\ # kids refs f'


def box_obj() -> bytes:
    lines = ["o hall", "g shell", "usemtl plaster", *(f"v {x} {y} {z}" for x, y, z in POINTS)]
    lines += ["f " + " ".join(f"{c + 1}//1" for c in quad) for quad in QUADS]
    return "\n".join(lines).encode()


def box_ac3d() -> bytes:
    lines = ["AC3Db", 'MATERIAL "plaster" rgb 1 1 1', "OBJECT world", "kids 1", "OBJECT poly"]
    lines += ['name "hall"', "data 3", "abc", "loc 1 2 3", "rot 1 0 0 0 1 0 0 0 1", "numvert 8"]
    lines += [f"{x} {y} {z}" for x, y, z in POINTS] + ["numsurf 6"]
    for quad in QUADS:
        lines += ["SURF 0x10", "mat 0", "refs 4", *(f"{c} 0 0" for c in quad)]
    return "\n".join([*lines, "kids 0"]).encode()


def box_ply(order: str) -> bytes:
    head = f"ply\nformat {order} 1.0\nelement vertex 8\nproperty float x\nproperty float y\n"
    head += "property float z\nelement face 6\nproperty list uchar int vertex_indices\nend_header\n"
    if order == "ascii":
        rows = [f"{x} {y} {z}" for x, y, z in POINTS]
        return (head + "\n".join(rows + [f"4 {a} {b} {c} {d}" for a, b, c, d in QUADS])).encode()
    body = b"".join(struct.pack("<3f", *p) for p in POINTS)
    return head.encode() + body + b"".join(struct.pack("<B4i", 4, *quad) for quad in QUADS)


def box_stl() -> bytes:
    triangles = [t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))]
    rows = (struct.pack("<12fH", 0, 0, 0, *(v for k in t for v in POINTS[k]), 0) for t in triangles)
    return b" " * 80 + struct.pack("<I", len(triangles)) + b"".join(rows)


def box_glb() -> bytes:
    import trimesh

    return bytes(trimesh.Scene(trimesh.creation.box((5, 4, 3))).export(file_type="glb"))


def box_corners() -> bytes:
    rows = [f"{i + 1},{x},{y},{z}" for i, (x, y, z) in enumerate(POINTS)]
    return "\n".join(["number,x,y,z", *rows]).encode()


def box_planes() -> bytes:
    rows = [f"{i},plaster,9," + ",".join(str(c + 1) for c in q) for i, q in enumerate(QUADS)]
    return "\n".join(["number,material,area,corner 1,corner 2", *rows]).encode()


GOOD = {
    "box.obj": box_obj(),
    "box.ac": box_ac3d(),
    "text.ply": box_ply("ascii"),
    "binary.ply": box_ply("binary_little_endian"),
    "box.stl": box_stl(),
    "box.glb": box_glb(),
    "corners.csv": box_corners(),
    "planes.csv": box_planes(),
}


def answer(name: str, content: bytes) -> bool:
    """Check a room with this content and return whether it is sound; any other error escapes."""
    with TemporaryDirectory() as folder:
        files = {"corners.csv": box_corners(), "planes.csv": box_planes(), name: content}
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
    has_materials = name in ("box.obj", "box.ac", "corners.csv", "planes.csv")

    assert answer(name, GOOD[name]) == has_materials


@pytest.mark.parametrize("name", GOOD)
@given(data=st.data())
def test_a_damaged_file_gives_a_room_or_a_clear_error(name, data):
    """A hundred damages of each file, taken through reading, repair and examination."""
    answer(name, data.draw(mutated(GOOD[name])))


@pytest.mark.parametrize("name", GOOD)
@given(content=st.binary(max_size=300))
def test_random_bytes_are_never_a_sound_room(name, content):
    """Alone, and behind the format's own first line."""
    first_line = GOOD[name].split(b"\n")[0][:80] + b"\n"

    assert not answer(name, content)
    assert not answer(name, first_line + content)
