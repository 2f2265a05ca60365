"""Symmetries of rooms, and the pairs that they carry into themselves."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.base.air import Air
from roomfit.fit.symmetry import deviation_m, room_symmetries
from roomfit.paper.room import paper_scene
from roomfit.room.mesh import shoebox_mesh
from roomfit.room.scene import Point, Room, Scene

SIX = ("west", "east", "south", "north", "floor", "ceiling")


def box(lengths: tuple[float, float, float], owners: tuple[int, ...] = tuple(range(6))) -> Room:
    names = tuple(f"m{i}" for i in range(max(owners) + 1))
    return Room(shoebox_mesh(lengths), names, np.array(owners), lengths)


def pair(room: Room, source: tuple[float, ...], receiver: tuple[float, ...]) -> Scene:
    points = (Point("S", np.array(source)),), (Point("R", np.array(receiver)),)
    return Scene(room, *points, np.array([(0, 0)]), Air())


@pytest.mark.parametrize(
    ("lengths", "n"),
    # a box has three mirror planes; a square floor adds its diagonals; a cube has the octahedron's
    [((5.0, 4.0, 3.0), 7), ((4.0, 4.0, 3.0), 15), ((3.0, 3.0, 3.0), 47)],
)
def test_boxes_have_the_symmetries_of_boxes(lengths, n):
    assert len(room_symmetries(box(lengths))) == n


def test_materials_are_exchanged_as_their_walls_are():
    found = room_symmetries(box((5.0, 4.0, 3.0)))
    for s in found:
        flipped = np.diag(s.matrix) < 0.0
        expected = np.arange(6).reshape(3, 2)
        expected[flipped] = expected[flipped, ::-1]
        assert s.exchange.tolist() == expected.ravel().tolist()
    # floor and three walls of one material, ceiling and one wall apart: only one plane is left
    found = room_symmetries(box((5.0, 4.0, 3.0), (0, 0, 0, 1, 0, 2)))
    assert len(found) == 1
    assert found[0].exchange.tolist() == [0, 1, 2]


def test_a_pair_at_half_height_leaves_floor_and_ceiling_exchangeable():
    room = box((5.0, 4.0, 3.0))
    found = {tuple(s.exchange): s for s in room_symmetries(room)}
    upside_down = found[0, 1, 2, 3, 5, 4]
    assert deviation_m(upside_down, pair(room, (1, 1.3, 1.5), (3, 2.9, 1.5)))[0] < 1e-12
    # 20 cm off the plane at one end
    assert deviation_m(upside_down, pair(room, (1, 1.3, 1.5), (3, 2.9, 1.7)))[0] == (
        pytest.approx(0.2)
    )
    # symmetric to each other by half a turn about the vertical axis: every side wall is exchanged
    turned = found[1, 0, 3, 2, 4, 5]
    assert deviation_m(turned, pair(room, (1, 1.3, 1.2), (4, 2.7, 1.2)))[0] < 1e-12


def test_the_papers_room_has_one_plane_and_its_first_case_stands_on_it():
    scene = paper_scene()
    (only,) = room_symmetries(scene.room)
    names = np.array(scene.room.materials)
    assert names[only.exchange[names.tolist().index("south")]] == "north"
    assert np.count_nonzero(only.exchange != np.arange(7)) == 2
    off = deviation_m(only, scene)
    assert off[0] < 1e-9
    assert off[1:].min() > 0.4


def test_a_room_without_symmetry_has_none():
    mesh = shoebox_mesh((5.0, 4.0, 3.0))
    corners = mesh.vertices_m.copy()
    corners[np.argmax(corners.sum(axis=1))] += (0.6, 0.5, 0.4)
    askew = type(mesh)(corners, mesh.triangles, mesh.triangle_surface, mesh.surfaces)
    assert room_symmetries(Room(askew, SIX, np.arange(6))) == ()
