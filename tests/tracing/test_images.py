"""Image sources against a billiard ball, against each other and against trying everything."""

from __future__ import annotations

from pathlib import Path

import numba
import numpy as np
import pytest

from _ac3d import as_obj
from images_reference import (
    BOX_MATERIALS,
    all_images,
    box_room,
    box_with_sheet,
    follow,
    hits_of,
    l_shaped_room,
    room_of_polygons,
    scene_of,
)
from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray
from roomfit.files.rooms import read_room
from roomfit.files.schema import RoomSpec
from roomfit.materials.priors import Scattering, uniform_scattering
from roomfit.paper.room import paper_scene
from roomfit.room.mesh import area_vectors_m2
from roomfit.room.scene import Room, triangle_material
from roomfit.tracing.image_sources import (
    Budget,
    limits_of,
    polyhedron_images,
    trace_images,
)
from roomfit.tracing.lattice import box_images, lattice_of
from roomfit.tracing.paths import ImageSet, unfolded_normals

FAR_M = 1e3
# Lengths are some 10 rounded operations on coordinates of some 10 m: 10 * 10 * 2**-53 = 1e-14.
LENGTH_ATOL_M = 1e-12

ROOMS = {"gabled": paper_scene().room, "L": l_shaped_room(), "sheet": box_with_sheet()}
PLACES = {
    "gabled": ([9.82, 6.05, 1.7], [4.3, 3.1, 1.2]),
    "L": ([5.2, 1.1, 1.3], [1.3, 4.1, 0.9]),
    "sheet": ([0.9, 0.7, 1.1], [3.1, 1.4, 1.6]),
}


def images(
    room: Room, source: FloatArray, receiver: FloatArray, order: int, length_m: float = FAR_M
) -> ImageSet:
    """Return the images of one pair by whichever way suits the room."""
    s, r = np.array(source), np.array(receiver)
    if room.shoebox_m is not None:
        return box_images(room, lattice_of(room), s, r, order, length_m)
    return polyhedron_images(room, s, r[None], limits_of(order, length_m))[0]


def assert_followed(room: Room, source: FloatArray, receiver: FloatArray, found: ImageSet) -> None:
    """Send a ball along every path: it must strike what the path says and end at the receiver."""
    owner = triangle_material(room)
    vectors = area_vectors_m2(room.mesh)
    for i, length in enumerate(found.length_m):
        ball = follow(room.mesh, np.array(source), found.departure[i], length)
        np.testing.assert_allclose(ball.end_m, receiver, atol=1e-9)
        np.testing.assert_allclose(ball.direction, found.arrival[i], atol=1e-10)
        assert found.hits[i].tolist() == hits_of(room, ball.triangles)
        if found.triangle is None or found.first_hit is None:
            continue
        struck = found.triangle[found.first_hit[i] : found.first_hit[i + 1]]
        assert owner[ball.triangles].tolist() == owner[struck].tolist()
        normals = vectors[struck] / np.linalg.norm(vectors[struck], axis=1)[:, None]
        turned = unfolded_normals(normals, np.array([0, len(struck)]))
        np.testing.assert_allclose(np.abs(turned @ found.arrival[i]), ball.cosines, atol=1e-10)


def test_a_ball_sent_along_every_path_of_a_real_room_arrives(real_data: Path) -> None:
    """A seminar room of 504 triangles with furniture and niches, order 2."""
    room, _ = read_room(RoomSpec(file=as_obj(real_data / "bras_cr2" / "scene9.ac"), unit="m"))
    source, receiver = [2.84, 0.93, -0.7], [2.09, 1.22, 0.38]
    found = images(room, source, receiver, 2)
    assert len(found.length_m) > 20
    assert_followed(room, source, receiver, found)


@pytest.mark.parametrize("name", ROOMS)
def test_no_path_is_missed_or_counted_twice(name: str) -> None:
    """Trying every sequence of planes up to order 2 finds the same paths and no others."""
    source, receiver = PLACES[name]
    room = ROOMS[name]
    expected = all_images(room, np.array(source), np.array(receiver), 2)
    found = images(room, source, receiver, 2)
    assert found.hits.tolist() == [hits_of(room, triangles) for triangles in expected]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["L", "sheet"])
def test_no_path_of_order_3_is_missed_or_counted_twice(name: str) -> None:
    """The same one order higher, where pruning has more to do."""
    source, receiver = PLACES[name]
    room = ROOMS[name]
    expected = all_images(room, np.array(source), np.array(receiver), 3)
    found = images(room, source, receiver, 3)
    assert found.hits.tolist() == [hits_of(room, triangles) for triangles in expected]


def test_a_box_has_as_many_images_as_an_octahedron_has_points() -> None:
    """(2 N + 1)(2 N**2 + 2 N + 3) / 3 up to order N."""
    counts = [len(images(box_room(), [1, 1, 1], [2, 2, 2], n).length_m) for n in range(8)]
    assert counts == [1, 7, 25, 63, 129, 231, 377, 575]


@pytest.mark.parametrize("name", [*ROOMS, "box"])
def test_sound_that_goes_back_takes_the_same_paths(name: str) -> None:
    """Reciprocity: swapped, the lengths and hits are the same and the directions turn round."""
    room = box_room() if name == "box" else ROOMS[name]
    source, receiver = PLACES.get(name, ([1.2, 1.5, 1.1], [4.13, 2.9, 1.27]))
    there, back = images(room, source, receiver, 4), images(room, receiver, source, 4)
    np.testing.assert_allclose(back.length_m, there.length_m, atol=LENGTH_ATOL_M)
    a, b = _by_direction(there.departure, there), _by_direction(-back.arrival, back)
    np.testing.assert_allclose(a[:, :3], b[:, :3], atol=1e-12)
    np.testing.assert_array_equal(a[:, 3:], b[:, 3:])


def test_a_wall_of_two_materials_gives_each_path_the_one_it_strikes() -> None:
    """A floor halved at x = 3: its reflection lies where the foot of the mirror line says."""
    corners = [(x, y, z) for z in (0.0, 2.5) for x, y in ((0, 0), (3, 0), (6, 0), (6, 4), (3, 4))]
    corners += [(0.0, 4.0, 0.0), (0.0, 4.0, 2.5)]
    faces = {
        "near floor": (10, 4, 1, 0),
        "far floor": (4, 3, 2, 1),
        "ceiling": (5, 6, 7, 8, 9, 11),
        "south": (0, 1, 2, 7, 6, 5),
        "east": (2, 3, 8, 7),
        "north": (3, 4, 10, 11, 9, 8),
        "west": (10, 0, 5, 11),
    }
    room = room_of_polygons(corners, faces)
    for receiver_x, struck in ((2.6, "near floor"), (4.6, "far floor")):
        found = images(room, [2.0, 1.0, 1.0], [receiver_x, 2.0, 1.0], 1)
        on_floor = found.hits[:, [0, 1]].sum(axis=1) > 0
        assert len(found.length_m) == 7
        assert on_floor.sum() == 1
        assert found.hits[on_floor][0, room.materials.index(struck)] == 1


def test_a_corner_hides_the_source() -> None:
    """Round the corner of an L nothing comes straight, but something by one wall."""
    source, receiver = PLACES["L"]
    assert len(images(ROOMS["L"], source, receiver, 0).length_m) == 0
    assert len(images(ROOMS["L"], source, receiver, 2).length_m) > 0
    assert len(images(ROOMS["L"], [1.0, 1.0, 1.0], receiver, 0).length_m) == 1


def test_a_sheet_reflects_on_both_sides_and_stops_what_meets_it() -> None:
    """Source and receiver on one side hear it; across it the direct sound is gone."""
    room = ROOMS["sheet"]
    curtain = room.materials.index("curtain")
    for x in (1.0, 3.4):
        found = images(room, [x, 0.8, 1.0], [x, 1.2, 1.2], 1)
        assert found.hits[:, curtain].sum() == 1
    assert len(images(room, [1.0, 0.8, 1.0], [3.4, 1.0, 1.2], 0).length_m) == 0


def test_weights_thin_by_scattering_and_spread_as_a_sphere() -> None:
    """The direct sound is 1 / (4 pi r**2), a hit takes 1 - s; materials in any order."""
    room = box_room()
    scene = scene_of(room, [[1.2, 1.5, 1.1]], [[4.1, 2.9, 1.2], [2.0, 2.0, 2.0]])
    s = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 1.0])
    backwards = Scattering(BOX_MATERIALS[::-1], s[::-1])
    paths = trace_images(scene, 3, 0.1, backwards)
    expected = np.prod((1.0 - s) ** paths.hits_specular, axis=1) / (4 * np.pi * paths.length_m**2)
    np.testing.assert_allclose(paths.weight_per_m2, expected, rtol=1e-14)
    np.testing.assert_array_equal(paths.sampling_scattering, s[None])
    assert np.bincount(paths.pair).tolist() == [63, 63]
    assert not paths.hits_diffuse.any()
    assert set(paths.batch.tolist()) == {-1}
    np.testing.assert_allclose(np.linalg.norm(paths.departure, axis=1), 1.0, rtol=1e-6)


def test_one_thread_and_two_find_the_same_bits() -> None:
    """Every image writes to its own place."""
    before = numba.get_num_threads()
    found = []
    try:
        for n in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
            numba.set_num_threads(n)
            found.append(images(ROOMS["gabled"], *PLACES["gabled"], 4))
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(found[0].length_m, found[1].length_m)
    np.testing.assert_array_equal(found[0].departure, found[1].departure)


def test_a_round_room_keeps_every_path_of_low_order() -> None:
    """A floor with 40 corners is clipped by its rectangle: nothing is lost.

    Floor, ceiling and the direct sound: three paths whatever the side walls do.
    """
    angle = 2.0 * np.pi * np.arange(40) / 40
    ring = np.column_stack([3.0 * np.cos(angle), 3.0 * np.sin(angle)])
    corners = [(x, y, z) for z in (0.0, 2.5) for x, y in ring.tolist()]
    faces: dict[str, tuple[int, ...]] = {
        "floor": tuple(range(39, -1, -1)),
        "ceiling": tuple(range(40, 80)),
    }
    for i in range(40):
        faces[f"side {i}"] = (i, (i + 1) % 40, (i + 1) % 40 + 40, i + 40)
    room = room_of_polygons(corners, faces)
    source, receiver = [0.4, 0.7, 1.1], [-1.1, 0.3, 1.4]
    found = images(room, source, receiver, 2)
    # up and down: direct, floor, ceiling, floor-ceiling, ceiling-floor
    assert (found.hits[:, 2:].sum(axis=1) == 0).sum() == 5
    assert_followed(room, source, receiver, found)


def test_what_cannot_be_traced_is_refused() -> None:
    """Too many images, a source on a receiver, other materials."""
    scene = scene_of(box_room(), [[1.2, 1.5, 1.1]], [[4.1, 2.9, 1.2]])
    still = uniform_scattering(BOX_MATERIALS, 0.0)
    with pytest.raises(InputError, match="too many image sources"):
        trace_images(scene, 1000, 3.0, still, budget=Budget(memory_bytes=2**30))
    gabled = scene_of(ROOMS["gabled"], [PLACES["gabled"][0]], [PLACES["gabled"][1]])
    scattering = uniform_scattering(gabled.room.materials, 0.0)
    with pytest.raises(InputError, match="too many image sources"):
        trace_images(gabled, 12, 1.0, scattering, budget=Budget(memory_bytes=2**20))
    with pytest.raises(InputError, match="a source stands where a receiver is"):
        trace_images(scene_of(box_room(), [[1, 1, 1]], [[1, 1, 1]]), 1, 0.1, still)
    with pytest.raises(InputError, match="different materials"):
        trace_images(scene, 1, 0.1, uniform_scattering(("a",), 0.0))


def _by_direction(vectors: FloatArray, found: ImageSet) -> FloatArray:
    order = np.lexsort(np.round(vectors, 7).T)
    return np.column_stack([vectors, found.hits])[order]
