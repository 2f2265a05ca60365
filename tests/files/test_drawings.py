"""Rooms as people draw them: the volume and area of the air inside, or a refusal with its cause."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest
import trimesh
from trimesh.visual.material import PBRMaterial

from roomfit.base.errors import InputError
from roomfit.base.findings import Code
from roomfit.base.polygon import triangulate
from roomfit.files.inputs import check_room
from roomfit.files.rooms import read_mesh, read_room
from roomfit.files.schema import RoomSpec
from roomfit.room.inside import is_inside
from roomfit.room.mesh import surface_area_m2, volume_m3
from roomfit.room.scene import Point, position_findings

HEIGHT_M = 3.5
PLANS = {
    "box": [(0, 0), (6, 0), (6, 4), (0, 4)],
    "L": [(0, 0), (7, 0), (7, 3), (3, 3), (3, 6), (0, 6)],
}
SIZES = {"box": (84.0, 118.0), "L": (105.0, 151.0)}  # by hand
Polygons = list[tuple[str, list]]


def prism(plan, low: float, high: float, name: str) -> Polygons:
    """A closed body over a plan, its corners counter-clockwise from outside."""
    n, rings = len(plan), [[(x, y, z) for x, y in plan] for z in (low, high)]
    sides = [
        [rings[0][i], rings[0][(i + 1) % n], rings[1][(i + 1) % n], rings[1][i]] for i in range(n)
    ]
    return [
        (f"{name} floor", rings[0][::-1]),
        (f"{name} ceiling", rings[1]),
        *((f"{name} {i}", side) for i, side in enumerate(sides)),
    ]


def rectangle(x: float, y: float, dx: float, dy: float) -> list:
    return [(x, y), (x + dx, y), (x + dx, y + dy), (x, y + dy)]


def turned(polygons: Polygons) -> Polygons:
    return [(name, corners[::-1]) for name, corners in polygons]


def some_turned(polygons: Polygons) -> Polygons:
    rng = np.random.default_rng(4)
    return [(n, c[::-1] if rng.random() < 0.5 else c) for n, c in polygons]


def about(plan, by: float) -> list:
    """The plan grown by the thickness of its walls: all corners are right angles."""
    p, out = np.array(plan, dtype=float), []
    for before, at, after in zip(np.roll(p, 1, 0), p, np.roll(p, -1, 0), strict=True):
        edges = [(b - a) / np.linalg.norm(b - a) for a, b in ((before, at), (at, after))]
        out.append(tuple(at + by * sum(np.array([e[1], -e[0]]) for e in edges)))
    return out


def drawn(plan, kind: str) -> tuple[Polygons, float, float]:
    """A room drawn in one of the ways, and by how much volume and area differ from the bare one."""
    room = prism(plan, 0.0, HEIGHT_M, "room")
    panel = [(0.5, 0.5, 2.8), (2.5, 0.5, 2.8), (2.5, 2.0, 2.8), (0.5, 2.0, 2.8)]
    leg = prism(rectangle(1, 1, 0.5, 0.5), -0.1, 0.8, "leg")
    stands = prism(rectangle(1, 1, 1, 1), 0.0, 1.0, "cabinet")
    more: dict[str, tuple[Polygons, float, float]] = {
        "inwards": (turned(room), 0.0, 0.0),
        "two-sided": ([q for p in room for q in (p, (p[0], p[1][::-1]))], 0.0, 0.0),
        "two-sided, backs behind": (room + turned(room), 0.0, 0.0),
        "at random": (some_turned(room), 0.0, 0.0),
        "thick walls": (room + prism(about(plan, 0.25), -0.25, 3.75, "shell"), 0.0, 0.0),
        "canopy": ([*room, ("canopy", panel)], 0.0, 6.0),
        "canopy with two faces": ([*room, ("top", panel), ("below", panel[::-1])], 0.0, 6.0),
        "second room": (room + prism(rectangle(10, 0, 3, 3), 0.0, 3.0, "other"), 0.0, 0.0),
        "room next door": (room + prism(rectangle(-3.2, 0, 3, 3), 0.0, 3.0, "other"), 0.0, 0.0),
        "table": (room + some_turned(prism(rectangle(1, 1, 2, 1), 0.7, 0.8, "table")), -0.2, 4.6),
        "cabinet on the floor": (room + stands, -1.0, 4.0),
        "leg sunk into the floor": (room + leg, -0.2, 1.6),
        "door upon a wall": ([*room, ("door", [(1, 0, 0), (2, 0, 0), (2, 0, 2), (1, 0, 2)])], 0, 0),
    }  # fmt: skip
    return more[kind]


KINDS = (
    *("inwards", "two-sided", "two-sided, backs behind", "at random", "thick walls", "canopy"),
    *("canopy with two faces", "second room", "room next door", "table", "cabinet on the floor"),
    *("leg sunk into the floor", "door upon a wall"),
)


def collada(polygons: Polygons, unit_m: float) -> str:
    """Each polygon a geometry of its own in a file of the smallest kind, z up."""
    libraries: dict[str, list[str]] = {"effects": [], "materials": [], "geometries": []}
    nodes = []
    for k, (name, corners) in enumerate(polygons):
        n, numbers = len(corners), " ".join(f"{x / unit_m:.8g}" for c in corners for x in c)
        libraries["effects"].append(
            f'<effect id="e{k}"><profile_COMMON><technique sid="t"><lambert/></technique>'
            "</profile_COMMON></effect>"
        )
        libraries["materials"].append(
            f'<material id="m{k}" name="{name}"><instance_effect url="#e{k}"/></material>'
        )
        libraries["geometries"].append(
            f'<geometry id="g{k}" name="{name}"><mesh><source id="s{k}"><float_array id="f{k}" '
            f'count="{3 * n}">{numbers}</float_array><technique_common><accessor source="#f{k}" '
            f'count="{n}" stride="3">' + "".join(f'<param name="{a}" type="float"/>' for a in "XYZ")
            + f'</accessor></technique_common></source><vertices id="v{k}"><input '
            f'semantic="POSITION" source="#s{k}"/></vertices><polylist material="x" count="1">'
            f'<input semantic="VERTEX" source="#v{k}" offset="0"/><vcount>{n}</vcount>'
            f"<p>{' '.join(map(str, range(n)))}</p></polylist></mesh></geometry>"
        )  # fmt: skip
        nodes.append(
            f'<node><instance_geometry url="#g{k}"><bind_material><technique_common>'
            f'<instance_material symbol="x" target="#m{k}"/></technique_common></bind_material>'
            "</instance_geometry></node>"
        )
    parts = "".join(f"<library_{k}>{''.join(v)}</library_{k}>" for k, v in libraries.items())
    return (
        '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>'
        f'<unit meter="{unit_m}"/><up_axis>Z_UP</up_axis></asset>{parts}<library_visual_scenes>'
        f'<visual_scene id="V">{"".join(nodes)}</visual_scene></library_visual_scenes><scene>'
        '<instance_visual_scene url="#V"/></scene></COLLADA>'
    )


def saved(folder: Path, polygons: Polygons, suffix: str) -> RoomSpec:
    """Polygons as OBJ and, in inches, COLLADA; triangles, with own corners, as STL and GLB."""
    path = folder / f"room{suffix}"
    if suffix == ".dae":
        path.write_text(collada(polygons, 0.0254))
        return RoomSpec(file=path)
    if suffix == ".obj":
        lines, n = [], 1
        for name, corners in polygons:
            lines += [f"o {name}", f"usemtl {name}"]
            lines += ["v {:.6f} {:.6f} {:.6f}".format(*corner) for corner in corners]
            lines.append("f " + " ".join(str(n + k) for k in range(len(corners))))
            n += len(corners)
        path.write_text("\n".join(lines))
        return RoomSpec(file=path, unit="m")
    scene = trimesh.Scene()
    for k, (name, corners) in enumerate(polygons):
        points = np.array(corners, dtype=float)
        soup = points[triangulate(points).triangles].reshape(-1, 3)
        part = trimesh.Trimesh(soup, np.arange(len(soup)).reshape(-1, 3), process=False)
        part.visual = trimesh.visual.TextureVisuals(material=PBRMaterial(name=name))
        scene.add_geometry(part, node_name=f"{name} {k}", geom_name=f"{name} {k}")
    if suffix == ".stl":
        scene.to_geometry().export(path)
        return RoomSpec(file=path, unit="m", materials={"room": "wall"})
    path.write_bytes(scene.export(file_type="glb"))
    return RoomSpec(file=path, up="z")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("shape", "suffix"), [*product(PLANS, (".obj", ".stl", ".glb")), ("L", ".dae")]
)
def test_however_a_room_is_drawn_it_is_the_air_inside(tmp_path, shape, kind, suffix):
    polygons, more_m3, more_m2 = drawn(PLANS[shape], kind)
    room, _ = read_room(saved(tmp_path, polygons, suffix))
    volume, area = SIZES[shape]
    # flights may miss a sliver where faces are cut; else STL and GLB have seven digits
    within = 5e-5 if "sunk" in kind else 1e-5
    assert volume_m3(room.mesh) == pytest.approx(volume + more_m3, rel=within)
    assert surface_area_m2(room.mesh) == pytest.approx(area + more_m2, rel=within)


LONG = {
    "U": [(0, 0), (43, 0), (43, 40), (41, 40), (41, 2), (2, 2), (2, 40), (0, 40)],
    "L": [(0, 0), (60, 0), (60, 1.5), (1.5, 1.5), (1.5, 60), (0, 60)],
    "niche at the far end": [(0, 0), (120, 0), (120, 2), (119.5, 2), (119.5, 2.3), (0, 2.3)],
}


@pytest.mark.parametrize("positions", [(), [(0.6, 0.6, 1.2)]])
@pytest.mark.parametrize("name", LONG)
def test_a_corridor_is_followed_to_its_ends(tmp_path, name, positions):
    """By the shoelace formula, wherever the flights begin: at a largest face, or at one end."""
    x, y = np.transpose(LONG[name])
    area = 0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    around = np.hypot(x - np.roll(x, -1), y - np.roll(y, -1)).sum()
    spec = saved(tmp_path, some_turned(prism(LONG[name], 0.0, 2.5, "room")), ".obj")
    room, findings = read_room(spec, positions)
    assert volume_m3(room.mesh) == pytest.approx(2.5 * area, rel=1e-9)
    assert surface_area_m2(room.mesh) == pytest.approx(2 * area + 2.5 * around, rel=1e-9)
    assert {f.code for f in findings} == {Code.AIR_REACHED}


@pytest.mark.parametrize("beyond", [0.0, 0.3])
def test_a_wall_of_one_sheet_across_faces_that_go_on_behind_it_makes_two_rooms(tmp_path, beyond):
    """9 m x 5 m x 3 m at x = 4 m, ending at floor, walls and ceiling, or beyond them."""
    y, z = (-beyond, 5 + beyond), (-beyond, 3 + beyond)
    sheet = [(4, y[0], z[0]), (4, y[1], z[0]), (4, y[1], z[1]), (4, y[0], z[1])]
    polygons = [*prism(rectangle(0, 0, 9, 5), 0.0, 3.0, "room"), ("partition", sheet)]
    spec = saved(tmp_path, polygons, ".obj")
    for at_m, volume, area in (
        ([(1, 1, 1), (2, 4, 1), (8, 2, 1)], 60.0, 94.0),
        ([(1, 1, 1), (6, 3, 1), (8, 2, 1)], 75.0, 110.0),
        ([], 75.0, 110.0),
    ):
        room, findings = read_room(spec, at_m)
        found = volume_m3(room.mesh), surface_area_m2(room.mesh)
        assert found == pytest.approx((volume, area), rel=1e-6)
        (said,) = (f for f in findings if f.code is Code.SEVERAL_SPACES)
        assert (said.severity, said.evidence["n_spaces"]) == ("warning", 2)
        assert ("with 2 of 3" in said.sentence) == ("with 1 of 3" in said.sentence) == bool(at_m)


@pytest.mark.parametrize("turn", [list, turned])
@pytest.mark.parametrize("other", [(4, 0, 5, 5), (4, 1, 5, 3)])
def test_of_two_faces_back_to_back_each_room_has_its_own(tmp_path, turn, other):
    """Of two boxes that share a wall or a part of it, fronts of both outwards or inwards."""
    a = prism(rectangle(0, 0, 4, 5), 0.0, 3.0, "a")
    spec = saved(tmp_path, turn(a + prism(rectangle(*other), 0.0, 3.0, "b")), ".obj")
    for at_m, name, size in (((1, 2, 1), "a", (4, 5)), ((7, 2, 1), "b", other[2:])):
        room, _ = read_room(spec, [at_m])
        assert volume_m3(room.mesh) == pytest.approx(3 * np.prod(size), rel=1e-6)
        assert {material[0] for material in room.materials} == {name}


@pytest.mark.parametrize("shape", PLANS)
def test_a_missing_wall_is_a_leak_of_its_size_and_bodies_that_cross_are_named(tmp_path, shape):
    """The flights that would end on the wall's 21 and 24.5 m2; two boxes over 8 m2 of one plan."""
    polygons = [p for p in prism(PLANS[shape], 0.0, HEIGHT_M, "room") if p[0] != "room 0"]
    leak = next(f for f in check_room(saved(tmp_path, polygons, ".obj")).findings if f.error)
    assert leak.code is Code.LEAK and ", 0.000, " in leak.sentence  # y = 0
    assert 0.7 < leak.evidence["area_m2"] / (HEIGHT_M * PLANS[shape][1][0]) < 1.0
    polygons = prism(PLANS[shape], 0.0, 3.0, "a") + prism(rectangle(2, 1, 7, 7), 0.0, 3.0, "b")
    with pytest.raises(InputError, match=r"run through each other\n.*'[ab] [0-9](.*\n)*.*unite"):
        read_room(saved(tmp_path, polygons, ".obj"))


def test_the_room_is_the_space_of_most_positions_and_the_others_are_said_to_be_elsewhere(tmp_path):
    """A small room beside a large one, with a cabinet: by positions, and by size without any."""
    small = prism(rectangle(10, 0, 3, 3), 0.0, 3.0, "small")
    polygons = drawn(PLANS["L"], "cabinet on the floor")[0] + small
    spec = saved(tmp_path, polygons, ".obj")
    at_m = {"S": (11, 1, 1), "R": (12, 2, 1), "far": (0.5, 3, 1), "in": (1.5, 1.5, 0.5)}
    mesh, findings = read_mesh(spec, [at_m["S"], at_m["R"], at_m["far"]])
    assert volume_m3(mesh) == pytest.approx(27.0)
    (said,) = (f for f in findings if f.code is Code.SEVERAL_SPACES)
    assert "27 m3 with 2 of 3 positions" in said.sentence and "105 m3 with 1 of" in said.sentence
    room, findings = read_room(spec)
    assert volume_m3(room.mesh) == pytest.approx(104.0)
    assert is_inside(room.mesh, np.array(list(at_m.values()))).tolist() == [
        False,
        False,
        True,
        False,
    ]
    wrong = position_findings(room, [Point(k, np.array(p, float)) for k, p in at_m.items()], [])
    wrong = [f for f in wrong if f.code is Code.POSITION_OUTSIDE]
    assert ["within a body" in f.sentence for f in wrong] == [False, False, True]


def test_a_plan_and_heights_are_a_room_with_materials_by_wall():
    """The shoelace formula, and a gable of two triangles and two slopes of 8 x 5 m2, by hand."""
    plan = PLANS["L"][::-1]
    room, findings = read_room(RoomSpec(plan=plan, height=HEIGHT_M, materials={"wall 2": "glass"}))
    assert (volume_m3(room.mesh), findings) == (pytest.approx(105.0), ())
    assert str(room).startswith("Room of 105.00 m3 and 151.00 m2: ") and "glass" in str(room)
    gabled, heights = [(0, 0), (8, 0), (8, 3), (8, 6), (0, 6), (0, 3)], [3, 3, 7, 3, 3, 7]
    names = {"walls": "brick", "ceiling": "wood"}
    room, _ = read_room(RoomSpec(plan=gabled, height=heights, materials=names))
    expected = "Room of 240.00 m3 and 236.00 m2: brick 108.00 m2, floor 48.00 m2, wood 80.00 m2"
    assert repr(room) == expected
    with pytest.raises(InputError, match=r"heights do not go with the plan(.*\n)*.*1 or as many"):
        read_room(RoomSpec(plan=plan, height=[3.0, 2.0]))
    for heights in ([4, 4, 3, 2], [4, 3, 3, 3]):
        with pytest.raises(InputError, match=r"no roof(.*\n)*.*two highest corners that are no"):
            read_room(RoomSpec(plan=PLANS["box"], height=heights))
    with pytest.raises(InputError, match=r"a height without a plan(.*\n)*.*leave height out"):
        RoomSpec(shoebox=(6, 5, 3), height=3.0)
    for few in ([], [(0, 0)], [(0, 0), (4, 0)]):
        with pytest.raises(ValueError, match="at least 3 items"):
            RoomSpec(plan=few, height=3.0)
    crossed = RoomSpec(plan=[(0, 0), (4, 3), (4, 0), (0, 2)], height=3.0)
    assert Code.SELF_INTERSECTING_POLYGON in [f.code for f in read_room(crossed)[1]]
