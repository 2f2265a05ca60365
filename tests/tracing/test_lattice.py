"""Images of a box that stands anywhere, with doors in its walls: those of a tree of beams."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from boxes_in_space import box_with_doors, room_with_doors, rotation
from images_reference import follow
from roomfit.base.typing import FloatArray
from roomfit.room.mesh import area_vectors_m2
from roomfit.room.scene import Room
from roomfit.tracing.image_sources import (
    limits_of,
    polyhedron_images,
)
from roomfit.tracing.lattice import box_images, lattice_of
from roomfit.tracing.paths import ImageSet, unfolded_normals
from simulated_rooms.polyhedra import cell_images
from simulated_rooms.polyhedral_rooms import room_of, turned_cells

LENGTHS_M = (6.1, 4.7, 2.8)
# a door from the floor up, a window, and a panel in the ceiling
DOORS = {0: (0.2, 0.4, 0.0, 0.75), 2: (0.3, 0.7, 0.3, 0.75), 5: (0.1, 0.5, 0.6, 0.9)}
TURNED = rotation(33.0), (12.3, -4.5, 0.7)
TURNED_CELLS = rotation(30.0), (2.3, -1.7, 0.4)
# shares of the lengths, so odd that no path meets an edge
S, R = (0.2137, 0.3261, 0.4193), (0.7079, 0.6131, 0.4517)


def random_doors(rng: np.random.Generator) -> dict[int, tuple[float, ...]]:
    """Return up to four holes: windows, doors down to an edge of their wall, and whole strips."""
    doors = {}
    for wall in rng.permutation(6)[: rng.integers(0, 5)].tolist():
        (a, b), (c, d) = rng.uniform(0.1, 0.45, 2), rng.uniform(0.55, 0.9, 2)
        doors[wall] = [(a, c, b, d), (a, c, 0.0, d), (0.0, 1.0, 0.0, d)][rng.integers(3)]
    return doors


def placed(shares: tuple[float, ...], lengths_m, turn: FloatArray, by_m) -> FloatArray:
    return turn @ (np.array(shares) * lengths_m) + np.array(by_m)


def assert_equal_images(found: ImageSet, expected: ImageSet, room: Room) -> None:
    """Each image of the one at the place of one of the other, by the same walls in the same order.

    Coordinates are turned, and mirrored some twenty times: 20 * 50 m * 2**-53 = 1e-13.
    """
    assert len(found.length_m) == len(expected.length_m)
    np.testing.assert_allclose(found.length_m, expected.length_m, rtol=0, atol=1e-9)
    # those of equal length in any order
    keys = [np.round(-s.arrival * s.length_m[:, None], 6) + 0.0 for s in (found, expected)]
    one, other = (np.lexsort(k.T) for k in keys)
    for name in ("departure", "arrival", "image_transform"):
        a, b = getattr(found, name)[one], getattr(expected, name)[other]
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-9, err_msg=name)
    np.testing.assert_array_equal(found.hits[one], expected.hits[other])
    assert found.triangle is not None and expected.triangle is not None
    for i, j in zip(one, other, strict=True):
        a = found.triangle[found.first_hit[i] : found.first_hit[i + 1]]
        b = expected.triangle[expected.first_hit[j] : expected.first_hit[j + 1]]
        assert a.tolist() == b.tolist()


@given(st.integers(0, 2**32 - 1))
@hypothesis_settings(max_examples=40, deadline=None)
def test_a_box_anywhere_has_the_images_of_a_tree_of_beams(seed: int) -> None:
    """Within 2.5 diagonals: some 200 to 1000 paths by walls with up to four doors."""
    rng = np.random.default_rng(seed)
    lengths_m = rng.uniform((2.0, 2.0, 2.0), (9.0, 7.0, 5.0))
    turn, by_m = rotation(rng.uniform(-180.0, 180.0), rng.uniform(-40.0, 40.0)), rng.normal(size=3)
    start, end = (placed(p, lengths_m, turn, by_m) for p in rng.uniform(0.08, 0.92, (2, 3)))
    room = room_with_doors(box_with_doors(lengths_m, random_doors(rng), turn, by_m))
    reach_m = 2.5 * float(np.linalg.norm(lengths_m)) + 0.0123
    args = lattice_of(room), start, end, 1000, reach_m
    found = box_images(room, *args, with_image_transforms=True, with_triangles=True)
    expected = polyhedron_images(
        room, start, end[None], limits_of(1000, reach_m), with_image_transforms=True
    )[0]
    assert_equal_images(found, expected, room)
    plain = box_images(room, *args)
    np.testing.assert_array_equal(plain.hits, found.hits)
    assert plain.triangle is None and plain.image_transform is None


def turned_room() -> Room:
    return room_with_doors(box_with_doors(LENGTHS_M, DOORS, *TURNED))


def test_a_ball_sent_along_every_path_strikes_the_doors_that_the_path_says() -> None:
    """129 paths up to order 4, followed by plain numpy: triangles, angles, and where they end."""
    room = turned_room()
    source, receiver = (placed(p, LENGTHS_M, *TURNED) for p in (S, R))
    found = box_images(room, lattice_of(room), source, receiver, 4, 1e3, with_triangles=True)
    vectors = area_vectors_m2(room.mesh)
    normals = vectors / np.linalg.norm(vectors, axis=1)[:, None]
    assert len(found.length_m) == 129
    assert found.triangle is not None and found.first_hit is not None
    for i, length in enumerate(found.length_m):
        ball = follow(room.mesh, source, found.departure[i], length)
        np.testing.assert_allclose(ball.end_m, receiver, atol=1e-9)
        struck = found.triangle[found.first_hit[i] : found.first_hit[i + 1]]
        assert ball.triangles == struck.tolist()
        turned = unfolded_normals(normals[struck], np.array([0, len(struck)]))
        np.testing.assert_allclose(np.abs(turned @ found.arrival[i]), ball.cosines, atol=1e-10)


def test_a_simulator_that_mirrors_the_room_has_the_same_hits() -> None:
    """Every path within 40 m, by another way of finding them: 3345 lengths and their doors."""
    cells = turned_cells()
    room = room_of(cells)
    source, receiver = (placed(p, LENGTHS_M, *TURNED_CELLS) for p in (S, R))
    ours = box_images(room, lattice_of(room), source, receiver, 1000, 40.0)
    lengths, hits = cell_images(cells, source, receiver[None], 40.0)[0]
    near = np.argsort(lengths)
    np.testing.assert_allclose(ours.length_m, lengths[near], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(ours.hits, hits[near])
    assert ours.hits[:, cells.materials.index("door")].sum() > 500


def test_a_door_is_struck_as_often_as_it_is_large() -> None:
    """Over all places of source and receiver every point of a wall is struck alike.

    Forty pairs, whose shares spread by a tenth: standard errors of 2 %, false alarms below 1e-3.
    """
    room, rng = turned_room(), np.random.default_rng(5)
    hits = np.zeros(len(room.materials))
    for shares in rng.uniform(0.02, 0.98, (40, 2, 3)):
        source, receiver = (placed(p, LENGTHS_M, *TURNED) for p in shares)
        hits += box_images(room, lattice_of(room), source, receiver, 1000, 50.0).hits.sum(axis=0)
    for wall, name in ((0, "west"), (2, "south"), (5, "ceiling")):
        low_u, high_u, low_v, high_v = DOORS[wall]
        door, rest = (hits[room.materials.index(n)] for n in (f"door {wall}", name))
        share = (high_u - low_u) * (high_v - low_v)
        assert door / (door + rest) == pytest.approx(share, rel=0.07)
