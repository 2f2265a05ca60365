"""Rooms in COLLADA and IFC, written by pycollada and ifcopenshell: volumes, names, units, axes."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest

from roomfit.base.errors import InputError, RoomfitError
from roomfit.base.findings import Code
from roomfit.files.draft import likely_units
from roomfit.files.inputs import check_room
from roomfit.files.rooms import read_mesh, read_model, read_room
from roomfit.files.schema import RoomSpec
from roomfit.room.mesh import volume_m3
from roomfit.room.scene import material_areas_m2

collada = pytest.importorskip("collada")
SIZE_M = np.array([6.0, 5.0, 3.0])
SIDES = ("floor", "ceiling", "south", "east", "north", "west")
# corners of a unit cube, z up, and its sides in the order of SIDES
CUBE = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=np.float64)
QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [1, 5, 7, 3], [2, 3, 7, 6], [0, 2, 6, 4]]


def collada_box(
    unit_m: float | None = 1.0, up: str = "Z_UP", *, triangles: bool = False, moved_m: float = 0.0
) -> bytes:
    """Return a box of 6 x 5 x 3 m whose floor is of carpet and whose other sides are of plaster.

    As x, y, z of any `up` lie; a node moves it along its first axis, and a line crosses it.
    """
    file = collada.Collada()
    factor = 1.0 if unit_m is None else unit_m
    file.assetInfo.upaxis = up
    if unit_m is not None:
        file.assetInfo.unitname, file.assetInfo.unitmeter = "own", unit_m
    corners = CUBE * SIZE_M / factor
    # the inverse of what reading does
    x, y, z = corners.T
    corners = {
        "Z_UP": corners,
        "Y_UP": np.stack([x, z, -y], axis=1),
        "X_UP": np.stack([z, x, y], axis=1),
    }[up]
    effects = [collada.material.Effect(f"e{i}", [], "phong") for i in range(2)]
    kinds = [
        collada.material.Material(f"m{i}", name, effect)
        for i, (name, effect) in enumerate(zip(("carpet", "plaster"), effects, strict=True))
    ]
    for effect, kind in zip(effects, kinds, strict=True):
        file.effects.append(effect)
        file.materials.append(kind)
    nodes = []
    for number, (name, quad) in enumerate(zip(SIDES, QUADS, strict=True)):
        source = collada.source.FloatSource(f"c{number}", corners.ravel(), ("X", "Y", "Z"))
        geometry = collada.geometry.Geometry(file, f"g{number}", name, [source])
        inputs = collada.source.InputList()
        inputs.addInput(0, "VERTEX", f"#c{number}")
        a, b, c, d = quad
        if triangles:
            own = geometry.createTriangleSet(np.array([a, b, c, a, c, d]), inputs, "symbol")
        else:
            own = geometry.createPolylist(np.array(quad), np.array([4]), inputs, "symbol")
        geometry.primitives.append(own)
        if name == "floor":
            geometry.primitives.append(geometry.createLineSet(np.array([0, 7]), inputs, "symbol"))
        file.geometries.append(geometry)
        kind = collada.scene.MaterialNode("symbol", kinds[name != "floor"], inputs=[])
        nodes.append(collada.scene.GeometryNode(geometry, [kind]))
    moved = collada.scene.TranslateTransform(moved_m / factor, 0.0, 0.0)
    node = collada.scene.Node("room", children=nodes, transforms=[moved])
    file.scene = collada.scene.Scene("scene", [node])
    file.scenes.append(file.scene)
    stream = io.BytesIO()
    file.write(stream)
    return stream.getvalue()


def written(folder: Path, name: str, content: bytes) -> Path:
    (folder / name).write_bytes(content)
    return folder / name


@pytest.mark.parametrize("up", ["Z_UP", "Y_UP", "X_UP"])
@pytest.mark.parametrize("unit_m", [None, 1.0, 0.01, 0.0254, 0.1])
def test_a_collada_box_has_its_size_names_and_materials_in_any_unit_and_axes(tmp_path, up, unit_m):
    file = written(tmp_path, "a.dae", collada_box(unit_m, up, triangles=up == "X_UP", moved_m=2.0))
    room, findings = read_room(RoomSpec(file=file))
    low, high = room.mesh.vertices_m.min(axis=0), room.mesh.vertices_m.max(axis=0)
    # pycollada keeps coordinates as float32
    np.testing.assert_allclose(high - low, SIZE_M, atol=2e-6)
    first = {"Z_UP": 0, "Y_UP": 0, "X_UP": 2}[up]
    assert low[first] == pytest.approx(2.0, abs=2e-6)
    assert sorted({s.name for s in room.mesh.surfaces}) == sorted(SIDES)
    assert dict(zip(room.materials, material_areas_m2(room), strict=True)) == pytest.approx(
        {"carpet": 30.0, "plaster": 96.0}, abs=1e-4
    )
    floor = [s.name for s in room.mesh.surfaces].index("floor")
    own = room.mesh.vertices_m[room.mesh.triangles[room.mesh.triangle_surface == floor]]
    np.testing.assert_allclose(own[..., 2], low[2], atol=2e-6)
    assert [dict(f.evidence) for f in findings if f.code is Code.ENTITIES_IGNORED] == [
        {"LineSet": 1}
    ]


def test_the_unit_of_a_collada_file_is_the_one_it_states_unless_another_is_given(tmp_path):
    file = written(tmp_path, "a.dae", collada_box(0.0254))
    assert likely_units(file) == {"in": "by the format of the file"}
    mesh, _ = read_mesh(RoomSpec(file=file, unit="cm"))
    assert volume_m3(mesh) == pytest.approx(90.0 * (1.0 / 2.54) ** 3, rel=1e-5)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda b: b[: len(b) // 2], "cannot be read"),
        (lambda _: b"\x00" * 100, "cannot be read"),
        (lambda b: b.replace(b"instance_geometry", b"instance_gem"), "cannot be read"),
        (lambda b: b.replace(b"<vcount>4", b"<ph>4"), "holes"),
        (lambda b: b.replace(b"0 1 3 2", b"0 1 3 99"), "cannot be read"),
    ],
)  # fmt: skip
def test_a_damaged_collada_file_is_refused(tmp_path, change, words):
    file = written(tmp_path, "a.dae", change(collada_box()))
    with pytest.raises(InputError, match=words):
        read_model(RoomSpec(file=file))


def test_entities_that_multiply_or_lead_elsewhere_bring_nothing(tmp_path):
    """The bomb of ten laughs ten deep, and a file of this machine as a name."""
    laughs = "".join(
        f'<!ENTITY l{n} "{f"&l{n - 1};" * 10}">' if n else '<!ENTITY l0 "ha">' for n in range(10)
    )
    secret = written(tmp_path, "secret.txt", b"secret")
    for entities, use in ((laughs, "&l9;"), (f'<!ENTITY x SYSTEM "{secret}">', "&x;")):
        text = collada_box().decode().partition("?>")[2]
        text = f"<?xml version='1.0'?><!DOCTYPE COLLADA [{entities}]>" + text
        file = written(tmp_path, "a.dae", text.replace("<created>", f"<created>{use}").encode())
        try:
            model, _ = read_model(RoomSpec(file=file))
        except InputError:
            continue
        assert "secret" not in str([f.surface for f in model.faces])


@pytest.mark.slow
def test_any_damage_is_a_room_or_a_refusal(tmp_path):
    """Thirty bytes turned at random, six times."""
    rng, whole = np.random.default_rng(7), collada_box()
    for _ in range(6):
        altered = bytearray(whole)
        for place in rng.integers(0, len(whole), 30):
            altered[place] = rng.integers(0, 256)
        try:
            check_room(RoomSpec(file=written(tmp_path, "a.dae", bytes(altered))))
        except RoomfitError:
            continue


# Building models.


def ifc_house(prefix: str | None = "MILLI", *, boundaries: str = "second", spaces: int = 1) -> str:
    """Return a space of 6 x 5 x 3 m, turned by 90 degrees about z and put at (1, 2, 0.5) m.

    Of brick to the south (y = 0 in its own axes), where a window of 2 x 1 m is; the other sides of
    one concrete. Boundaries are of the second level (the window is a hole of the wall's), of the
    first (it overlaps the wall's), or none.
    """
    ifcopenshell = pytest.importorskip("ifcopenshell")
    from ifcopenshell.api import run

    model = ifcopenshell.file(schema="IFC4")
    project = run("root.create_entity", model, ifc_class="IfcProject", name="P")
    length = run("unit.add_si_unit", model, unit_type="LENGTHUNIT", prefix=prefix)
    run("unit.assign_unit", model, units=[length])
    context = run("context.add_context", model, context_type="Model")
    site = run("root.create_entity", model, ifc_class="IfcSite", name="S")
    run("aggregate.assign_object", model, products=[site], relating_object=project)
    k = {"MILLI": 1000.0, None: 1.0}[prefix]
    dx, dy, dz = (SIZE_M * k).tolist()

    def point(*at: float):
        return model.createIfcCartesianPoint([float(x) for x in at])

    def loop(*at):
        return model.createIfcPolyline([point(*p) for p in (*at, at[0])])

    def axes(at, z, x):
        z, x = (model.createIfcDirection([float(c) for c in d]) for d in (z, x))
        return model.createIfcAxis2Placement3D(point(*at), z, x)

    materials = {n: run("material.add_material", model, name=n) for n in ("brick", "concrete")}

    def element(kind: str, name: str, material: str | None):
        own = run("root.create_entity", model, ifc_class=kind, name=name)
        if material:
            run("material.assign_material", model, products=[own], material=materials[material])
        return own

    south, window = element("IfcWall", "south", "brick"), element("IfcWindow", "pane", None)
    rest = element("IfcWall", "rest", "concrete")
    hole = ((2 * k, k), (4 * k, k), (4 * k, 2 * k), (2 * k, 2 * k))
    for number in range(spaces):
        space = run("root.create_entity", model, ifc_class="IfcSpace", name=f"room {number}")
        run("aggregate.assign_object", model, products=[space], relating_object=site)
        matrix = np.eye(4)
        matrix[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
        matrix[:3, 3] = np.array([1.0 + 20.0 * number, 2.0, 0.5]) * k
        run("geometry.edit_object_placement", model, product=space, matrix=matrix, is_si=False)
        flat = loop((0, 0), (dx, 0), (dx, dy), (0, dy))
        profile = model.createIfcArbitraryClosedProfileDef("AREA", None, flat)
        upright = axes((0, 0, 0), (0, 0, 1), (1, 0, 0))
        up = model.createIfcDirection([0.0, 0.0, 1.0])
        body = model.createIfcExtrudedAreaSolid(profile, upright, up, dz)
        shape = model.createIfcShapeRepresentation(context, "Body", "SweptSolid", [body])
        run("geometry.assign_representation", model, product=space, representation=shape)
        if boundaries == "none":
            continue
        sides = [  # element, origin, normal, axis along, lengths, holes
            (south, (0, 0, 0), (0, -1, 0), (1, 0, 0), (dx, dz), boundaries == "second"),
            (rest, (dx, 0, 0), (1, 0, 0), (0, 1, 0), (dy, dz), False),
            (rest, (dx, dy, 0), (0, 1, 0), (-1, 0, 0), (dx, dz), False),
            (rest, (0, dy, 0), (-1, 0, 0), (0, -1, 0), (dy, dz), False),
            (rest, (0, 0, 0), (0, 0, 1), (1, 0, 0), (dx, dy), False),
            (rest, (0, 0, dz), (0, 0, 1), (1, 0, 0), (dx, dy), False),
        ]
        planes = [
            (owner, at, z, x, loop((0, 0), (a, 0), (a, b), (0, b)), [loop(*hole)] if cut else [])
            for owner, at, z, x, (a, b), cut in sides
        ]
        planes.append((window, (0, 0, 0), (0, -1, 0), (1, 0, 0), loop(*hole), []))
        for owner, at, z, x, outer, inner in planes:
            plane = model.createIfcPlane(axes(at, z, x))
            surface = model.createIfcCurveBoundedPlane(plane, outer, inner)
            geometry = model.createIfcConnectionSurfaceGeometry(surface, None)
            new = ifcopenshell.guid.new()
            model.createIfcRelSpaceBoundary(
                new, None, boundaries, None, space, owner, geometry, "PHYSICAL", "INTERNAL"
            )
    return model.to_string()


def areas_of(room) -> dict[str, float]:
    return dict(zip(room.materials, material_areas_m2(room).round(6).tolist(), strict=True))


@pytest.mark.parametrize("prefix", [None, "MILLI"])
def test_a_space_whose_boundaries_cover_it_has_its_walls_and_windows(tmp_path, prefix):
    file = written(tmp_path, "a.ifc", ifc_house(prefix).encode())
    room, findings = read_room(RoomSpec(file=file, materials={"IfcWindow": "glass"}))
    low, high = room.mesh.vertices_m.min(axis=0), room.mesh.vertices_m.max(axis=0)
    np.testing.assert_allclose([low, high], [[-4.0, 2.0, 0.5], [1.0, 8.0, 3.5]], atol=1e-9)
    assert volume_m3(room.mesh) == pytest.approx(90.0)
    assert areas_of(room) == {"brick": 16.0, "concrete": 108.0, "glass": 2.0}
    assert {(s.name, s.group) for s in room.mesh.surfaces} == {
        ("south", "IfcWall"), ("rest", "IfcWall"), ("pane", "IfcWindow")
    }  # fmt: skip
    assert Code.ENTITIES_IGNORED not in {f.code for f in findings}
    # the wall of brick is where the rotation puts y = 0: at x = 1
    south = [s.name for s in room.mesh.surfaces].index("south")
    own = room.mesh.vertices_m[room.mesh.triangles[room.mesh.triangle_surface == south]]
    np.testing.assert_allclose(own[..., 0], 1.0, atol=1e-9)


def test_a_window_that_overlaps_its_wall_is_passed_over_with_a_finding(tmp_path):
    file = written(tmp_path, "a.ifc", ifc_house(boundaries="first").encode())
    room, findings = read_room(RoomSpec(file=file))
    assert areas_of(room) == {"brick": 18.0, "concrete": 108.0}
    (ignored,) = (f for f in findings if f.code is Code.ENTITIES_IGNORED)
    assert (ignored.severity, dict(ignored.evidence)) == ("warning", {"IfcWindow": 1})


def test_a_space_without_boundaries_has_floor_walls_and_ceiling(tmp_path):
    file = written(tmp_path, "a.ifc", ifc_house(boundaries="none").encode())
    room, _ = read_room(RoomSpec(file=file))
    assert areas_of(room) == {"floor": 30.0, "wall": 66.0, "ceiling": 30.0}


@pytest.mark.slow
def test_of_several_spaces_one_must_be_named(tmp_path):
    file = written(tmp_path, "a.ifc", ifc_house(spaces=2).encode())
    with pytest.raises(InputError, match=r"several rooms(.|\n)*'room 0', 'room 1'"):
        read_model(RoomSpec(file=file))
    with pytest.raises(InputError, match="no such room"):
        read_model(RoomSpec(file=file, space="room 2"))
    room, _ = read_room(RoomSpec(file=file, space="room 1"))
    assert volume_m3(room.mesh) == pytest.approx(90.0)
    assert room.mesh.vertices_m[:, 0].min() == pytest.approx(16.0)
    with pytest.raises(InputError, match="only a building model and a scan"):
        read_model(RoomSpec(file=written(tmp_path, "a.dae", b"x"), space="room 1"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t[: len(t) // 3], "cannot be read"),
        (lambda _: "no building" * 20, "cannot be read"),
        (lambda t: t.replace("IFCSPACE(", "IFCSLAB("), "cannot be read"),
    ],
)
def test_a_damaged_building_model_is_refused(tmp_path, change, words):
    file = written(tmp_path, "a.ifc", change(ifc_house()).encode())
    with pytest.raises(InputError, match=words):
        read_model(RoomSpec(file=file))
