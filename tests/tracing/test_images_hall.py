"""Images in a furnished hall of many small walls: against trying everything, and what they cost."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from images_reference import all_images, hits_of, scene_of
from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray
from roomfit.materials.priors import uniform_scattering
from roomfit.room.mesh import area_vectors_m2, corners_m
from roomfit.tracing.image_sources import Budget, affordable_order, trace_images
from roomfit.tracing.reflectors import convex_pieces
from simulated_rooms.hall import hall_room

SOURCE = [2.71, 1.13, 1.57]
RECEIVERS = [[11.3, -2.17, 5.21], [23.9, 4.31, 6.07]]


@pytest.mark.slow
@pytest.mark.parametrize(("n_triangles", "order"), [(212, 2), (1012, 2)])
def test_a_hall_of_seats_has_the_images_that_trying_everything_finds(
    n_triangles: int, order: int
) -> None:
    """Fifty seats cast shadows that cut beams into many pieces; no image is lost or made up."""
    room = hall_room(n_triangles)
    receivers = RECEIVERS[:1]
    scene = scene_of(room, [SOURCE], receivers)
    still = uniform_scattering(room.materials, 0.0)
    paths = trace_images(scene, order, 10.0, still)
    corners = corners_m(room.mesh)
    normals = area_vectors_m2(room.mesh)
    for pair, receiver in enumerate(receivers):
        own = paths.pair == pair
        expected = all_images(room, np.array(SOURCE), np.array(receiver), order)
        lengths = [_length_m(corners, normals, triangles, receiver) for triangles in expected]
        assert own.sum() == len(expected) > order
        # each mirroring rounds coordinates of at most 60 m: 3 * 60 * 2**-53 = 2e-14
        np.testing.assert_allclose(paths.length_m[own], lengths, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(
            paths.hits_specular[own], [hits_of(room, triangles) for triangles in expected]
        )


def _length_m(
    corners: FloatArray, normals: FloatArray, triangles: list[int], receiver: list[float]
) -> float:
    """Return the length of a path by mirroring the receiver in its triangles, last one first."""
    image = np.array(receiver)
    for t in reversed(triangles):
        normal = normals[t] / np.linalg.norm(normals[t])
        image = image - 2.0 * np.dot(image - corners[t, 0], normal) * normal
    return float(np.linalg.norm(image - SOURCE))


def test_the_order_reported_is_affordable_and_the_next_one_is_not() -> None:
    """Counted work: a hall of 76 walls, and the same hall asked for less or more."""
    scene = scene_of(hall_room(1012), [SOURCE, [3.1, -2.3, 1.4]], RECEIVERS)
    still = uniform_scattering(scene.room.materials, 0.0)
    order = affordable_order(scene, 10, 1.0, work=1e5)
    assert 1 <= order < 10
    trace_images(scene, order, 1.0, still, budget=Budget(work=1e5))
    with pytest.raises(InputError, match="too many image sources"):
        trace_images(scene, order + 1, 1.0, still, budget=Budget(work=1e5))
    assert affordable_order(scene, 1, 1.0, work=1e5) == 1
    assert affordable_order(scene, 3, 1.0, work=1.0) == 0
    assert affordable_order(scene, 10, 1.0, images=20.0) < order


@given(st.lists(st.booleans(), min_size=9, max_size=64), st.integers(0, 2**32 - 1))
def test_pieces_of_any_pattern_of_squares_are_convex_and_lose_no_area(
    pattern: list[bool], seed: int
) -> None:
    """In a plane of any direction, triangles in any order: areas add up."""
    rng = np.random.default_rng(seed)
    cells = [(i % 8, i // 8) for i, there in enumerate(pattern) if there]
    if not cells:
        return
    square = np.array([[(0, 0), (1, 0), (1, 1)], [(0, 0), (1, 1), (0, 1)]], dtype=float)
    flat = np.concatenate([square + np.array(cell, dtype=float) for cell in cells])
    frame = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    u, v, normal = frame[0], frame[1], np.cross(frame[0], frame[1])
    triangles = (flat[..., :1] * u + flat[..., 1:] * v + normal)[rng.permutation(len(flat))]
    pieces = convex_pieces(triangles, normal, 1e-6)
    total = 0.0
    for piece in pieces:
        away = piece[1:] - piece[0]
        total += 0.5 * float(np.cross(away[:-1], away[1:]).sum(axis=0) @ normal)
        along = np.roll(piece, -1, axis=0) - piece
        turns = np.cross(along, np.roll(along, -1, axis=0)) @ normal
        assert turns.min() > -1e-9
    assert len(pieces) <= len(cells)
    assert total == pytest.approx(len(cells), rel=1e-9)
