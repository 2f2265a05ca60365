"""3D Studio files and the layers of I-Simpa: names, mirrored objects, files of another program."""

from __future__ import annotations

import base64
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from box_files import POINTS, TRIANGLES, chunk, layered_ply, three_ds
from roomfit.base.errors import InputError
from roomfit.files.rooms import read_mesh, read_room
from roomfit.files.rooms.mesh_formats import read_3ds, read_ply
from roomfit.files.rooms.model import PolygonSpec, RoomSpec
from roomfit.room.mesh import surface_area_m2, volume_m3
from roomfit.room.scene import material_areas, material_areas_m2

# Written by Assimp 6.0.5 (its C interface, aiExportScene "3ds") from the OBJ of an L-shaped room of
# 7 m2 and 3 m; it is compressed here.
OF_ASSIMP = (
    "c-qZW%}&BV5S{|%KT14-r^a|N98AH)8(}x`O2Qk|iY37`kwCq3@BxfbqaF-zKp(-g(f9D`6X5J@Ted|o(St5wcK6"
    "%K?tC-fw9~oD0<>B$I>3DP1URNuG)GR~zHq&c?Kz`??OG-ngjZk-?c+nO9sW%PS4U+9-kny^HlP^nCoB9|!f!sir"
    "RX-%^z6~l@vO!_2<nD{+CbwCTxV=G|3OT56q7)Qu06&IS_gj~6|fI9r&3nuCudI2v*J4wfWL{mco%IJmdAtzb33t"
    "aFV5Aq90uoTGx*a3M1vICG$L}Oa1CJcnkubK;FyMEei%I!3upbFy)O}#5@{gO*BH?-SjHA47+a8w)=aKLf{ZE8F@"
    "rNAs#D~WmSCX=gj2zp$*YQ7f6wz$OY#h5*F>g$O)$Mj$8xMJ%jJrgs@YJ>`$aZXIjEUY-%zs@3mh|c9mFLw6iPvh"
    "vZxcD!7Alw&Jmu4JQQdy5S~YwmuM~#UL<*mIZe39>#=4mM>!Yoh`Yso;*KBIKr4o*|14Pe)RewxN_QWNB0miCly4"
    "Beom6Jn2);?@_3v9%GVu4ve`mGQ1HU@??ZO(Rkmo05DA)%"
)


def written(folder: Path, content: bytes, name: str = "box.3ds") -> Path:
    path = folder / name
    path.write_bytes(content)
    return path


def test_a_box_has_its_size_its_object_and_its_materials(tmp_path):
    """60 m3; floor and walls of plaster, 5 x 4 m2 of tiles; lamps and smoothing are no faces."""
    room, findings = read_room(RoomSpec(file=written(tmp_path, three_ds()), unit="m"))
    assert volume_m3(room.mesh) == pytest.approx(60.0)
    areas = dict(zip(room.materials, material_areas_m2(room), strict=True))
    assert areas == pytest.approx({"plaster": 20.0 + 54.0, "tiles": 20.0})
    assert {s.name for s in room.mesh.surfaces} == {"hall"}
    assert findings == ()


def test_a_file_of_another_program_is_the_room_that_it_was_made_from(tmp_path):
    content = zlib.decompress(base64.b85decode(OF_ASSIMP))
    mesh, findings = read_mesh(RoomSpec(file=written(tmp_path, content), unit="m"))
    assert volume_m3(mesh) == pytest.approx(21.0, rel=1e-6)
    assert surface_area_m2(mesh) == pytest.approx(62.0, rel=1e-6)
    # it adds a number to every name
    expected = {"carpet_1": 7.0, "tiles_2": 7.0, "plaster_3": 48.0}
    assert material_areas(mesh, {}) == pytest.approx(expected)
    assert findings == ()


def test_a_room_without_a_unit_is_asked_for_it(tmp_path):
    with pytest.raises(InputError, match="unit of the room file is not known"):
        read_mesh(RoomSpec(file=written(tmp_path, three_ds())))


def test_faces_without_a_material_have_none(tmp_path):
    model = read_3ds(written(tmp_path, three_ds(materials=False)))
    assert {face.surface.file_material for face in model.faces} == {None}


@pytest.mark.parametrize(
    ("axes", "expected"),
    [
        ((0, 1, 0, -1, 0, 0, 0, 0, 1, 2, 0.5, 0), POINTS),  # turned, not mirrored
        ((-1, 0, 0, 0, 1, 0, 0, 0, 1, 2, 0.5, 0), [(4 - x, y, z) for x, y, z in POINTS]),
        # its first axis is y: mirrored about y = 0.5
        ((0, -1, 0, -1, 0, 0, 0, 0, 1, 2, 0.5, 0.3), [(x, 1 - y, z) for x, y, z in POINTS]),
        # axes of no object: nothing is said beside the file, and nothing is mirrored
        ((-1e30, 0, 0, 0, 1e30, 0, 0, 0, 1e30, float("inf"), 0.5, 0), POINTS),
    ],
)
def test_an_object_with_left_handed_axes_is_mirrored_along_the_first(tmp_path, axes, expected):
    model = read_3ds(written(tmp_path, three_ds(axes)))
    np.testing.assert_allclose(model.vertices, expected, atol=1e-6)


FACES = struct.pack("<4H", 12, *TRIANGLES[0])


def _points(numbers: tuple[float, ...], triangle: tuple[int, ...] = (0, 1, 2, 0)) -> bytes:
    mesh = chunk(0x4110, struct.pack("<H9f", 3, *numbers))
    mesh += chunk(0x4120, struct.pack("<5H", 1, *triangle))
    return chunk(0x4D4D, chunk(0x3D3D, chunk(0x4000, b"a\0" + chunk(0x4100, mesh))))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"solid hall" * 10, "no 3DS file"),
        (three_ds()[:-100], "ends early"),
        (three_ds().replace(FACES, b"\xff\xff" + FACES[2:]), "ends early"),
        (chunk(0x4D4D, chunk(0x3D3D, b"")), "no faces"),
        (_points((0, 0, 0, 1, 0, 0, float("nan"), 0, 0)), "not a finite number"),
        (_points((0, 0, 0, 1, 0, 0, 0, 1, 0), (0, 1, 3, 0)), "corner that does not exist"),
    ],
)
def test_a_damaged_file_is_refused(tmp_path, content, words):
    with pytest.raises(InputError, match=words):
        read_3ds(written(tmp_path, content))


@pytest.mark.parametrize("order", ["ascii", "binary_big_endian"])
def test_layers_of_isimpa_are_surfaces_and_materials(tmp_path, order):
    """Elements and properties are those of I-Simpa's own rooms, such as its tutorial's hall."""
    file = written(tmp_path, layered_ply(order), "hall.ply")
    room, findings = read_room(RoomSpec(file=file, unit="m", materials={"Decke ü": "tiles"}))
    areas = dict(zip(room.materials, material_areas_m2(room), strict=True))
    assert areas == pytest.approx({"walls": 20.0 + 54.0, "tiles": 20.0})
    assert findings == ()


def test_a_face_in_a_layer_that_is_not_there_is_refused(tmp_path):
    content = layered_ply("ascii").replace(b"4 4 5 7 6 1", b"4 4 5 7 6 2")
    with pytest.raises(InputError, match=r"layer that does not exist(?s:.*)0 to 1"):
        read_ply(written(tmp_path, content, "hall.ply"))
    content = content.replace(b"4 4 5 7 6 2", b"4 4 5 7 6 -1")
    model = read_ply(written(tmp_path, content, "hall.ply"))
    assert (model.faces[-1].surface.name, model.faces[-1].surface.file_material) == ("hall", None)


# Number, material and corners in the headings of a round robin's tables, without "Area/m²"
PLANES = """PLANES,,,,,
Number,Material,Corner 1,Corner 2,Corner 3,Corner 4
1,parquet,1,3,4,2
2,plaster,5,6,8,7
3,plaster,1,2,6,5
4,plaster,3,7,8,4
5,plaster,1,5,7,3
6,plaster,2,4,8,6
"""


def test_a_list_of_planes_needs_no_areas(tmp_path):
    """The first corner follows the material at once; areas are those of the corners."""
    rows = [f"{i + 1},{x},{y},{z}" for i, (x, y, z) in enumerate(POINTS)]
    corners = written(tmp_path, "\n".join(["CORNERS,,,", "Number,x,y,z", *rows]).encode(), "c.csv")
    planes = written(tmp_path, PLANES.encode(), "p.csv")
    room, findings = read_room(RoomSpec(polygons=PolygonSpec((corners,), (planes,))))
    assert volume_m3(room.mesh) == pytest.approx(60.0)
    areas = dict(zip(room.materials, material_areas_m2(room), strict=True))
    assert areas == pytest.approx({"parquet": 20.0, "plaster": 20.0 + 54.0})
    assert findings == ()
