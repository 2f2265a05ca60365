"""The beam tree, far in time: against the lattice, a simulator that mirrors the room, and pra."""

from __future__ import annotations

import numpy as np
import pytest

from images_reference import BOX_M, SPEED_M_S, box_room, scene_of
from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray, IntArray
from roomfit.materials.priors import uniform_scattering
from roomfit.room.scene import Room
from roomfit.tracing.image_sources import (
    Budget,
    affordable_duration_s,
    expected_images,
    limits_of,
    polyhedron_images,
    trace_images,
)
from roomfit.tracing.lattice import box_images, lattice_of
from roomfit.tracing.paths import ImageSet
from simulated_rooms.polyhedra import cell_images
from simulated_rooms.polyhedral_rooms import (
    cell_volume_m3,
    l_shaped_cells,
    paper_cells,
    room_of,
    slanted_cells,
)

ALL_ORDERS = 1000
# Some 30 mirrorings of coordinates of some 50 m: 30 * 50 * 2**-53 = 2e-13.
ATOL_M = 2e-12
CELLS = {"paper": paper_cells(), "slanted": slanted_cells(), "L": l_shaped_cells()}
SOURCES = {"paper": [9.82, 6.05, 1.7], "slanted": [1.2, 1.3, 1.1], "L": [5.9, 1.2, 1.3]}
RECEIVERS = {
    "paper": [[4.3, 3.1, 1.2], [12.1, 8.2, 1.6]],
    "slanted": [[4.1, 3.2, 1.5], [2.2, 2.9, 0.8]],
    "L": [[1.3, 4.9, 0.9], [2.6, 1.4, 1.9]],
}
REACH_M = {"paper": 60.0, "slanted": 34.0, "L": 38.0}


def tree(room: Room, source: FloatArray, receivers: FloatArray, reach_m: float) -> list[ImageSet]:
    """Return the images of all orders within a distance."""
    return polyhedron_images(
        room,
        source,
        receivers,
        limits_of(ALL_ORDERS, reach_m),
        with_image_transforms=True,
    )


def assert_same(lengths: FloatArray, hits: IntArray, found: ImageSet) -> None:
    """Compare length and hits of every path; those of one length in any order."""
    assert len(found.length_m) == len(lengths)
    rows = np.column_stack([np.round(lengths, 8), hits])
    own = np.column_stack([np.round(found.length_m, 8), found.hits])
    np.testing.assert_allclose(np.sort(lengths), found.length_m, rtol=0, atol=ATOL_M)
    np.testing.assert_array_equal(rows[np.lexsort(rows.T[::-1])], own[np.lexsort(own.T[::-1])])


def test_a_box_has_the_images_of_the_lattice_to_the_last_one() -> None:
    """3347 images within 40 m, up to order 18: same places, hits and reflections."""
    source, receiver = np.array([1.23, 1.51, 1.13]), np.array([4.12, 2.97, 1.29])
    lattice = box_images(
        *(box_room(), lattice_of(box_room()), source, receiver, ALL_ORDERS, 40.0),
        with_image_transforms=True,
    )
    found = tree(box_room(lattice=False), source, receiver[None], 40.0)[0]
    assert len(lattice.length_m) == 3347
    assert_same(lattice.length_m, lattice.hits, found)
    places, expected = (s.arrival * s.length_m[:, None] for s in (found, lattice))
    order, theirs = (np.lexsort(np.round(p, 7).T) for p in (places, expected))
    np.testing.assert_allclose(places[order], expected[theirs], atol=10 * ATOL_M)
    assert found.image_transform is not None
    assert lattice.image_transform is not None
    np.testing.assert_allclose(
        found.image_transform[order], lattice.image_transform[theirs], atol=1e-13
    )
    np.testing.assert_allclose(found.departure[order], lattice.departure[theirs], atol=1e-12)


@pytest.mark.parametrize("name", CELLS)
def test_other_rooms_have_the_images_of_a_room_mirrored_instead_of_the_source(name: str) -> None:
    """Some 1500 to 2300 images a pair, to the last one, in a gabled room, a slanted one and an L.

    The other way shares nothing with this: it mirrors the room, passes openings between convex
    cells and asks a ball what each path strikes.
    """
    source, receivers = np.array(SOURCES[name]), np.array(RECEIVERS[name])
    found = tree(room_of(CELLS[name]), source, receivers, REACH_M[name])
    expected = cell_images(CELLS[name], source, receivers, REACH_M[name])
    for (lengths, hits), images in zip(expected, found, strict=True):
        assert len(lengths) > 1200
        assert_same(lengths, hits, images)


@pytest.mark.parametrize("name", ["box", *CELLS])
def test_moved_points_have_the_paths_that_the_unfolding_foretells(name: str) -> None:
    """``|V + A dS - dR|`` with moves of millimetres is a length of the moved trace.

    All but one path in fifty, which comes or goes at some edge, and in a box all. To float32's 1e-7
    of the move: 1e-9 m.
    """
    room = box_room() if name == "box" else room_of(CELLS[name])
    source = np.array(SOURCES.get(name, [1.23, 1.51, 1.13]))
    receiver = np.array(RECEIVERS.get(name, [[4.12, 2.97, 1.29]])[0])
    ds, dr = np.array([0.002, -0.003, 0.001]), np.array([-0.0015, 0.002, 0.0025])
    still = uniform_scattering(room.materials, 0.0)
    before, after = (
        trace_images(scene_of(room, [s], [r]), ALL_ORDERS, 0.09, still, with_image_transforms=True)
        for s, r in ((source, receiver), (source + ds, receiver + dr))
    )
    assert before.image_transform is not None
    images = tree_or_lattice(room, source, receiver, 0.09 * SPEED_M_S)
    observed = -images.length_m[:, None] * images.arrival
    predicted = np.linalg.norm(observed + before.image_transform @ ds - dr, axis=1)
    near = predicted < 0.09 * SPEED_M_S - 0.1
    gap = np.abs(after.length_m[None, :] - predicted[near, None]).min(axis=1)
    assert near.sum() > 100
    assert np.mean(gap < 2e-9) >= (1.0 if name == "box" else 0.98)


@pytest.mark.parametrize("name", ["box", *CELLS])
def test_departure_and_arrival_are_the_first_derivatives_of_the_length(name: str) -> None:
    """Central differences over a micrometre; a length of 20 m rounds to 4e-15, over 2e-6 m: 2e-9.

    Between two calls no path may come or go: lengths are compared where their number is the same.
    """
    room = box_room() if name == "box" else room_of(CELLS[name])
    source = np.array(SOURCES.get(name, [1.23, 1.51, 1.13]))
    receiver = np.array(RECEIVERS.get(name, [[4.12, 2.97, 1.29]])[0])
    reach_m = 18.0
    images = tree_or_lattice(room, source, receiver, reach_m)
    for axis in range(3):
        step = 1e-6 * np.eye(3)[axis]
        for moves, expected in (
            ((step, 0 * step), -images.departure[:, axis]),
            ((0 * step, step), images.arrival[:, axis]),
        ):
            ahead, behind = (
                tree_or_lattice(room, source + k * moves[0], receiver + k * moves[1], reach_m)
                for k in (1, -1)
            )
            assert len(ahead.length_m) == len(behind.length_m) == len(images.length_m)
            # matched by their place: order may change between paths of almost one length
            slope = []
            for k, length in enumerate(images.length_m):
                lengths = [
                    s.length_m[
                        np.argmin(np.linalg.norm(_observed(s) - _observed(images)[k], axis=1))
                    ]
                    for s in (ahead, behind)
                ]
                slope.append((lengths[0] - lengths[1]) / 2e-6)
                assert abs(lengths[0] - length) < 2e-6
            np.testing.assert_allclose(slope, expected, atol=1e-7)


def _observed(images: ImageSet) -> FloatArray:
    return np.asarray(-images.length_m[:, None] * images.arrival)


def tree_or_lattice(
    room: Room, source: FloatArray, receiver: FloatArray, reach_m: float
) -> ImageSet:
    """Return the images in the way that suits the room."""
    if room.shoebox_m is not None:
        return box_images(
            room,
            lattice_of(room),
            source,
            receiver,
            ALL_ORDERS,
            reach_m,
            with_image_transforms=True,
        )
    return tree(room, source, receiver[None], reach_m)[0]


def test_an_unfolding_turns_arrival_into_departure_and_mirrors_once_a_hit() -> None:
    """Orthogonal, with determinant minus one to the number of hits."""
    found = tree(
        room_of(CELLS["slanted"]),
        *(np.array(SOURCES["slanted"]), np.array(RECEIVERS["slanted"]), 25.0),
    )[0]
    assert found.image_transform is not None
    eye = np.einsum("pij,pkj->pik", found.image_transform, found.image_transform)
    np.testing.assert_allclose(eye, np.broadcast_to(np.eye(3), eye.shape), atol=1e-13)
    parity = np.where(found.hits.sum(axis=1) % 2 == 0, 1.0, -1.0)
    np.testing.assert_allclose(np.linalg.det(found.image_transform), parity, atol=1e-13)
    back = np.einsum("pij,pi->pj", found.image_transform, found.arrival)
    np.testing.assert_allclose(back, found.departure, atol=1e-13)


@pytest.mark.parametrize("name", CELLS)
def test_images_fill_space_with_one_for_each_volume_of_the_room(name: str) -> None:
    """On average over receivers, whatever the shape. Eight of them differ by some 15 % each."""
    rng = np.random.default_rng(4)
    low, high = {
        "paper": ([1, 1, 0.6], [14, 9, 2.5]),
        "slanted": ([1, 1, 0.6], [4.6, 3.5, 2.2]),
        "L": ([0.7, 0.7, 0.6], [3.2, 5.2, 2.2]),
    }[name]
    found = tree(
        room_of(CELLS[name]), np.array(SOURCES[name]), rng.uniform(low, high, (8, 3)), REACH_M[name]
    )
    mean = np.mean([len(images.length_m) for images in found])
    expected = expected_images(cell_volume_m3(CELLS[name]), REACH_M[name])
    assert mean == pytest.approx(expected, rel=0.15)


def test_what_would_take_too_long_is_refused_and_how_far_one_can_go_is_reported() -> None:
    """The duration reported is affordable, and a tenth more is not."""
    scene = scene_of(room_of(CELLS["slanted"]), [SOURCES["slanted"]], RECEIVERS["slanted"])
    still = uniform_scattering(scene.room.materials, 0.0)
    with pytest.raises(InputError, match="too many image sources"):
        trace_images(scene, ALL_ORDERS, 0.5, still, budget=Budget(work=1e4))
    with pytest.raises(InputError, match="too many image sources"):
        trace_images(scene, ALL_ORDERS, 60.0, still)
    longest_s = affordable_duration_s(scene, 0.5, work=1e5)
    assert 0.02 < longest_s < 0.2
    trace_images(scene, ALL_ORDERS, longest_s, still, budget=Budget(work=1e5))
    with pytest.raises(InputError, match="too many image sources"):
        trace_images(scene, ALL_ORDERS, 1.1 * longest_s, still, budget=Budget(work=1e5))
    assert affordable_duration_s(scene, 0.03) == 0.03
    few = affordable_duration_s(scene, 0.5, images=500.0)
    assert len(trace_images(scene, ALL_ORDERS, few, still)) <= 500


def test_points_on_symmetry_planes_and_edges_of_view_count_once() -> None:
    """Source and receiver in the middle of a box: paths run into edges and corners."""
    middle, above = np.array(BOX_M) / 2, np.array(BOX_M) * [0.5, 0.5, 0.25]
    lattice = box_images(box_room(), lattice_of(box_room()), middle, above, ALL_ORDERS, 25.0)
    found = tree(box_room(lattice=False), middle, above[None], 25.0)[0]
    assert_same(lattice.length_m, lattice.hits, found)
