"""Rooms and scenes made from names: what is named, what is left out, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roomfit.air import Air
from roomfit.errors import InputError
from roomfit.findings import Code
from roomfit.geometry.mesh import SHOEBOX_SURFACES, volume_m3
from roomfit.scene import (
    Point,
    is_clear_of_walls,
    material_areas_m2,
    plan_in_words,
    position_findings,
    scene_of,
    shoebox_room,
)

LENGTHS_M = (6.0, 5.0, 3.0)
SOURCES = {"LS1": (1.0, 1.0, 1.5)}
RECEIVERS = {"MP1": (4.0, 3.0, 1.2), "MP2": (2.0, 4.0, 1.2)}


@pytest.fixture(scope="module")
def room():
    return shoebox_room(LENGTHS_M, "plaster")


def test_one_name_is_the_material_of_all_surfaces(room):
    assert room.materials == ("plaster",)
    assert room.shoebox_m == LENGTHS_M
    assert volume_m3(room.mesh) == pytest.approx(90.0, rel=1e-14)
    assert material_areas_m2(room).tolist() == [126.0]


def test_surfaces_that_are_not_named_are_materials_of_their_own():
    room = shoebox_room(LENGTHS_M, {"walls": "plaster", "south": "curtain"})
    assert room.materials == ("plaster", "curtain", "floor", "ceiling")
    # west 15, east 15 and north 18 m2; the curtain in the south takes its wall from the group
    assert material_areas_m2(room).tolist() == [48.0, 18.0, 30.0, 30.0]
    assert [s.name for s in room.mesh.surfaces] == list(SHOEBOX_SURFACES)


def test_a_surface_that_a_box_does_not_have_is_refused():
    with pytest.raises(InputError, match="surface that does not exist") as refused:
        shoebox_room(LENGTHS_M, {"flor": "carpet"})
    assert "did you mean 'floor'?" in str(refused.value)


def test_every_source_goes_with_every_receiver_where_no_pairs_are_named(room):
    scene = scene_of(room, SOURCES | {"LS2": (5, 4, 2)}, RECEIVERS)
    assert scene.pairs.tolist() == [[0, 0], [0, 1], [1, 0], [1, 1]]
    assert [p.name for p in scene.sources] == ["LS1", "LS2"]
    assert scene.air == Air()
    np.testing.assert_array_equal(scene.receivers[1].position_m, [2.0, 4.0, 1.2])


def test_points_and_named_pairs_and_air_are_kept_as_specified(room):
    sources = (Point("LS1", np.array([1.0, 1.0, 1.5]), 0.02),)
    air = Air(temperature_c=15.0)
    scene = scene_of(room, sources, RECEIVERS, [("LS1", "MP2")], air)
    assert scene.pairs.tolist() == [[0, 1]]
    assert scene.sources == sources
    assert scene.air is air


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pairs": [("LS1", "MP3")]}, "a pair names a receiver that the scene does not have"),
        ({"pairs": [("MP1", "MP2")]}, "a pair names a source that the scene does not have"),
        ({"pairs": []}, "a scene without pairs"),
        ({"receivers": {}}, "a scene without pairs"),
        ({"receivers": {"MP1": (7, 3, 1)}}, "stands outside the room"),
        ({"receivers": {"MP1": (1.0, 1.0, 1.5)}}, "stands where receiver 'MP1' is"),
        ({"receivers": {"MP1": (4.0, 3.0)}}, "position of MP1 has the wrong shape"),
        ({"receivers": {"MP1": (4.0, np.nan, 1.0)}}, "position of MP1 is out of range"),
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


def test_a_pair_that_is_nearly_named_right_gets_a_hint(room):
    with pytest.raises(InputError, match=r"found\s+'MP_1'") as refused:
        scene_of(room, SOURCES, RECEIVERS, [("LS1", "MP_1")])
    assert "did you mean 'MP1'?" in str(refused.value)


def test_a_plan_and_its_mirror_image_read_differently(room):
    """Distances by hand from the nearer wall; in a room that is no box from the nearest one."""
    lengths = np.array(LENGTHS_M)
    right = scene_of(room, {"LS1": (1.2, 0.8, 0.9)}, {"MP1": (4.0, 3.0, 1.2)})
    left = scene_of(room, {"LS1": (lengths[0] - 1.2, 0.8, 0.9)}, {"MP1": (4.0, 3.0, 1.2)})
    assert plan_in_words(right)[0] == (
        "LS1 stands 1.20 m from west (plaster), 0.80 m from south (plaster), 0.90 m from floor "
        "(plaster)."
    )
    assert "1.20 m from east" in plan_in_words(left)[0]
    other = replace(right, room=replace(room, shoebox_m=None))
    assert plan_in_words(other)[0] == (
        "LS1 stands 0.80 m from south (plaster), the nearest surface, and 0.90 m above the lowest "
        "point of the room."
    )


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
        mesh = replace(room.mesh, vertices_m=room.mesh.vertices_m + [10.0, 20.0, 30.0])
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
