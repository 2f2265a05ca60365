"""Rooms in SketchUp's format, written by openskp: sides, holes, components, inches."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from roomfit.base.errors import InputError, RoomfitError
from roomfit.files.draft import likely_units
from roomfit.files.rooms import read_model, read_room
from roomfit.files.schema import RoomSpec
from roomfit.room.mesh import volume_m3
from roomfit.room.scene import material_areas_m2

openskp = pytest.importorskip("openskp")
INCH_M = 0.0254
LENGTHS = (6.0, 5.0, 3.0)


def inches(*points: tuple[float, float, float]) -> list[tuple[float, float, float]]:
    return [(x / INCH_M, y / INCH_M, z / INCH_M) for x, y, z in points]


def model(folder: Path) -> bytes:
    """Return a box of 6 x 5 x 3 m with a window of 2 x 1 m, which a mirrored component fills.

    Fronts of the floor and of the wall x = 0 look outwards, where they are painted "outside"; their
    backs are "carpet" and "plaster". The window is in a group in a component, turned by a right
    angle, mirrored, and unpainted but for its group. The ceiling is hidden.
    """
    builder = openskp.create()
    paints = {
        name: builder.add_material(name, (200, 200, 200))
        for name in ("outside", "carpet", "plaster", "glass", "board")
    }
    with builder.add_component_definition("Pane") as pane:
        # 2 m along its own y, 1 m upwards, front along its own -x
        pane.add_face(inches((0, 0, 0), (0, 0, 1), (0, 2, 1), (0, 2, 0)))
    with builder.add_group(
        "Window", translation=inches((1, 0, 1))[0], material=paints["glass"]
    ) as g:
        # mirrored in x, then turned by -90 degrees: its y runs along the room's x
        g.add_instance(pane, matrix3x3=(0, 1, 0, 1, 0, 0, 0, 0, 1))
    x, y, z = LENGTHS
    faces = {
        "floor": [(0, 0, 0), (0, y, 0), (x, y, 0), (x, 0, 0)],  # its front is below
        "ceiling": [(0, 0, z), (0, y, z), (x, y, z), (x, 0, z)],  # its front is below, in the room
        "west": [(0, 0, 0), (0, 0, z), (0, y, z), (0, y, 0)],  # its front is outside
        "east": [(x, 0, 0), (x, 0, z), (x, y, z), (x, y, 0)],  # its front is in the room
        "north": [(0, y, 0), (0, y, z), (x, y, z), (x, y, 0)],  # its front is outside
        "south": [(0, 0, 0), (0, 0, z), (x, 0, z), (x, 0, 0)],  # its front is in the room
    }
    for name, corners in faces.items():
        outward = name in ("floor", "west", "north")
        inner = paints[{"floor": "carpet", "ceiling": "board"}.get(name, "plaster")]
        builder.add_face(
            inches(*corners),
            material=paints["outside"] if outward else inner,
            back_material=inner if outward else paints["outside"],
            hidden=name == "ceiling",
            holes=[inches((1, 0, 1), (3, 0, 1), (3, 0, 2), (1, 0, 2))] if name == "south" else (),
        )
    builder.save(folder / "made.skp")
    return (folder / "made.skp").read_bytes()


def written(folder: Path, content: bytes) -> Path:
    (folder / "room.skp").write_bytes(content)
    return folder / "room.skp"


def test_a_model_is_a_room_with_the_paint_of_its_inner_sides(tmp_path):
    file = written(tmp_path, model(tmp_path))
    room, findings = read_room(RoomSpec(file=file))
    assert volume_m3(room.mesh) == pytest.approx(90.0, rel=1e-9)
    assert dict(zip(room.materials, material_areas_m2(room), strict=True)) == pytest.approx(
        {"carpet": 30.0, "board": 30.0, "plaster": 66.0 - 2.0, "glass": 2.0}, rel=1e-9
    )
    assert likely_units(file) == {"in": "by the format of the file"}
    assert {s.name for s in room.mesh.surfaces} == {"model", "Pane"}
    assert findings[0].sentence == (
        "The model has parts that are hidden or no faces: 1 hidden face, taken all the same."
    )
    assert len(findings) == 2  # and that the other sides of faces are in no air


def test_a_mirrored_component_keeps_its_front(tmp_path):
    """A box of 1 m hangs in an unpainted room twice, once mirrored: its outer sides are "board"."""
    builder = openskp.create()
    board, inside = (builder.add_material(n, (9, 9, 9)) for n in ("board", "inside"))
    unit = [(k & 1, k >> 1 & 1, k >> 2) for k in range(8)]
    # counter-clockwise as seen from outside of it
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    for name, at, mirror in (("Box", (1, 1, 1), 1), ("Twin", (5, 3, 1), -1)):
        put = {"translation": inches(at)[0], "matrix3x3": (mirror, 0, 0, 0, 1, 0, 0, 0, 1)}
        with builder.add_group(name, **put) as group:
            for quad in quads:
                corners = inches(*(unit[k] for k in quad))
                group.add_face(corners, material=board, back_material=inside)
    for quad in quads:
        builder.add_face(inches(*(tuple(np.multiply(unit[k], LENGTHS)) for k in quad)))
    builder.save(tmp_path / "room.skp")
    spec = RoomSpec(file=tmp_path / "room.skp", materials={"model": "plaster"})
    room, _ = read_room(spec)
    areas = dict(zip(room.materials, material_areas_m2(room), strict=True))
    assert areas == pytest.approx({"plaster": 126.0, "board": 12.0}, rel=1e-9)
    assert volume_m3(room.mesh) == pytest.approx(88.0, rel=1e-9)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda b: b[: len(b) // 2], "SketchUp file cannot be read"),
        (lambda _: b"PK" + b"\0" * 200, "SketchUp file cannot be read"),
        (lambda b: b[:20], "SketchUp file cannot be read"),
    ],
)
def test_a_damaged_model_is_refused(tmp_path, change, words):
    with pytest.raises(InputError, match=words):
        read_model(RoomSpec(file=written(tmp_path, change(model(tmp_path)))))


@pytest.mark.slow
def test_any_damage_of_a_model_is_a_room_or_a_refusal(tmp_path):
    """Ten bytes turned at random behind the head, six times."""
    rng, whole = np.random.default_rng(7), model(tmp_path)
    for _ in range(6):
        altered = bytearray(whole)
        for place in rng.integers(len(whole) // 2, len(whole), 10):
            altered[place] = rng.integers(0, 256)
        try:
            read_room(RoomSpec(file=written(tmp_path, bytes(altered))))
        except RoomfitError:
            continue
