"""Rooms and scenes made from names: what is named, what is left out, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roomfit.air import Air
from roomfit.errors import InputError
from roomfit.geometry.mesh import SHOEBOX_SURFACES, volume_m3
from roomfit.scene import Point, material_areas_m2, plan_in_words, scene_of, shoebox_room

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
