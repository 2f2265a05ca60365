"""Rooms that Apple's RoomPlan scanned: closed, with doors and windows cut out, refused in words."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from roomfit.base.errors import InputError
from roomfit.base.findings import Code
from roomfit.cli.init import draft_to_folder
from roomfit.cli.predict import reverberation_to_folder
from roomfit.files.campaign import read_campaign
from roomfit.files.draft import draft_campaign
from roomfit.files.inputs import object_areas_m2
from roomfit.files.rooms import read_room
from roomfit.files.schema import RoomSpec
from roomfit.room.mesh import box_of, surface_area_m2, volume_m3
from roomfit.room.scene import Room, material_areas_m2
from scans import (
    ELL,
    HEIGHT_M,
    attic,
    furniture,
    placed,
    scan,
    scan_usdz,
    surface,
    upright,
)

AREA_M2, AROUND_M = 25.0, 22.0


def room_of(folder: Path, content: dict[str, Any]) -> tuple[Room, tuple[Any, ...]]:
    (folder / "room.json").write_text(json.dumps(content))
    return read_room(RoomSpec(file=folder / "room.json"))


def areas(room: Room) -> dict[str, float]:
    return dict(zip(room.materials, material_areas_m2(room), strict=True))


@pytest.mark.parametrize("floor", [True, False])
@pytest.mark.parametrize("turned_deg", [0.0, 25.0, 200.0])
def test_a_scan_is_a_closed_room_with_door_and_window_of_their_own(tmp_path, floor, turned_deg):
    room, findings = room_of(tmp_path, scan(floor=floor, turned_deg=turned_deg))
    # coordinates are rounded to a micrometre
    assert volume_m3(room.mesh) == pytest.approx(AREA_M2 * HEIGHT_M, rel=1e-6)
    assert areas(room) == pytest.approx(
        {
            "wall": AROUND_M * HEIGHT_M - 0.9 * 2.1 - 2.0,
            "door": 0.9 * 2.1,
            "window": 2.0,
            "floor": AREA_M2,
            "ceiling": AREA_M2,
        },
        rel=1e-5,
    )
    assert {s.name for s in room.mesh.surfaces} == {
        *(f"Wall{i}" for i in range(6)),
        *("Door0", "Window0", "Floor0", "Ceiling"),
    }
    assert [f.code for f in findings] == [Code.ROOM_COMPLETED, Code.ENTITIES_IGNORED]
    assert "2.60 m above the floor" in findings[0].sentence and "1 table" in findings[1].sentence


def test_a_scanned_box_with_a_door_and_a_window_is_a_box(tmp_path):
    """Of 6.1 x 4.7 x 2.6 m, so that its image sources form a lattice."""
    outline = ((0.0, 0.0), (6.1, 0.0), (6.1, 4.7), (0.0, 4.7))
    for floor in (True, False):
        room, _ = room_of(tmp_path, scan(outline, floor=floor, gap_m=0.05))
        box = box_of(room.mesh)
        assert {"door", "window"} < set(room.materials)
        assert box is not None
        np.testing.assert_allclose(box.lengths_m, (6.1, 4.7, HEIGHT_M), atol=1e-5)


def test_the_longest_wall_lies_along_x_and_the_room_begins_at_zero(tmp_path):
    """Wherever the scan began and whichever way it looked; nothing is mirrored."""
    for turned_deg in (0.0, 25.0, 200.0):
        room, findings = room_of(tmp_path, scan(turned_deg=turned_deg))
        np.testing.assert_allclose(room.mesh.vertices_m.min(axis=0), 0.0, atol=1e-6)
        plan = np.unique(np.round(room.mesh.vertices_m[:, :2], 4), axis=0)
        for corner in ELL:
            assert np.linalg.norm(plan - corner, axis=1).min() < 2e-4
        along = "x runs along Wall0, from (0.000, 0.000, 0.000) m to (6.000, 0.000, 0.000) m"
        assert along in findings[0].sentence


@pytest.mark.parametrize("gap_m", [0.05, 0.15])
def test_walls_that_end_short_of_each_other_meet_in_corners(tmp_path, gap_m):
    room, findings = room_of(tmp_path, scan(gap_m=gap_m, floor=False))
    assert volume_m3(room.mesh) == pytest.approx(AREA_M2 * HEIGHT_M, rel=1e-6)
    gap = np.hypot(gap_m, gap_m)
    assert findings[0].evidence["joined_m"] == pytest.approx(gap, rel=1e-9)
    assert f"up to {gap:.2f} m apart were joined" in findings[0].sentence


def test_two_walls_in_line_and_a_step_between_parallel_ones_close(tmp_path):
    """The long side in two pieces, the second of them 0.2 m farther in."""
    frame = placed(25.0, (0, 0), 0.0)
    corners = [(0, 0), (3, 0), (3, 0.2), (6, 0.2), (6, 3), (4, 3), (0, 3)]
    pairs = list(zip(corners, corners[1:] + corners[:1], strict=True))
    pairs.pop(1)  # the step itself was not seen
    walls = [surface(i, "wall", upright(a, b, 0.0, 2.5, frame)) for i, (a, b) in enumerate(pairs)]
    content = {**scan(floor=False), "walls": walls, "doors": [], "windows": []}
    room, _ = room_of(tmp_path, content)
    assert volume_m3(room.mesh) == pytest.approx(2.5 * (18.0 - 0.6), rel=1e-6)
    assert surface_area_m2(room.mesh) == pytest.approx(2 * 17.4 + 2.5 * 18.0, rel=1e-6)


def test_a_side_without_a_wall_is_an_opening_and_said(tmp_path):
    room, findings = room_of(tmp_path, scan(skip=[3]))
    assert areas(room)["opening"] == pytest.approx(2.0 * HEIGHT_M, rel=1e-5)
    assert findings[0].severity == "warning"
    assert "Sides of the floor without a wall, 2.00 m in all" in findings[0].sentence


def test_a_sloping_ceiling_lies_on_the_tops_of_walls(tmp_path):
    """From 2.2 m over y = 0 to 3.2 m over y = 5; walls along y are polygons of four corners."""
    frame, content = placed(25.0, (-1.3, 0.7), -1.45), scan(((0, 0), (6, 0), (6, 5), (0, 5)))
    tops = [(2.2, 2.2), (2.2, 3.2), (3.2, 3.2), (3.2, 2.2)]
    corners = [(0, 0), (6, 0), (6, 5), (0, 5)]
    walls = []
    for i, (left, right) in enumerate(tops):
        shape = upright(corners[i], corners[(i + 1) % 4], 0.0, max(left, right), frame)
        w, h = shape[0][0] / 2, shape[0][1] / 2
        own = [[-w, -h, 0], [w, -h, 0], [w, right - h, 0], [-w, left - h, 0]]
        walls.append(surface(i, "wall", shape, polygonCorners=own))
    room, _ = room_of(tmp_path, {**content, "walls": walls, "doors": [], "windows": []})
    assert volume_m3(room.mesh) == pytest.approx(6 * 5 * 2.7, rel=1e-6)
    # the ceiling is as long as the slope
    assert areas(room)["ceiling"] == pytest.approx(6 * np.hypot(5, 1), rel=1e-6)


def test_overlapping_openings_and_those_at_rims_leave_no_hole(tmp_path):
    """A door that ends 3 cm above the floor, and an opening across half of it."""
    content = scan()
    frame = placed(25.0, (-1.3, 0.7), -1.45)
    content["doors"][0].update(
        zip(("dimensions", "transform"), upright((1, 0), (1.9, 0), 0.03, 2.1, frame), strict=True)
    )
    wide = upright((1.5, 0), (3.0, 0), 0.0, 2.6, frame)
    content["openings"] = [surface(0, "opening", wide, parentIdentifier="wall-0")]
    room, _ = room_of(tmp_path, content)
    assert volume_m3(room.mesh) == pytest.approx(AREA_M2 * HEIGHT_M, rel=1e-6)
    own = areas(room)
    assert own["door"] == pytest.approx(0.9 * 2.1, rel=1e-5)
    assert own["opening"] == pytest.approx(1.5 * 2.6 - 0.4 * 2.1, rel=1e-5)


def test_a_wall_that_is_one_opening_is_not_said_to_be_left_out(tmp_path):
    content = scan()
    frame = placed(25.0, (-1.3, 0.7), -1.45)
    whole = upright((3.5, 3.02), (3.5, 4.98), 0.0, 2.6, frame)
    content["openings"] = [surface(0, "opening", whole, parentIdentifier="wall-3")]
    room, findings = room_of(tmp_path, content)
    assert areas(room)["opening"] == pytest.approx(2.0 * HEIGHT_M, rel=1e-5)
    assert "Wall3" not in {s.name for s in room.mesh.surfaces}
    assert [f for f in findings if f.severity == "warning"] == []


def test_a_window_is_put_into_the_nearest_wall_where_its_parent_is_not_said(tmp_path):
    """As iOS 16 writes it; one that hangs in the middle of the room is left out and said."""
    content = scan()
    content["windows"][0]["parentIdentifier"] = None
    assert areas(room_of(tmp_path, content)[0])["window"] == pytest.approx(2.0, rel=1e-5)
    frame = placed(25.0, (-1.3, 0.7), -1.45)
    content["windows"] = [surface(0, "window", upright((1, 2), (2, 2), 1.0, 2.0, frame))]
    room, findings = room_of(tmp_path, content)
    assert "window" not in areas(room)
    assert any("Window0" in f.sentence for f in findings)


@pytest.mark.parametrize(
    ("tops", "n", "section_m2", "slope_m"),
    [
        # two slopes that meet in a ridge, 1.8 m higher; and one that ends at a collar
        ([(3.0, 4.0)], 2, 6 * 2.2 + 0.5 * 6 * 1.8, 2 * np.hypot(3, 1.8)),
        ([(2.0, 3.4), (4.0, 3.4)], 3, 6 * 2.2 + 4 * 1.2, 2 * np.hypot(2, 1.2) + 2),
    ],
)
def test_walls_with_gables_carry_planes_that_meet_along_lines(
    tmp_path, tops, n, section_m2, slope_m
):
    """A prism of 8 m, whichever way the scan lies; a window across the ridge is cut once."""
    content = attic(tops)
    room, findings = room_of(tmp_path, content)
    assert volume_m3(room.mesh) == pytest.approx(8 * section_m2, rel=1e-6)
    own = areas(room)
    assert own["ceiling"] == pytest.approx(8 * slope_m, rel=1e-6)
    assert own["window"] == pytest.approx(3.6, rel=1e-5)
    walls = 2 * 8 * 2.2 + 2 * section_m2 - 3.6
    assert own["wall"] == pytest.approx(walls, rel=1e-5)
    ceilings = {s.name for s in room.mesh.surfaces if s.name.startswith("Ceiling")}
    assert ceilings == {f"Ceiling{i}" for i in range(n)}
    assert f"A ceiling of {n} planes between gables was put 2.20 to" in findings[0].sentence


def test_a_curved_wall_is_the_chords_of_the_outline_of_the_floor(tmp_path):
    """A half circle of 2 m about the middle of one end, in twelve chords."""
    turns = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 13)
    arc = [(6 + 2 * np.cos(t), 2 + 2 * np.sin(t)) for t in turns]
    content = scan([(0, 0), *arc, (0, 4)])
    frame = placed(25.0, (-1.3, 0.7), -1.45)
    bent = surface(1, "wall", upright((6, 0), (6, 4), 0.0, HEIGHT_M, frame), curve={"radius": 2.0})
    content["walls"] = [content["walls"][0], bent, *content["walls"][13:]]
    room, findings = room_of(tmp_path, content)
    floor_m2 = 6 * 4 + 12 * 0.5 * 2**2 * np.sin(np.pi / 12)
    assert volume_m3(room.mesh) == pytest.approx(HEIGHT_M * floor_m2, rel=1e-6)
    by_name = {s.name for s in room.mesh.surfaces}
    assert by_name == {
        "Wall0",
        "Wall1",
        "Wall2",
        "Wall3",
        "Door0",
        "Window0",
        "Floor0",
        "Ceiling",
    }
    assert [f for f in findings if f.severity == "warning"] == []


def test_one_room_of_a_structure_is_chosen_by_its_label_or_identifier(tmp_path):
    """As spaces of a building model; a lone one needs no name."""
    box = [(0, 0), (4, 0), (4, 3), (0, 3)]
    rooms = [{**scan(), "identifier": "A1"}, {**scan(box, skip=()), "identifier": "B2"}]
    rooms.append({**scan(), "sections": [{"label": "kitchen"}], "identifier": "C3"})
    (tmp_path / "flat.json").write_text(json.dumps({"rooms": rooms, "walls": []}))

    def floor_m2(space: str | None) -> float:
        room, _ = read_room(RoomSpec(file=tmp_path / "flat.json", space=space))
        return areas(room)["floor"]

    assert floor_m2("livingRoom") == pytest.approx(AREA_M2, rel=1e-5)
    assert floor_m2("livingRoom 2") == floor_m2("B2") == pytest.approx(12.0, rel=1e-5)
    assert floor_m2("kitchen") == pytest.approx(AREA_M2, rel=1e-5)
    with pytest.raises(InputError, match=r"'livingRoom', 'livingRoom 2', 'kitchen'(.|\n)*space ="):
        floor_m2(None)
    with pytest.raises(InputError, match=r"no such room(.|\n)*'bath'(.|\n)*kitchen"):
        floor_m2("bath")
    text = draft_campaign(
        RoomSpec(file=tmp_path / "flat.json", space="kitchen"), {}, folder=tmp_path
    )
    assert tomllib.loads(text)["room"] == {"file": "flat.json", "space": "kitchen", "unit": "m"}
    (tmp_path / "flat.json").write_text(json.dumps({"rooms": rooms[:1]}))
    assert floor_m2(None) == floor_m2("livingRoom")
    room, _ = room_of(tmp_path, scan())
    assert areas(room)["floor"] == floor_m2(None)
    with pytest.raises(InputError, match="only a building model and a scan"):
        read_room(RoomSpec(file=tmp_path / "room.obj", space="kitchen"))


def furnished(**changes: Any) -> dict[str, Any]:
    """Return a scan with a sofa at the wall y = 0, a bed in the open and two chairs."""
    things = [
        furniture("sofa", (4.0, 0.45), (2.0, 0.8, 0.9)),
        furniture("bed", (2.0, 3.0), (1.4, 0.4, 2.0)),
        *(furniture("chair", (x, 1.5), (0.5, 0.9, 0.5)) for x in (1.0, 5.0)),
        *scan()["objects"],
    ]
    return {**scan(), "objects": things, **changes}


def test_init_writes_what_a_scan_has_of_beds_and_sofas_as_objects(tmp_path):
    """Areas by hand, with strips along free edges; chairs are comments, tables are left out."""
    (tmp_path / "room.json").write_text(json.dumps(furnished()))
    spec = RoomSpec(file=tmp_path / "room.json")
    text = draft_campaign(spec, {}, folder=tmp_path)
    objects = tomllib.loads(text)["objects"]
    assert set(objects) == {"sofa", "bed"}
    assert '# [objects."chair"]  # 2 by the scan\n# floor_area_m2 = 0.50\n' in text
    assert objects["sofa"]["prior"] == "seats-medium-empty" and objects["bed"]["edge_m"] == 0.25
    ring = np.array(objects["sofa"]["outlines"][0])
    np.testing.assert_allclose(ring.min(axis=0), [3.0, 0.0, 0.0], atol=0.01)
    np.testing.assert_allclose(ring.max(axis=0), [5.0, 0.9, 0.0], atol=0.01)
    # the sofa has a wall behind it
    sofa, bed = (2.0 + 2 * 0.5) * (0.9 + 0.5), (1.4 + 2 * 0.25) * (2.0 + 2 * 0.25)
    for kind, area in (("sofa", sofa), ("bed", bed)):
        stated = re.search(rf'objects."{kind}"].*\n.*\n.*: ([\d.]+) m2', text)[1]  # type: ignore[index]
        assert float(stated) == pytest.approx(area, abs=0.05)
    # the campaign counts them as that
    points = "[sources.S]\nposition = [1, 1, 1]\n[receivers.R]\nposition = [3, 1.5, 1.2]\n"
    own = text[: text.index("[sources.")] + points
    file = tmp_path / "campaign.toml"
    file.write_text(own)
    campaign, (room, _) = read_campaign(file, to_fit=False), read_room(spec)
    mean = object_areas_m2(campaign, "sofa", room.mesh, campaign.bands)[1][0]  # type: ignore[index]
    known = own.replace('prior = "seats-medium', 'absorption_area_m2 = "seats-medium')
    file.write_text(
        known.replace("outlines = ", f"floor_area_m2 = {sofa} # ", 1).replace("edge_m = 0.5", "")
    )
    counted = read_campaign(file, to_fit=False)
    by_hand, _ = object_areas_m2(counted, "sofa", room.mesh, counted.bands)
    np.testing.assert_allclose(mean, by_hand, rtol=0.02)


def test_decay_times_take_furniture_as_its_entry_says(tmp_path):
    """A prior would be refused: one datum a band tells no sofa from the walls."""
    (tmp_path / "room.json").write_text(json.dumps(furnished()))
    (tmp_path / "t30.csv").write_text("place,500\nmiddle,0.6\n")
    spec, table = RoomSpec(file=tmp_path / "room.json"), tmp_path / "t30.csv"
    text = draft_to_folder(tmp_path, spec, decay_times=table)
    assert tomllib.loads(text)["objects"]["bed"]["absorption_area_m2"] == "seats-heavy-empty"
    with_bed = reverberation_to_folder(tmp_path / "campaign.toml").mean[1, 0, 0]
    (tmp_path / "campaign.toml").write_text(re.sub(r"(?s)\[objects.*?\n\n", "\n", text))
    assert with_bed < reverberation_to_folder(tmp_path / "campaign.toml").mean[1, 0, 0] - 0.02


def changed(**changes: Any) -> dict[str, Any]:
    return {**scan(), **changes}


def curved() -> dict[str, Any]:
    content = scan(floor=False)
    content["walls"][2]["curve"] = {"radius": 3.0}
    return content


def low_wall() -> dict[str, Any]:
    content = scan()
    content["walls"][1]["dimensions"][1] = 1.2
    return content


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (scan(gap_m=0.4, floor=False), r"do not meet(.|\n)*0.5\d m to the nearest(.|\n)*iOS 17"),
        (scan(skip=[3], floor=False), r"do not meet"),
        (curved(), r"is curved(.|\n)*Wall2(.|\n)*iOS 17"),
        (attic(walls="1"), r"no ceiling(.|\n)*planes that meet along lines between gables"),
        (attic([(1.0, 3.0), (3.0, 2.2), (5.0, 3.0)], "1"), "no ceiling"),
        (low_wall(), r"no ceiling(.|\n)*above the floor"),
        ({"rooms": [scan(), scan()]}, r"several rooms(.|\n)*'livingRoom', 'livingRoom 2'"),
        (changed(floors=scan()["floors"] * 2), "several floors"),
        (changed(walls=scan()["walls"][:2]), r"encloses no room(.|\n)*2 walls"),
        (changed(walls=scan(np.array(ELL) + 9.0)["walls"]), "no wall of the scan stands on"),
        (changed(walls=[{}]), "scan is incomplete"),
        (changed(walls=[{**scan()["walls"][0], "transform": [1e999] * 16}]), "incomplete"),
        ({"measurements": []}, r"no scan of a room(.|\n)*CapturedRoom"),
    ],
)
def test_what_is_no_closed_room_is_refused_in_words(tmp_path, content, words):
    with pytest.raises(InputError, match=words):
        room_of(tmp_path, content)


# Scenes.


@pytest.mark.parametrize(("names", "meshes"), [("{}{}", False), ("{}_{}", True)])
@pytest.mark.parametrize("thick_m", [0.0, 0.16])
def test_a_scan_as_a_scene_is_the_room_of_its_json(tmp_path, names, meshes, thick_m):
    """Boxes by their names, in cm with y up, taken in the middle of their thickness."""
    pytest.importorskip("pxr")
    file = tmp_path / "room.usdz"
    file.write_bytes(scan_usdz(thick_m=thick_m, names=names, meshes=meshes))
    room, findings = read_room(RoomSpec(file=file))
    expected, _ = room_of(tmp_path, scan(floor=False))
    assert areas(room) == pytest.approx(areas(expected), rel=1e-5)
    assert volume_m3(room.mesh) == pytest.approx(AREA_M2 * HEIGHT_M, rel=1e-5)
    assert any("1 sofa, 1 table" in f.sentence for f in findings)
    text = draft_campaign(RoomSpec(file=file), {}, folder=tmp_path)
    ring = np.array(tomllib.loads(text)["objects"]["sofa"]["outlines"][0])
    np.testing.assert_allclose(np.sort(ring[:, 0]), [3.0, 3.0, 5.0, 5.0], atol=0.011)
    np.testing.assert_allclose(np.sort(ring[:, 1]), [0.0, 0.0, 0.9, 0.9], atol=0.011)


def test_a_scene_that_is_no_scan_or_leads_elsewhere_is_refused(tmp_path):
    pytest.importorskip("pxr")
    from pxr import Sdf, Usd, UsdGeom, UsdUtils

    def packed(name: str, reference: str = "") -> Path:
        stage = Usd.Stage.CreateNew(str(tmp_path / f"{name}.usda"))
        own = UsdGeom.Cube.Define(stage, "/Wall0" if reference else "/Thing")
        if reference:
            own.GetPrim().GetReferences().AddReference(reference, "/Thing")
        stage.Save()
        file = tmp_path / f"{name}.usdz"
        if reference:
            # the packer would take it in
            with Sdf.ZipFileWriter.CreateNew(str(file)) as archive:
                archive.AddFile(str(tmp_path / f"{name}.usda"), f"{name}.usda")
        else:
            UsdUtils.CreateNewUsdzPackage(str(tmp_path / f"{name}.usda"), str(file))
        return file

    with pytest.raises(InputError, match=r"(?s)cannot be read.*named Wall0"):
        read_room(RoomSpec(file=packed("thing")))
    other = str(tmp_path / "thing.usda")
    with pytest.raises(InputError, match=r"(?s)cannot be read.*leads to other files"):
        read_room(RoomSpec(file=packed("link", other)))
    (tmp_path / "cut.usdz").write_bytes(scan_usdz()[:900])
    with pytest.raises(InputError, match="USDZ file cannot be read"):
        read_room(RoomSpec(file=tmp_path / "cut.usdz"))
