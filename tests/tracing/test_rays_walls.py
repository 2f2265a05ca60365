"""The nearest wall: planes, facets and the tree of boxes against trying everything in numpy."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest

from images_reference import box_room, box_with_sheet, l_shaped_room, room_of_polygons
from rays_reference import box_with_two_floors, box_without, flights_m, rotated
from roomfit.base.typing import FloatArray
from roomfit.paper.room import paper_scene
from roomfit.room.mesh import Mesh, corners_m
from roomfit.room.scene import Room, triangle_material
from roomfit.tracing.bvh import (
    WAITING,
    Tree,
    next_wall,
    tree_of,
    wall_material,
    walls_of,
)
from roomfit.tracing.walls import Planes, convex_planes, facet_distance, facets_of
from simulated_rooms.hall import hall_room


@numba.njit(error_model="numpy")
def _walls_ahead(walls, starts, directions):
    distance, wall = np.empty(len(starts)), np.empty(len(starts), np.int64)
    material, waiting = np.full(len(starts), -1), np.empty(WAITING, np.int32)
    for i in range(len(starts)):
        o = (starts[i, 0], starts[i, 1], starts[i, 2])
        d = (directions[i, 0], directions[i, 1], directions[i, 2])
        t, wall[i] = next_wall(walls, o, d, -1, waiting)
        distance[i] = t
        if wall[i] >= 0:
            p = (o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2])
            material[i] = wall_material(walls, wall[i], p)
    return distance, wall, material


@numba.njit(error_model="numpy")
def _try_every_facet(table, starts, directions):
    distance, wall = np.full(len(starts), np.inf), np.full(len(starts), -1)
    for i in range(len(starts)):
        o = (starts[i, 0], starts[i, 1], starts[i, 2])
        d = (directions[i, 0], directions[i, 1], directions[i, 2])
        for k in range(len(table)):
            t = facet_distance(table, k, o, d, (0.0, 0.0, 0.0), np.inf)
            if t < distance[i]:
                distance[i], wall[i] = t, k
    return distance, wall


def _rays(low: FloatArray, high: FloatArray, n: int, seed: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(n, 3))
    return (
        rng.uniform(low, high, size=(n, 3)),
        directions / np.linalg.norm(directions, axis=1)[:, None],
    )


@pytest.mark.slow
@pytest.mark.parametrize("n_triangles", [12, 92, 2012])
def test_the_tree_finds_the_same_facet_at_the_same_distance_as_trying_every_one(n_triangles):
    """Equal bit for bit, also for rays along the axes and rays that start on a wall."""
    tree = tree_of(*facets_of(hall_room(n_triangles)))
    starts, directions = _rays([1, -6, 0], [31, 6, 11], 3000, seed=n_triangles)
    directions[:60] = np.tile(np.concatenate((np.eye(3), -np.eye(3))), (10, 1))
    starts[60:300, 2] = 0.0

    distance, wall, _ = _walls_ahead(tree, starts, directions)
    expected, facet = _try_every_facet(tree.table, starts, directions)

    np.testing.assert_array_equal(distance, expected)
    np.testing.assert_array_equal(wall, facet)


@pytest.mark.parametrize(
    ("room", "middle"),
    [
        (l_shaped_room(), np.array([1.5, 1.5, 1.2])),
        (box_with_sheet(), np.array([1.5, 1.5, 1.2])),
        (rotated(hall_room(500), 3), rotated(hall_room(500), 3).mesh.vertices_m[:8].mean(axis=0)),
    ],
)
def test_distances_are_those_of_cramers_rule_on_every_triangle(room: Room, middle: FloatArray):
    """Another formula, other code; rays with nothing nearly parallel agree to 1e-9 m."""
    corners = corners_m(room.mesh)
    owner = triangle_material(room)
    starts, directions = _rays(middle - 0.4, middle + 0.4, 300, seed=4)

    distance, _, material = _walls_ahead(walls_of(room), starts, directions)

    for start, direction, got, struck in zip(starts, directions, distance, material, strict=True):
        flights = flights_m(corners, start, direction)
        assert got == pytest.approx(flights.min(), rel=1e-9)
        assert struck == owner[np.argmin(flights)]


@pytest.mark.parametrize("room", [box_room(), paper_scene().room, rotated(box_room(), 5)])
def test_planes_and_tree_agree_in_a_convex_room(room: Room):
    """Distances to 1e-12 of the room's size, and the same material everywhere."""
    planes = walls_of(room)
    tree = tree_of(*facets_of(room))
    low, high = room.mesh.vertices_m.min(axis=0), room.mesh.vertices_m.max(axis=0)
    middle, size = 0.5 * (low + high), float(np.linalg.norm(high - low))
    starts, directions = _rays(middle - 0.05 * size, middle + 0.05 * size, 2000, seed=6)

    distance, _, material = _walls_ahead(planes, starts, directions)
    expected, _, owner = _walls_ahead(tree, starts, directions)

    assert isinstance(planes, Planes)
    np.testing.assert_allclose(distance, expected, rtol=0, atol=1e-12 * size)
    np.testing.assert_array_equal(material, owner)


def test_what_is_concave_or_open_or_holds_a_sheet_is_not_taken_for_convex():
    """Also not a box turned inside out: its planes would let every ray escape."""
    box = box_room().mesh
    inside_out = Mesh(box.vertices_m, box.triangles[:, ::-1], box.triangle_surface, box.surfaces)
    rooms = [
        l_shaped_room(),
        box_with_sheet(),
        hall_room(32),
        box_without(3),
        Room(inside_out, box_room().materials, np.arange(6)),
    ]
    assert [convex_planes(room) for room in rooms] == [None] * len(rooms)
    assert all(isinstance(walls_of(room), Tree) for room in rooms)


def test_the_piece_of_a_plane_that_a_ray_strikes_gives_its_material():
    """Wood for x < 1, stone beyond, on one floor."""
    walls = walls_of(box_with_two_floors())
    starts, directions = _rays([0.1, 0.1, 0.5], [3.9, 2.9, 1.9], 4000, seed=7)

    distance, _, material = _walls_ahead(walls, starts, directions)

    ends = starts + distance[:, None] * directions
    on_floor = np.abs(ends[:, 2]) < 1e-9
    expected = np.where(on_floor, np.where(ends[:, 0] < 1.0, 0, 1), 2)
    np.testing.assert_array_equal(material, expected)


def test_no_ray_slips_through_an_edge_or_a_corner():
    """Rays aimed exactly at every corner and at points of every edge of a hall meet a wall."""
    room = rotated(hall_room(412), 8)
    corners = corners_m(room.mesh)
    along = np.linspace(0.0, 1.0, 7)[:, None, None, None]
    targets = (corners[None] * (1 - along) + np.roll(corners, -1, axis=1)[None] * along).reshape(
        -1, 3
    )
    start = room.mesh.vertices_m[:8].mean(axis=0)
    ways = targets - start
    lengths = np.linalg.norm(ways, axis=1)

    distance, wall, _ = _walls_ahead(
        walls_of(room), np.tile(start, (len(ways), 1)), ways / lengths[:, None]
    )

    assert (wall >= 0).all()
    # Facets are 1e-9 m wider than their corners, so none is passed by more than that at an angle.
    assert np.all(distance <= lengths + 1e-6)


@numba.njit(error_model="numpy")
def _next_after(walls, start, direction, last):
    return next_wall(
        walls,
        (start[0], start[1], start[2]),
        (direction[0], direction[1], direction[2]),
        last,
        np.empty(WAITING, np.int32),
    )


def _box_with_panel(turn: int) -> Room:
    """Return a box of 4 m, a panel of two faces back to back in it; axes exchanged in turn."""
    corners = [(x, y, z) for z in (0.0, 4.0) for x, y in ((0, 0), (4, 0), (4, 4), (0, 4))]
    corners += [(1.0, 1.0, 1.5), (3.0, 1.0, 1.5), (3.0, 3.0, 1.5), (1.0, 3.0, 1.5)]
    sides = {f"side {i}": (i, (i + 1) % 4, (i + 1) % 4 + 4, i + 4) for i in range(4)}
    faces = {"floor": (3, 2, 1, 0), "ceiling": (4, 5, 6, 7), **sides}
    faces |= {"top": (11, 10, 9, 8), "bottom": (8, 9, 10, 11)}
    return room_of_polygons([tuple(np.roll(c, turn)) for c in corners], faces)


@pytest.mark.parametrize("turn", [0, 1, 2])
def test_a_ray_leaves_a_panel_of_two_faces_and_meets_what_is_opposite(turn):
    """From a face of the panel to floor or ceiling, not to the other face in the same place."""
    tree = tree_of(*facets_of(_box_with_panel(turn)))
    across = np.roll([0.0, 0.0, 1.0], turn)
    faces = np.flatnonzero(np.isclose(tree.normal @ across * tree.table[:, 3], 1.5)
                           | np.isclose(tree.normal @ across * tree.table[:, 3], -1.5))  # fmt: skip
    assert len(faces) == 2
    for face in faces:
        away = -tree.normal[face]
        start = np.roll([2.1, 1.8, 1.5], turn)
        distance, met = _next_after(tree, start, away, face)
        up = away @ across > 0.0
        assert distance == pytest.approx(2.5 if up else 1.5)
        assert tree.normal[met] @ away == pytest.approx(1.0) and met not in faces
    # the panel alone, so that the first facet of all is one of its faces
    facets, box_m = facets_of(_box_with_panel(turn))
    panel = np.isclose(np.abs(facets.table[:, 3]), 1.5) & (np.abs(facets.normal @ across) > 0.5)
    alone = tree_of(type(facets)(*(part[panel] for part in facets)), box_m[panel])
    assert len(alone.table) == 2
    for face in (0, 1):
        start = np.roll([2.1, 1.8, 1.5], turn)
        assert _next_after(alone, start, -alone.normal[face], face) == (np.inf, -1)


@pytest.mark.parametrize("size_m", [0.02, 1.0, 300.0])
def test_a_room_is_convex_to_a_ten_millionth_of_its_diagonal(size_m):
    """A corner pushed in by more makes a notch, one pushed out a further plane; at any size."""
    room = box_room()
    vertices_m = size_m * room.mesh.vertices_m
    tolerance_m = 1e-7 * float(np.linalg.norm(np.ptp(vertices_m, axis=0)))
    (corner,) = np.flatnonzero((vertices_m == vertices_m.max(axis=0)).all(axis=1))
    for share, n_planes in ((-1.02, None), (-0.98, 6), (0.98, 6), (1.02, 7)):
        pushed = vertices_m.copy()
        pushed[corner, 0] += share * tolerance_m
        planes = convex_planes(replace(room, mesh=replace(room.mesh, vertices_m=pushed)))
        assert (None if planes is None else len(planes.offset_m)) == n_planes
