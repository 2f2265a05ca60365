"""Rooms of CATT-Acoustic and DXF drawings: known volumes, other writers, damaged files."""

from __future__ import annotations

import math
from pathlib import Path
from tempfile import TemporaryDirectory

import ezdxf
import numpy as np
import pytest
from ezdxf.disassemble import recursive_decompose
from ezdxf.render import MeshBuilder
from ezdxf.render.forms import cube
from hypothesis import given, settings
from hypothesis import strategies as st

from roomfit.base.errors import InputError
from roomfit.base.findings import Code
from roomfit.files.rooms import read_mesh, read_model, read_room
from roomfit.files.schema import RoomSpec
from roomfit.formats.catt import area_m2, cut_parts
from roomfit.room.mesh import surface_area_m2, triangle_areas_m2, volume_m3

# As exported by a Blender add-on: lower-case keywords, two more bands behind a colon, colours.
BOX = """;MASTER.GEO
;PROJECT=

abs plaster = <10 10 10 10 10 10 : 10 10 > L < 20 20 20 20 20 20 : 20 20> {65 94 94}
ABS Wood = <12 10 8 7 5 4>  {213 220 160} ; from a table

CORNERS

1 11.00 5.00 0.00
2 11.00 -0.00 0.00
3 0.00 0.00 0.00
4 0.00 5.00 0.00
5 11.00 5.00 4.00
6 11.00 -0.00 4.00
7 -0.00 0.00 4.00
8 0.00 5.00 4.00

PLANES

[ 1 floor / 1 4 3 2 / WOOD ]
[ 2 ceiling / 5-8 / plaster ]
[ 3 wall / 1 2 6 5 / plaster ]
[ 4 wall / 2 3 7 6 / plaster ]
[ 5 wall /
   3 4 8 7 / plaster* ]
[ 6 wall \\ 1 4 8 5 \\ plaster ]
"""

# Half of an L-shaped hall by expressions, mirrored at x = 0: the floor is a T of known area.
HALL = """
GLOBAL h = 3
GLOBAL half = w/2          ; w stands below: order does not matter
GLOBAL w = 8
LOCAL  deep = sqrt(36) + 2*sin(30) - cos(60)*2
INCLUDE parts
MIRROR 100 200
CORNERS
1 0         0       0
2 -half     0       0
3 x(2)      deep    0
4 -half/2   y(3)    0
5 x(4)      2*deep  0
6 0         y(5)    0
11 x(1) y(1) h
12 x(2) y(2) z(11)
13 x(3) y(3) lock(11 12 15)
14 x(4) y(4) h
15 x(5) y(5) h
16 x(6) y(6) h
PLANES
[1 floor \\ 105 104 103 102 2 3 4 5 \\ floorabs]
[2 ceiling \\ 15 14 13 12 112 113 114 115 \\ tiles]
[3 front \\ 102 112 12 2 \\ brick]
[4 side \\ 2 12 13 3 \\ brick]
[5 step \\ 3 13 14 4 \\ brick]
[6 wing \\ 4 14 15 5 \\ brick]
[7 back \\ 5 15 115 105 \\ brick]
"""
PARTS = "ABS floorabs = Parquet\nABS parquet = <4 4 7 6 6 7>\nABS brick <1 2 3 4 5 6>\n"


def written(folder: Path, text: str, name: str = "room.geo") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def materials(room) -> set[str]:
    return set(room.materials)


def test_a_box_has_its_volume_its_surface_and_its_materials(tmp_path):
    """220 m3 and 2 (55 + 44 + 20) m2 by hand; material names are the same in any case."""
    room, findings = read_room(RoomSpec(file=written(tmp_path, BOX)))
    assert volume_m3(room.mesh) == pytest.approx(11 * 5 * 4, rel=1e-12)
    assert surface_area_m2(room.mesh) == pytest.approx(238, rel=1e-12)
    assert materials(room) == {"plaster", "Wood"}
    assert sorted(s.name for s in room.mesh.surfaces) == list("123456")
    assert [s.group for s in room.mesh.surfaces][4] == "floor"  # as walls of a box are ordered
    assert findings == ()


def test_a_plane_written_with_backslashes_reflects_on_its_other_side(tmp_path):
    """Plane 6 of the box lists its corners the other way round, and nothing needs turning."""
    turned = BOX.replace("[ 6 wall \\ 1 4 8 5 \\ plaster ]", "[ 6 wall / 1 4 8 5 / plaster ]")
    _, plain = read_room(RoomSpec(file=written(tmp_path, BOX)))
    _, reported = read_room(RoomSpec(file=written(tmp_path, turned, "turned.geo")))
    assert plain == ()
    assert [f.code for f in reported] == [Code.AIR_REACHED] and "turned ('6'" in reported[
        0
    ].sentence


def test_expressions_includes_and_mirrors_make_a_hall_of_known_volume(tmp_path):
    """deep = 6 + 1 - 1 = 6: 8 x 6 m2 and 4 x 6 m2 of floor, 3 m high; surfaces by hand."""
    written(tmp_path, PARTS, "Parts.GEO")
    room, findings = read_room(RoomSpec(file=written(tmp_path, HALL)))
    assert volume_m3(room.mesh) == pytest.approx(72 * 3, rel=1e-12)
    outline_m = 8 + 2 * (6 + 2 + 6) + 4
    assert surface_area_m2(room.mesh) == pytest.approx(2 * 72 + 3 * outline_m, rel=1e-12)
    assert materials(room) == {"parquet", "brick", "tiles"}
    assert [f.code for f in findings] == [Code.MATERIALS_JOINED]
    numbers = {s.name for s in room.mesh.surfaces}
    assert numbers == {"1", "2", "3", "4", "204", "5", "205", "6", "206", "7"}


def test_a_door_is_cut_out_of_its_wall(tmp_path):
    """A door of 1 m by 2 m on the floor and a window of .5 m2 in a wall of 20 m2."""
    text = BOX.replace(
        "[ 5 wall /\n   3 4 8 7 / plaster* ]",
        "[ 5 wall / 3 4 8 7 / \n\t(door / 20 21 22 23 / wood)\n\t(window / 24 25 26 27 / glass)\n"
        "\t(wall / 3 4 8 7 / plaster) ]",
    ).replace(
        "\nPLANES",
        "20 0 1 0\n21 0 2 0\n22 0 2 2\n23 0 1 2\n24 0 3 1\n25 0 4 1\n26 0 4 1.5\n27 0 3 1.5\n"
        "PLANES",
    )
    room, findings = read_room(RoomSpec(file=written(tmp_path, text)))
    assert findings == ()
    assert volume_m3(room.mesh) == pytest.approx(220, rel=1e-12)
    areas = {}
    for area, owner in zip(triangle_areas_m2(room.mesh), room.mesh.triangle_surface, strict=True):
        surface = room.mesh.surfaces[owner]
        key = (surface.name, surface.group)
        areas[key] = areas.get(key, 0.0) + area
    assert areas["5", "door"] == pytest.approx(2, rel=1e-9)
    assert areas["5", "window"] == pytest.approx(0.5, rel=1e-9)
    assert areas["5", "wall"] == pytest.approx(17.5, rel=1e-9)


polygons = st.lists(st.floats(0.3, 1.0), min_size=3, max_size=9)


def star(radii: list[float], middle: tuple[float, float], axes: np.ndarray) -> np.ndarray:
    """A polygon that is seen whole from its middle, in the plane of two axes."""
    angles = 2 * np.pi * np.arange(len(radii)) / len(radii)
    flat = np.stack([np.cos(angles), np.sin(angles)], axis=1) * np.array(radii)[:, None]
    return (flat + middle) @ axes


@given(polygons, polygons, st.tuples(st.floats(-1, 1), st.floats(-1, 1)))
@settings(max_examples=60)
def test_what_a_part_leaves_agrees_with_a_raster_of_points(first, second, middle):
    """Area of second without first, counted on a grid of points in their plane."""
    axes = np.array([[2.0, 1.0, 2.0], [-2.0, 2.0, 1.0]]) / 3.0
    one, other = star(first, (0.0, 0.0), axes), star(second, middle, axes)
    _, left = cut_parts([one, other])
    step = 0.02
    grid = np.stack(np.meshgrid(*[np.arange(-2, 2, step)] * 2), axis=-1).reshape(-1, 2)
    only = within(grid, other @ axes.T) & ~within(grid, one @ axes.T)
    # the grid errs by at most a strip of one step along both outlines (each shorter than 20 m)
    # times the share of a random half-step; 1 % of the 4 m2 seen stays above it
    assert area_m2(left) == pytest.approx(only.sum() * step**2, abs=0.04)


def within(points: np.ndarray, ring: np.ndarray) -> np.ndarray:
    """Even-odd rule: another way than triangles."""
    inside = np.zeros(len(points), dtype=bool)
    for (ax, ay), (bx, by) in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        crosses = (ay > points[:, 1]) != (by > points[:, 1])
        if ay != by:
            inside ^= crosses & (points[:, 0] < (bx - ax) * (points[:, 1] - ay) / (by - ay) + ax)
    return inside


def test_a_panel_has_a_front_and_a_back_and_its_image_too(tmp_path):
    """An included object, moved and mirrored: 2 m2 on each side of the room."""
    panel = """
    OBJECT
    TRANSLATE 3 2 1
    OFFSETPL 100
    OFFSETCO 80
    MIRROR 100 200
    CORNERS
    0  0 -1 0
    1  x(0) y(0) z(0)+1
    2  0  1 z(1)
    3  0  1 0
    PLANES
    [0 front / 0 1 2 3 / panel*]
    [1 back \\ 0 1 2 3 \\ panel*]
    """
    written(tmp_path, panel, "panel.geo")
    shifted = BOX.replace(" 11.00", " 5.50").replace(" 0.00 0.00", " -5.50 0.00")
    shifted = shifted.replace(" 0.00 5.00", " -5.50 5.00").replace(" -0.00 0.00 4", " -5.50 0.00 4")
    path = written(tmp_path, "INCLUDE panel\n" + shifted)
    room, findings = read_room(RoomSpec(file=path))
    assert findings == ()
    assert volume_m3(room.mesh) == pytest.approx(220, rel=1e-12)
    names = [room.mesh.surfaces[s].group for s in room.mesh.triangle_surface]
    sheet = np.isin(names, ["front", "back"])
    assert triangle_areas_m2(room.mesh)[sheet].sum() == pytest.approx(8, rel=1e-12)
    xs = np.unique(room.mesh.vertices_m[room.mesh.triangles[sheet].ravel()][:, 0])
    np.testing.assert_array_equal(xs, [-3, 3])


def test_loops_of_corners_and_planes_make_a_drum(tmp_path):
    """A prism over a regular dodecagon: area 3 r2 for r = 2, by its textbook formula."""
    text = """
    CORNERS
    loop(1,i,0,360,30,2*cos(i),2*sin(i),0)
    loop(21,i,0,360,30,2*cos(i),2*sin(i),2.5)
    PLANES
    [*12 1 side // 1 2 22 21 / steel]
    [20 floor / 1-12 / steel]
    [21 ceiling /32-21/ steel]
    """
    room, _ = read_room(RoomSpec(file=written(tmp_path, text)))
    assert volume_m3(room.mesh) == pytest.approx(12 * 2.5, rel=1e-9)
    assert surface_area_m2(room.mesh) == pytest.approx(
        2 * 12 + 12 * 4 * math.sin(math.radians(15)) * 2.5, rel=1e-9
    )


@pytest.mark.parametrize(
    ("old", "new", "words", "shown"),
    [
        ("CORNERS", "COPY 5 2 0 0 0 1 1 1 0 0 0\nCORNERS", "not supported", "COPY 5 2"),
        ("CORNERS", "IF balcony THEN\nCORNERS", "not supported", "line 7"),
        ("1 11.00 5.00 0.00", "1 cut(2 3 4) 5 0", "not understood", "cut("),
        ("1 11.00 5.00 0.00", "1 11.00 5.00", "three coordinates", "1 11.00 5.00"),
        ("1 11.00 5.00 0.00", "1 y(1) 5 0", "circle", "corner 1"),
        ("1 11.00 5.00 0.00", "1 1/0 5 0", "no value", "1/0"),
        ("1 11.00 5.00 0.00", "1 1e400 5 0", "finite", "inf"),
        ("1 11.00 5.00 0.00", "1 wide 5 0", "not defined", "wide"),
        ("1 11.00 5.00 0.00", "2 11.00 5.00 0.00", "given twice", "corner number"),
        ("1 11.00 5.00 0.00", "1 11 5 lock(2 3 3)", "no solution", "along z"),
        ("/ 1 4 3 2 /", "/ 1 4 3 9 /", "no corner", "9"),
        ("/ 1 4 3 2 /", "/ 1 4 /", "fewer than three", "1 4"),
        ("/ 1 4 3 2 / WOOD", "/ 1 4 3 2 / ", "not understood", "floor"),
        ("[ 2 ceiling", "[ 1 ceiling", "plane number is given twice", "1"),
        ("\\ plaster ]", "\\ plaster ", "not closed", "wall"),
        ("ABS Wood = <12 10 8 7 5 4>", "ABS Wood", "ABS statement", "Wood"),
        ("CORNERS", "INCLUDE stage\nCORNERS", "does not exist", "stage.geo"),
        ("CORNERS", "INCLUDE room\nCORNERS", "includes itself", "room.geo"),
        ("CORNERS", "GLOBAL w = 2\nLOCAL w = 3\nLOCAL w = 4\nCORNERS", "given twice", "w"),
        ("\nPLANES", "MIRROR 100 200\nPLANES", "above CORNERS", "MIRROR"),
        ("CORNERS", "MIRROR 4 200\nCORNERS", "same number", "corner"),
    ],
)
def test_what_cannot_be_read_is_reported_with_its_line(tmp_path, old, new, words, shown):
    assert old in BOX
    path = written(tmp_path, BOX.replace(old, new, 1))
    with pytest.raises(InputError, match=words) as caught:
        read_room(RoomSpec(file=path))
    assert shown in str(caught.value)
    assert "line" in str(caught.value.where)


def test_parts_that_leave_a_hole_or_hide_each_other_are_refused(tmp_path):
    corners = "\n20 0 1 0\n21 0 2 0\n22 0 2 2\n23 0 1 2\nPLANES"
    wall, door = "(wall / 3 4 8 7 / plaster)", "(door / 20 21 22 23 / wood)"
    for parts, words in ((door, "do not make up"), (wall + door, "hidden")):
        text = BOX.replace("3 4 8 7 / plaster* ]", f"3 4 8 7 / {parts} ]")
        path = written(tmp_path, text.replace("\nPLANES", corners))
        with pytest.raises(InputError, match=words):
            read_room(RoomSpec(file=path))


# ------------------------------------------------------------------------------------------ DXF


def drawing(unit: int = 6):
    document = ezdxf.new("R2010", setup=False)
    document.header["$INSUNITS"] = unit
    return document, document.modelspace()


def saved(document, folder: Path, name: str = "room.dxf", **how) -> Path:
    document.saveas(folder / name, **how)
    return folder / name


BOX_CORNERS = [(x, y, z) for z in (0, 3) for y in (0, 4) for x in (0, 5)]
QUADS = {
    "west": (0, 4, 6, 2),
    "east": (1, 3, 7, 5),
    "south": (0, 1, 5, 4),
    "north": (2, 6, 7, 3),
    "floor": (0, 2, 3, 1),
    "ceiling": (4, 5, 7, 6),
}


def quad(name: str, scale: float = 1.0) -> list[tuple[float, ...]]:
    return [tuple(scale * v for v in BOX_CORNERS[c]) for c in QUADS[name]]


def as_faces(space, scale=1.0):
    for name in QUADS:
        space.add_3dface(quad(name, scale), dxfattribs={"layer": name})


def as_closed_polylines(space, scale=1.0):
    """Horizontal ones as LWPOLYLINE with an elevation, the others as 3D polylines."""
    for name in QUADS:
        points, attributes = quad(name, scale), {"layer": name}
        if name in ("floor", "ceiling"):
            attributes["elevation"] = points[0][2]
            flat = [p[:2] for p in points]
            space.add_lwpolyline(flat, close=True, dxfattribs=attributes)
        else:
            space.add_polyline3d(points, close=True, dxfattribs=attributes)


def as_polyface(space, scale=1.0):
    for name in QUADS:
        builder = MeshBuilder()
        builder.add_face(quad(name, scale))
        builder.render_polyface(space, dxfattribs={"layer": name})


def as_mesh(space, scale=1.0):
    for name in QUADS:
        builder = MeshBuilder()
        builder.add_face(quad(name, scale))
        builder.render_mesh(space, dxfattribs={"layer": name})


def as_block(space, scale=1.0):
    """A unit cube on layer 0 of a block, stretched, turned and moved by its insertion."""
    block = space.doc.blocks.new("CUBE")
    for face in cube(center=False).faces_as_vertices():
        block.add_3dface(face, dxfattribs={"layer": "0"})
    sizes = {"xscale": 5 * scale, "yscale": 4 * scale, "zscale": 3 * scale, "rotation": 30}
    space.add_blockref("CUBE", (7, -2, 1), dxfattribs={"layer": "shell", **sizes})


@pytest.mark.parametrize("draw", [as_faces, as_closed_polylines, as_polyface, as_mesh, as_block])
@pytest.mark.parametrize("form", ["asc", "bin"])
def test_each_way_to_draw_a_box_gives_its_volume(tmp_path, draw, form):
    document, space = drawing()
    draw(space)
    room, findings = read_room(RoomSpec(file=saved(document, tmp_path, fmt=form)))
    assert volume_m3(room.mesh) == pytest.approx(60, rel=1e-9)
    assert surface_area_m2(room.mesh) == pytest.approx(94, rel=1e-9)
    assert materials(room) == ({"shell"} if draw is as_block else set(QUADS))
    assert [f.code for f in findings if f.severity != "info"] == []


@pytest.mark.parametrize(("unit", "scale"), [(1, 1 / 0.0254), (2, 1 / 0.3048), (4, 1e3), (5, 1e2)])
def test_the_unit_of_the_drawing_is_obeyed_and_can_be_overruled(tmp_path, unit, scale):
    document, space = drawing(unit)
    as_faces(space, scale)
    path = saved(document, tmp_path)
    mesh, _ = read_mesh(RoomSpec(file=path))
    assert volume_m3(mesh) == pytest.approx(60, rel=1e-9)
    overruled, _ = read_mesh(RoomSpec(file=path, unit="cm"))
    assert volume_m3(overruled) == pytest.approx(60 * (scale / 100) ** 3, rel=1e-9)


def test_a_drawing_without_a_unit_needs_one(tmp_path):
    document, space = drawing(0)
    as_faces(space)
    path = saved(document, tmp_path)
    with pytest.raises(InputError, match="unit of the room file"):
        read_mesh(RoomSpec(file=path))
    mesh, _ = read_mesh(RoomSpec(file=path, unit="m"))
    assert volume_m3(mesh) == pytest.approx(60, rel=1e-12)


def test_nested_rows_of_blocks_land_where_another_program_puts_them(tmp_path):
    """Corners compared with those of ezdxf's own explosion of the same drawing."""
    document, space = drawing()
    as_block(space, 0.1)
    outer = document.blocks.new("ROW")
    grid = {"row_count": 2, "column_count": 3, "row_spacing": 9, "column_spacing": 7}
    outer.add_blockref("CUBE", (1, 2, 3), dxfattribs={**grid, "rotation": 20})
    space.delete_all_entities()
    space.add_blockref("ROW", (10, 0, 0), dxfattribs={"xscale": -1, "layer": "seats"})
    model, _ = read_model(RoomSpec(file=saved(document, tmp_path)))
    assert {face.surface.file_material for face in model.faces} == {"seats"}

    pieces = recursive_decompose(space)
    expected = {tuple(np.round(v, 6)) for piece in pieces for v in piece.wcs_vertices()}
    assert {tuple(np.round(v, 6)) for v in model.vertices} == expected
    assert len(expected) == 48


def test_what_is_no_face_is_counted_and_hidden_layers_are_reported(tmp_path):
    document, space = drawing()
    as_faces(space)
    space.add_line((0, 0), (1, 1))
    space.add_line((0, 0), (2, 1))
    space.add_lwpolyline([(0, 0), (1, 1), (2, 0)])
    document.layers.add("old walls").off()
    space.add_3dface([(0, 0, 1), (1, 0, 1), (1, 1, 1)], dxfattribs={"layer": "old walls"})
    room, findings = read_room(RoomSpec(file=saved(document, tmp_path)))
    assert volume_m3(room.mesh) == pytest.approx(60, rel=1e-12)
    reported = {f.code: f for f in findings}
    assert dict(reported[Code.ENTITIES_IGNORED].evidence) == {"LINE": 2, "open LWPOLYLINE": 1}
    assert dict(reported[Code.LAYERS_IGNORED].evidence) == {"old walls": 1}


@pytest.mark.parametrize(
    ("draw", "words"),
    [
        (lambda s: setattr(s.add_3dsolid(), "sat", ["400 0 1 0"]), "solid modeller"),
        (lambda s: setattr(s.add_region(), "sat", ["400 0 1 0"]), "solid modeller"),
        (lambda s: s.add_line((0, 0), (1, 0), dxfattribs={"thickness": 3}), "thickness"),
        (
            lambda s: s.add_lwpolyline([(0, 0, 0, 0, 1), (1, 0, 0, 0, 0), (1, 1)], close=True),
            "curved",
        ),
        (lambda s: s.add_blockref("GONE", (0, 0)), "not in the file"),
    ],
)
def test_surfaces_that_would_be_lost_are_an_error(tmp_path, draw, words):
    document, space = drawing()
    as_faces(space)
    draw(space)
    with pytest.raises(InputError, match="drawing") as caught:
        read_mesh(RoomSpec(file=saved(document, tmp_path)))
    assert words in str(caught.value)


# --------------------------------------------------------------------------------- damaged files


def small_dxf() -> bytes:
    with TemporaryDirectory() as folder:
        document, space = drawing()
        as_faces(space)
        as_polyface(space)
        as_block(space)
        return saved(document, Path(folder)).read_bytes()


GOOD = {"room.geo": BOX.encode(), "hall.geo": (PARTS + HALL).replace("INCLUDE parts", "").encode()}
GOOD["room.dxf"] = small_dxf()


def test_long_chains_and_deep_brackets_end_in_an_error_and_not_in_a_crash(tmp_path):
    deep = BOX.replace("1 11.00 5.00 0.00", "1 " + "(" * 5000 + "1" + ")" * 5000 + " 5 0")
    chain = "CORNERS\n" + "".join(f"{k} x({k + 1}) 0 0\n" for k in range(3000))
    for text, words in ((deep, "too many brackets"), (chain + "PLANES\n[1 a/0 1 2/b]", "circle")):
        with pytest.raises(InputError, match=words):
            read_mesh(RoomSpec(file=written(tmp_path, text)))
