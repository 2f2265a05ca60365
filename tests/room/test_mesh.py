"""Volume, inside, distances and the air of meshes, against geometry done by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boxes_in_space import box_with_doors
from roomfit.base.errors import InputError
from roomfit.base.findings import Code
from roomfit.base.polygon import Face, Surface
from roomfit.room.build import build_mesh
from roomfit.room.inside import is_in_sight, is_inside, nearest_triangles
from roomfit.room.mesh import (
    SHOEBOX_SURFACES,
    Mesh,
    area_vectors_m2,
    as_shoebox,
    box_of,
    corners_m,
    mean_free_path_m,
    refuse,
    shoebox_mesh,
    surface_area_m2,
    volume_m3,
)
from roomfit.tracing.enclosure import reached

LENGTHS = (5.0, 4.0, 3.0)
WALL = Surface("wall", None, "plaster")
BOX = np.array([[x, y, z] for z in (0, 3) for y in (0, 4) for x in (0, 5)], dtype=float)
QUADS = ((0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6))


def rotation(seed: int) -> np.ndarray:
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def box_faces() -> list[Face]:
    names = SHOEBOX_SURFACES
    return [Face(quad, Surface(n, None, n)) for quad, n in zip(QUADS, names, strict=True)]


def l_room() -> Mesh:
    """A room over the L-shaped floor of 7 m2, 3 m high."""
    floor = [(0, 0), (4, 0), (4, 1), (1, 1), (1, 4), (0, 4)]
    vertices = np.array([(x, y, z) for z in (0.0, 3.0) for x, y in floor])
    sides = [Face((i, (i + 1) % 6, (i + 1) % 6 + 6, i + 6), WALL) for i in range(6)]
    ends = [Face((5, 4, 3, 2, 1, 0), WALL), Face((6, 7, 8, 9, 10, 11), WALL)]
    return build_mesh(vertices, [*sides, *ends])[0]


def interior_points(mesh: Mesh, n: int, rng: np.random.Generator) -> np.ndarray:
    tries = rng.uniform(mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0), (10 * n, 3))
    return tries[is_inside(mesh, tries)][:n]


def codes(findings) -> list[str]:
    return [f.code for f in findings]


def test_a_shoebox_has_the_measures_of_a_box():
    """V, S and 4V/S of a 5 x 4 x 3 m box by hand; every surface lies where its name says."""
    mesh = shoebox_mesh(LENGTHS)

    assert volume_m3(mesh) == pytest.approx(60.0, rel=1e-14)
    assert surface_area_m2(mesh) == pytest.approx(94.0, rel=1e-14)
    assert mean_free_path_m(mesh) == pytest.approx(240.0 / 94.0, rel=1e-14)
    outwards = [(-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1)]
    vectors = area_vectors_m2(mesh)
    for triangle, owner in enumerate(mesh.triangle_surface):
        unit = vectors[triangle] / np.linalg.norm(vectors[triangle])
        np.testing.assert_allclose(unit, outwards[owner], atol=1e-15)
    assert tuple(s.name for s in mesh.surfaces) == SHOEBOX_SURFACES


def test_an_l_shaped_room_has_floor_times_height():
    """7 m2 times 3 m; walls 16 m round times 3 m and twice the floor."""
    mesh = l_room()

    assert volume_m3(mesh) == pytest.approx(21.0, rel=1e-14)
    assert surface_area_m2(mesh) == pytest.approx(16 * 3 + 14, rel=1e-14)


@given(st.integers(0, 10_000), st.floats(-500, 500))
def test_volume_and_area_do_not_change_when_the_room_is_moved(seed, shift):
    """Any rotation, any place."""
    mesh = l_room()
    moved = replace(mesh, vertices_m=mesh.vertices_m @ rotation(seed).T + shift)

    # coordinates of 900 m rounded to 1e-13 m, on a room of a few metres
    assert volume_m3(moved) == pytest.approx(21.0, rel=1e-10)
    assert surface_area_m2(moved) == pytest.approx(62.0, rel=1e-10)


@given(st.lists(st.booleans(), min_size=20, max_size=20))
def test_any_set_of_flipped_triangles_is_turned_back(flips):
    """All 2^20 ways to flip the triangles of the L-shaped room lead to the same volume."""
    mesh = l_room()
    flip = np.array(flips)
    triangles = mesh.triangles.copy()
    triangles[flip] = triangles[flip][:, ::-1]

    repaired, findings = reached(replace(mesh, triangles=triangles))

    assert volume_m3(repaired) == pytest.approx(21.0, rel=1e-14)
    np.testing.assert_allclose(area_vectors_m2(repaired), area_vectors_m2(mesh), atol=1e-15)
    assert set(codes(findings)) <= {Code.AIR_REACHED}


def test_a_room_is_the_same_with_all_normals_out_of_the_air_and_into_it():
    """Many programs draw the one, as many the other; the right way is kept bit by bit."""
    mesh = l_room()
    assert reached(mesh) == (mesh, ())
    turned, findings = reached(replace(mesh, triangles=mesh.triangles[:, ::-1]))
    assert findings == ()
    np.testing.assert_array_equal(turned.triangles, mesh.triangles)


def test_a_pillar_in_the_air_takes_its_volume_away():
    """A closed unit cube hangs in the box: 60 - 1 m3, whichever way its normals point."""
    small = BOX / LENGTHS + [2.0, 1.5, 1.0]
    cube = [Face(tuple(c + 8 for c in quad), Surface("pillar", None, "wood")) for quad in QUADS]
    for faces in (cube, [Face(f.corners[::-1], f.surface) for f in cube]):
        mesh, _ = build_mesh(np.concatenate([BOX, small]), [*box_faces(), *faces])
        repaired, _ = reached(mesh)

        assert volume_m3(repaired) == pytest.approx(59.0, rel=1e-13)
        assert surface_area_m2(repaired) == pytest.approx(100.0, rel=1e-13)
        centre = np.array([[2.5, 2.0, 1.5], [1.0, 1.0, 1.0]])
        assert is_inside(repaired, centre).tolist() == [False, True]


def test_a_sheet_in_the_air_counts_twice_in_area_and_not_at_all_in_volume():
    """A curtain of 2 x 1 m in the box, not connected to anything, whether or not it is said."""
    curtain = np.array([[1, 1, 1], [3, 1, 1], [3, 1, 2], [1, 1, 2]], dtype=float)
    for said in (False, True):
        sheet = Face((8, 9, 10, 11), Surface("curtain", None, "cloth", double_sided=said))
        mesh, findings = reached(
            build_mesh(np.concatenate([BOX, curtain]), [*box_faces(), sheet])[0]
        )
        assert volume_m3(mesh) == pytest.approx(60.0, rel=1e-13)
        assert surface_area_m2(mesh) == pytest.approx(98.0, rel=1e-13)
        assert codes(findings) == ([] if said else [Code.AIR_REACHED])
        assert all("'curtain'" in f.sentence for f in findings)


def test_a_long_edge_beside_two_short_ones_is_closed():
    """The floor's west edge is one piece, the west wall is made of two: a T-junction."""
    faces = [f for f in box_faces() if f.surface.name != "west"]
    vertices = np.concatenate([BOX, [[0, 1, 0], [0, 1, 3]]])
    halves = [Face((0, 4, 9, 8), WALL), Face((8, 9, 6, 2), WALL)]
    mesh, _ = build_mesh(vertices, [*faces, *halves])

    assert reached(mesh) == (mesh, ())
    assert volume_m3(mesh) == pytest.approx(60.0, rel=1e-14)


def test_corners_that_are_a_rounding_apart_are_one():
    """Every face brings its own corners, each off by up to 20 micrometres."""
    rng = np.random.default_rng(3)
    vertices = np.concatenate([BOX[list(q)] + rng.uniform(-2e-5, 2e-5, (4, 3)) for q in QUADS])
    faces = [Face(tuple(range(4 * i, 4 * i + 4)), WALL) for i in range(6)]

    mesh, findings = build_mesh(vertices, faces)

    assert len(mesh.vertices_m) == 8
    assert not findings
    assert reached(mesh) == (mesh, ())


def test_points_are_inside_a_rotated_box_where_their_coordinates_say_so():
    """2,000 random points, half of them outside."""
    rng = np.random.default_rng(7)
    turn = rotation(11)
    mesh = shoebox_mesh(LENGTHS)
    mesh = replace(mesh, vertices_m=mesh.vertices_m @ turn.T)
    points = rng.uniform(-0.25, 1.25, (2000, 3)) * LENGTHS

    expected = np.all((points > 0) & (points < LENGTHS), axis=1)

    np.testing.assert_array_equal(is_inside(mesh, points @ turn.T), expected)


def test_the_notch_of_an_l_shaped_room_is_outside():
    """The notch is 1 to 4 m in x and y, within the bounding box."""
    points = np.array([[2.0, 2.0, 1.0], [0.5, 2.0, 1.0], [2.0, 0.5, 1.0]])

    assert is_inside(l_room(), points).tolist() == [False, True, True]
    assert is_inside(l_room(), interior_points(l_room(), 200, np.random.default_rng(1))).all()


def test_points_of_an_l_shaped_room_see_each_other_where_the_notch_is_not_between_them():
    """Of 400 pairs; the way between them, in 4000 steps, is in the notch or is not."""
    rng, mesh = np.random.default_rng(7), l_room()
    ends = interior_points(mesh, 800, rng).reshape(400, 2, 3)
    share = np.linspace(0.0, 1.0, 4001)[:, None]
    hidden = [bool(np.any(np.all((a + share * (b - a))[:, :2] > 1.0, axis=1))) for a, b in ends]
    assert 20 < sum(hidden) < 380
    assert [not is_in_sight(mesh, a, b) for a, b in ends] == hidden


def test_distances_to_the_walls_of_a_box_are_those_of_its_planes():
    """Inside: the least of six; outside: the length of the vector to the nearest box point."""
    rng = np.random.default_rng(5)
    points = rng.uniform(-0.5, 1.5, (500, 3)) * LENGTHS
    past = np.maximum(np.maximum(-points, points - LENGTHS), 0.0)
    within = np.minimum(points, np.array(LENGTHS) - points).min(axis=1)
    expected = np.where(past.any(axis=1), np.linalg.norm(past, axis=1), within)

    found = nearest_triangles(shoebox_mesh(LENGTHS), points)[0]

    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13)


def holed_box(hole_m: float) -> Mesh:
    """The box with a square hole in its ceiling, around which the ceiling is four pieces."""
    faces = [f for f in box_faces() if f.surface.name != "ceiling"]
    low, high = 1.5, 1.5 + hole_m
    hole = [[low, low, 3], [high, low, 3], [high, high, 3], [low, high, 3]]
    corners, rim = (4, 5, 7, 6), (8, 9, 10, 11)
    for i in range(4):
        j = (i + 1) % 4
        faces.append(Face((corners[i], corners[j], rim[j], rim[i]), WALL))
    return build_mesh(np.concatenate([BOX, hole]), faces)[0]


def test_a_hole_is_an_error_and_a_pinhole_a_finding_with_its_size_and_place():
    """0.27 % of the surface, and 0.01 %: flights from everywhere meet each part by its area."""
    _, (large,) = reached(holed_box(0.5))
    _, (small,) = reached(holed_box(0.1))

    assert (large.code, small.code) == (Code.LEAK, Code.SMALL_LEAK)
    # 265 and 11 flights: standard errors of 6 and 30 %, three of each
    assert large.evidence["area_m2"] == pytest.approx(0.25, rel=0.19)
    assert small.evidence["area_m2"] == pytest.approx(0.01, rel=0.91)
    with pytest.raises(
        InputError, match=r"the mesh leaks\n  where +'wall' near \(1\.[5-9].*, 3.000"
    ):
        refuse([large])
    # a hole of 0.01 m2, seen from the middle 1.5 m below, is 0.005 m3 of the divergence sum
    assert volume_m3(holed_box(0.1)) == pytest.approx(60.0 - 0.005, abs=1e-4)


def test_faces_without_area_are_left_out():
    """Two corners for three, and three on a line: no sound strikes either."""
    vertices = np.concatenate([BOX, [[1.0, 0.0, 0.0]]])
    for corners in ((0, 0, 1), (0, 8, 1)):
        bad = Face(corners, Surface("sliver", None, "glass"))
        mesh, findings = build_mesh(vertices, [*box_faces(), bad])
        assert findings == () and box_of(mesh) is not None


def test_of_faces_back_to_back_sound_strikes_the_one_that_looks_at_it():
    """A wall of felt and brick between two rooms: each has its own side of it."""
    mesh = l_room()
    wall = np.array([[1, 0, 0], [1, 1, 0], [1, 1, 3], [1, 0, 3]], dtype=float)
    n = len(mesh.vertices_m)
    parts = [Face(tuple(t), WALL) for t in mesh.triangles.tolist()]
    parts += [Face((n, n + 1, n + 2, n + 3), Surface("east", None, "felt"))]
    parts += [Face((n, n + 3, n + 2, n + 1), Surface("west", None, "brick"))]
    both = build_mesh(np.concatenate([mesh.vertices_m, wall]), parts)[0]
    for at_m, volume, name in (((0.5, 3.0, 1.0), 12.0, "west"), ((3.0, 0.5, 1.0), 9.0, "east")):
        room, findings = reached(both, [at_m])
        assert volume_m3(room) == pytest.approx(volume, rel=1e-12)
        owner = {room.surfaces[s].name for s in room.triangle_surface}
        assert owner == {"wall", name}
        assert codes(findings) == [Code.SEVERAL_SPACES, Code.AIR_REACHED]


def test_a_warped_polygon_is_a_finding_and_beyond_a_centimetre_a_fault():
    """One corner of the ceiling lifted by 8 mm and by 80 mm is 2 and 20 mm off the plane."""
    for lift, code, severity, said in (
        (0.008, Code.WARPED_POLYGON, "info", "2.0 mm"),
        (0.08, Code.POLYGON_NOT_PLANAR, "serious", "20 mm"),
    ):
        vertices = BOX.copy()
        vertices[7, 2] += lift
        flat = [f for f in box_faces() if f.surface.name in ("ceiling", "floor")]
        _, findings = build_mesh(vertices, flat)

        assert [(f.code, f.severity) for f in findings] == [(code, severity)]
        assert said in findings[0].sentence


BOX_TURN, BOX_AT = rotation(8), np.array([-3.0, 7.0, 0.4])
DOORS = {1: (0.2, 0.5, 0.0, 0.7), 3: (0.4, 0.6, 0.3, 0.6)}


@given(st.integers(0, 2**32 - 1))
def test_a_box_is_known_wherever_it_stands_and_however_it_is_turned(seed: int) -> None:
    """Its corners are those that it was made of, and each triangle lies in the wall that it has."""
    rng = np.random.default_rng(seed)
    lengths, turn, by_m = rng.uniform(1.0, 9.0, 3), rotation(seed), rng.normal(0.0, 30.0, 3)
    mesh = box_with_doors(lengths, DOORS, turn, by_m)
    box = box_of(mesh)
    assert box is not None
    np.testing.assert_allclose(box.axes @ box.axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(box.axes) > 0.0
    assert np.argmax(np.abs(box.axes[:, 2])) == 2 and box.axes[2, 2] > 0.0 and box.axes[0, 0] > 0.0
    unit = np.indices((2, 2, 2)).reshape(3, -1).T
    found = box.origin_m + (unit * box.lengths_m) @ box.axes
    made = by_m + (unit * lengths) @ turn.T
    apart = np.linalg.norm(found[:, None] - made, axis=2)
    np.testing.assert_allclose(apart.min(axis=0), 0.0, atol=1e-10)
    own = (corners_m(mesh) - box.origin_m) @ box.axes.T
    for triangle, wall in zip(own, box.wall, strict=True):
        at = box.lengths_m[wall // 2] if wall % 2 else 0.0
        np.testing.assert_allclose(triangle[:, wall // 2], at, atol=1e-10)


def panelled_box() -> Mesh:
    """The box, its ceiling turned to the west, with a square 0.2 m before that and closed sides."""
    hole = holed_box(0.5)
    low = hole.vertices_m[8:12] - np.array([0.0, 0.0, 0.2])
    sides = [(8 + i, 8 + (i + 1) % 4, 12 + (i + 1) % 4, 12 + i) for i in range(4)]
    added = [
        (12, 13, 14),
        (12, 14, 15),
        *(t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))),
    ]
    return Mesh(
        np.vstack([hole.vertices_m, low])[:, [2, 1, 0]] * [-1.0, 1.0, 1.0] + [3.0, 0.0, 0.0],
        np.vstack([hole.triangles, added]),
        np.append(hole.triangle_surface, 10 * [0]),
        hole.surfaces,
    )


def no_boxes() -> dict[str, Mesh]:
    box = build_mesh(BOX, box_faces())[0]
    slanted = box.vertices_m + np.where(box.vertices_m[:, :1] > 0.0, [[0.0, 0.0, 0.01]], 0.0)
    curtain = np.array([[2.0, 1.0, 1.0], [2.0, 2.0, 1.0], [2.0, 1.0, 2.0]])
    sheet = Mesh(
        np.vstack([box.vertices_m, curtain]),
        np.vstack([box.triangles, [[8, 9, 10]]]),
        np.append(box.triangle_surface, 6),
        (*box.surfaces, Surface("curtain", double_sided=True)),
    )
    twice, gone = np.array(box.triangles), np.arange(12) < 11
    twice[1] = twice[0]
    return {
        "slanted": replace(box, vertices_m=slanted),
        "l-shaped": l_room(),
        "inside out": replace(box, triangles=box.triangles[:, ::-1]),
        "with a sheet": sheet,
        "half a wall gone": replace(
            box, triangles=box.triangles[gone], triangle_surface=box.triangle_surface[gone]
        ),
        "half a wall in place of the other": replace(box, triangles=twice),
        "with a hole": holed_box(0.5),
        "with a panel": panelled_box(),
        "with furniture": replace(
            box,
            vertices_m=np.vstack([box.vertices_m, 0.2 * box.vertices_m + 1.0]),
            triangles=np.vstack([box.triangles, box.triangles[:, ::-1] + 8]),
            triangle_surface=np.tile(box.triangle_surface, 2),
        ),
        "flat": build_mesh(BOX, box_faces()[4:5])[0],
    }


@pytest.mark.parametrize("name", no_boxes())
def test_what_is_no_box_is_none_at_the_origin_or_elsewhere(name: str) -> None:
    mesh = no_boxes()[name]
    assert box_of(mesh) is None and as_shoebox(mesh) is None
    assert box_of(replace(mesh, vertices_m=mesh.vertices_m @ BOX_TURN.T + BOX_AT)) is None


@given(
    order=st.permutations(range(12)), turns=st.lists(st.integers(0, 2), min_size=12, max_size=12)
)
def test_a_drawn_box_is_the_shoebox_whatever_the_order_of_its_triangles(
    order: list[int], turns: list[int]
) -> None:
    """Walls keep their names; west, east, south, north, floor and ceiling come in that order."""
    drawn = build_mesh(BOX, box_faces())[0]
    triangles = np.array([np.roll(drawn.triangles[i], turns[i]) for i in order])
    drawn = Mesh(drawn.vertices_m, triangles, drawn.triangle_surface[order], drawn.surfaces)
    box = as_shoebox(drawn)
    assert box is not None
    assert [s.name for s in box.surfaces] == list(SHOEBOX_SURFACES)
    expected = shoebox_mesh(LENGTHS)
    np.testing.assert_array_equal(box.vertices_m, expected.vertices_m)
    np.testing.assert_array_equal(box.triangles, expected.triangles)


def test_a_box_that_stands_elsewhere_or_has_two_surfaces_in_a_wall_is_no_shoebox() -> None:
    """Its walls have no names, or positions in results would be others than those of the drawing.

    `box_of` finds it all the same.
    """
    box = build_mesh(BOX, box_faces())[0]
    assert as_shoebox(box) is not None
    door = replace(box, surfaces=(*box.surfaces, Surface("door")))
    owner = np.where(np.arange(12) == 3, 6, door.triangle_surface)
    for other in (
        replace(box, vertices_m=box.vertices_m + np.array([0.0, 0.01, 0.0])),
        replace(box, vertices_m=box.vertices_m @ rotation(8).T),
        replace(door, triangle_surface=owner),
    ):
        assert as_shoebox(other) is None and box_of(other) is not None


def test_faces_that_are_doubtful_are_told_from_their_limits_on_and_others_kept():
    """A wall that is folded across: 1 mm is the most that is flat, 1 cm the most that is cut."""
    for off_m, expected in (
        (0.95e-3, []),
        (1.05e-3, [Code.WARPED_POLYGON]),
        (9.5e-3, [Code.WARPED_POLYGON]),
        (10.5e-3, [Code.POLYGON_NOT_PLANAR]),
    ):
        vertices = BOX.copy()
        # lifted by four times as much, one corner of four lies so far off the plane of the mean
        (corner,) = np.flatnonzero((BOX.max(axis=0) == BOX).all(axis=1))
        vertices[corner, 2] += 4.0 * off_m
        ceiling = [f for f in box_faces() if (BOX[list(f.corners), 2] == BOX[:, 2].max()).all()]
        _, findings = build_mesh(vertices, ceiling)
        assert codes(findings) == expected
        for found in findings:
            assert found.evidence["off_plane_m"] == pytest.approx(off_m, rel=1e-3)
