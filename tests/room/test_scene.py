"""Rooms and scenes made from names: what is named, what is left out, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roomfit.base.errors import InputError
from roomfit.base.findings import Code
from roomfit.room.mesh import SHOEBOX_SURFACES, Mesh, refuse
from roomfit.room.scene import (
    Point,
    axis_findings,
    distances_m,
    is_clear_of_walls,
    material_areas,
    material_areas_m2,
    material_findings,
    materials_of_surfaces,
    object_pairs,
    pair_names,
    position_findings,
    scene_of,
    shoebox_room,
    with_objects,
    with_states,
)

LENGTHS_M = (6.0, 5.0, 3.0)
SOURCES = {"LS1": (1.0, 1.0, 1.5)}
RECEIVERS = {"MP1": (4.0, 3.0, 1.2), "MP2": (2.0, 4.0, 1.2)}


@pytest.fixture(scope="module")
def room():
    return shoebox_room(LENGTHS_M, "plaster")


def test_surfaces_that_are_not_named_are_materials_of_their_own():
    room = shoebox_room(LENGTHS_M, {"walls": "plaster", "south": "curtain"})
    assert room.materials == ("plaster", "curtain", "floor", "ceiling")
    # west 15, east 15 and north 18 m2; the curtain in the south takes its wall from the group
    assert material_areas_m2(room).tolist() == [48.0, 18.0, 30.0, 30.0]
    assert [s.name for s in room.mesh.surfaces] == list(SHOEBOX_SURFACES)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pairs": [("LS1", "MP3")]}, "a pair names a receiver that the scene does not have"),
        ({"pairs": []}, "a scene without pairs"),
        ({"receivers": {"MP1": (7, 3, 1)}}, "stands outside the room"),
        ({"receivers": {"MP1": (1.0, 1.0, 1.5)}}, "stands where receiver 'MP1' is"),
        (
            {"sources": [Point("a", np.ones(3)), Point("a", 2 * np.ones(3))]},
            "two sources have the same name",
        ),
    ],
)
def test_a_scene_that_cannot_be_is_refused(room, changes, message):
    arguments = {"sources": SOURCES, "receivers": RECEIVERS} | changes
    with pytest.raises(InputError, match=message):
        scene_of(room, **arguments)


@pytest.mark.parametrize(
    ("n", "n_outside", "misread"),
    [(2, 1, False), (2, 2, True), (3, 2, True), (6, 2, False), (6, 3, True), (7, 3, False),
     (7, 4, True)],
)  # fmt: skip
def test_positions_are_misread_where_half_of_them_are_outside_and_all_inside_in_other_units(
    room, n, n_outside, misread
):
    """Two at least. In feet what is within 19.7, 16.4 and 9.8 is inside, in metres 6, 5 and 3."""
    at = [(10.0 + 0.5 * i, 4.0, 1.0) for i in range(n_outside)]
    at += [(1.0 + 0.5 * i, 4.0, 1.0) for i in range(n - n_outside)]
    points = [Point(f"p{i}", np.array(p)) for i, p in enumerate(at)]
    found = position_findings(room, points[:1], points[1:])
    told = [f for f in found if f.code is Code.POSITIONS_MISREAD]
    assert bool(told) == misread
    if misread:
        text = str(told[0].sentence)
        assert f"{n_outside} of {n} positions" in text and "taken as feet" in text


@pytest.mark.parametrize(
    ("position_m", "words"),
    [
        ((120.0, 100.0, 60.0), "as inches"), ((300.0, 250.0, 150.0), "as centimetres"),
        ((5900.0, 3000.0, 1500.0), "as millimetres"),
        ((13.0, 31.0, -22.0), "with y up"), ((13.0, 31.0, 22.0), "as x, z, y"),
        ((22.0, 13.0, 31.0), "as y, x, z"),
    ],
)  # fmt: skip
def test_other_units_and_axes_are_named(room, position_m, words):
    """Axes in a room that stands elsewhere, since all that is positive is in it in some unit."""
    if words.startswith(("as x", "as y", "with")):
        mesh = replace(room.mesh, vertices_m=room.mesh.vertices_m + np.array([10.0, 20.0, 30.0]))
        room = replace(room, mesh=mesh, shoebox_m=None)
    points = [Point(n, np.array(position_m) + d) for n, d in (("S", 0.0), ("R", 0.1))]
    (told,) = (
        f
        for f in position_findings(room, points[:1], points[1:])
        if f.code is Code.POSITIONS_MISREAD
    )
    assert words in told.sentence


def test_a_point_is_in_a_wall_within_a_centimetre_and_two_are_one_within_a_centimetre(room):
    for off_m, clear in ((0.0099, False), (0.0101, True)):
        near = (Point("S", np.array([off_m, 2.0, 1.0])), Point("R", np.array([3.0, 2.0, 1.0])))
        assert (not position_findings(room, near[:1], near[1:])) == clear
        pair = (Point("S", np.array([3.0 + off_m, 2.0, 1.0])), near[1])
        assert (not position_findings(room, pair[:1], pair[1:])) == clear
    where = np.array([[0.5, 2.0, 1.0], [0.49, 2.0, 1.0], [-1.0, 2.0, 1.0], [3.0, 2.5, 2.5]])
    assert is_clear_of_walls(room, where, 0.5).tolist() == [True, False, False, True]


def bare_box() -> Mesh:
    """Return the box, whose floor and south have no material, and a sheet counted twice."""
    mesh = shoebox_room(LENGTHS_M, "plaster").mesh
    own = {"floor": None, "south": "", "north": "sheet", "east": "wood"}
    surfaces = tuple(
        replace(s, file_material=own.get(s.name, "stone"), double_sided=s.name == "north")
        for s in mesh.surfaces
    )
    return replace(mesh, surfaces=surfaces)


def test_surfaces_without_a_material_are_a_fault_with_their_number_area_and_first_place():
    mesh = bare_box()
    (found,) = material_findings(mesh, {})
    assert "2 surfaces, 48.00 m2" in found.sentence
    with pytest.raises(InputError) as refused:
        refuse((found,))
    # the first in the order of the mesh: corners (0, 0, 0), (6, 0, 0) and (6, 0, 3)
    assert "'south' near (4.000, 0.000, 1.000) m" in str(refused.value)
    assert '"south" = "plaster"' in str(refused.value)
    points_m = np.array(found.about.points_m)
    assert points_m.shape == (4, 3)
    np.testing.assert_array_equal((points_m[:, 1] == 0.0) | (points_m[:, 2] == 0.0), True)
    assert material_findings(mesh, {"floor": "carpet", "south": "plaster"}) == ()
    with pytest.raises(InputError, match=r"does not exist(.|\n)*'roof'"):
        material_findings(mesh, {"roof": "tiles"})
    with pytest.raises(InputError, match="without a name"):
        material_findings(mesh, {"floor": ""})


def test_areas_of_materials_come_largest_first_and_those_of_sheets_twice():
    """West 15, east 15, south and north 18, floor and ceiling 30 m2."""
    found = material_areas(bare_box(), {"walls": "paint", "north": "curtain"})
    assert list(found.items()) == [
        ("paint", 48.0), ("curtain", 36.0), (None, 30.0), ("stone", 30.0),
    ]  # fmt: skip


@pytest.mark.parametrize(("axes", "axis"), [((0, 1, 2), None), ((0, 2, 1), "y"), ((2, 1, 0), "x")])
def test_a_floor_that_stands_upright_makes_one_ask_which_axis_points_up(axes, axis):
    mesh = shoebox_room(LENGTHS_M, "plaster").mesh
    turned = replace(mesh, vertices_m=mesh.vertices_m[:, list(axes)])
    found = axis_findings(turned)
    assert [f.evidence for f in found] == (
        [] if axis is None else [{"surfaces": "floor, ceiling", "axis": axis}]
    )
    nameless = tuple(replace(s, name=f"s{i}", file_material=None) for i, s in
                     enumerate(mesh.surfaces))  # fmt: skip
    assert axis_findings(replace(turned, surfaces=nameless)) == ()


def test_states_change_the_surfaces_that_they_name_and_share_what_they_have_in_common():
    room = shoebox_room(LENGTHS_M, {"walls": "plaster", "floor": "carpet"})
    states = with_states(room, {"a": {"north": "felt", "walls": "wood"}, "b": {"floor": "felt"}})
    assert states.materials == ("plaster", "carpet", "ceiling", "wood", "felt")
    assert materials_of_surfaces(states).tolist() == [
        [0, 0, 0, 0, 1, 2], [3, 3, 3, 4, 1, 2], [0, 0, 0, 0, 4, 2],
    ]  # fmt: skip
    assert material_areas_m2(states, 1).tolist() == [0.0, 30.0, 30.0, 48.0, 18.0]
    seated = with_objects(states, {"people": ["", "b"], "seats": None})
    scene = scene_of(seated, SOURCES, RECEIVERS)
    scene = replace(scene, pairs=[[0, 0], [0, 1], [0, 0]], pair_state=[0, 1, 2])
    there = object_pairs(scene)
    assert there[:, :5].sum() == 0
    assert there[:, 5:].tolist() == [[True, True], [False, True], [True, True]]
    assert object_pairs(scene_of(states, SOURCES, RECEIVERS)) is None
    assert pair_names(scene) == [("LS1", "MP1", ""), ("LS1", "MP2", "a"), ("LS1", "MP1", "b")]
    np.testing.assert_allclose(distances_m(scene), [np.sqrt(13.09), np.sqrt(10.09), np.sqrt(13.09)])
    with pytest.raises(InputError, match="after objects"):
        with_states(seated, {"c": {}})
    with pytest.raises(InputError, match="state"):
        with_objects(states, {"people": ["x"]})
    with pytest.raises(InputError, match=r"same name|name of a material"):
        with_objects(states, {"felt": None})
