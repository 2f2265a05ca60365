"""Polygons are cut into triangles that cover exactly them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roomfit.base.polygon import area_vector_m2, triangulate

L_FLOOR = np.array([[4, 0, 0], [4, 1, 0], [1, 1, 0], [1, 4, 0], [0, 4, 0], [0, 0, 0]], dtype=float)


def rotation(seed: int) -> np.ndarray:
    """Return a random rotation, its determinant +1."""
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def shoelace_m2(flat: np.ndarray) -> float:
    x, y = flat.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def covered_m2(corners: np.ndarray, triangles: np.ndarray) -> float:
    """Return the sum of the triangles' areas, each counted positive."""
    a, b, c = (corners[triangles[:, k]] for k in range(3))
    return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


@pytest.mark.parametrize("start", range(6))
def test_an_l_shaped_floor_has_seven_square_metres_and_not_sixteen(start):
    """Whichever corner comes first: 4 x 1 and 1 x 3 by hand; a fan from a tip gives 16."""
    corners = np.roll(L_FLOOR, start, axis=0)

    cut = triangulate(corners)

    assert cut.area_m2 == pytest.approx(7.0, rel=1e-14)
    assert covered_m2(corners, cut.triangles) == pytest.approx(7.0, rel=1e-14)
    assert not cut.crosses_itself


@given(
    st.lists(st.floats(0.3, 5.0), min_size=3, max_size=30), st.integers(0, 10_000), st.booleans()
)
def test_triangles_of_a_random_star_cover_its_shoelace_area(radii, seed, backwards):
    """A star around its middle is simple; it is turned anywhere in space, in either direction."""
    angles = 2 * np.pi * np.arange(len(radii)) / len(radii)
    flat = np.array(radii)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    expected = shoelace_m2(flat)
    corners = np.column_stack([flat, np.zeros(len(flat))]) @ rotation(seed).T + [3.0, -2.0, 7.0]
    if backwards:
        corners = corners[::-1]

    cut = triangulate(corners)

    # corners of size 10 m rounded to 1e-15 each, areas of down to 0.1 m2
    assert covered_m2(corners, cut.triangles) == pytest.approx(expected, rel=1e-11)
    vectors = [area_vector_m2(corners[t]) for t in cut.triangles]
    np.testing.assert_allclose(np.sum(vectors, axis=0), area_vector_m2(corners), atol=1e-11)
    assert min(v @ area_vector_m2(corners) for v in vectors) >= 0.0


@given(st.lists(st.integers(1, 6), min_size=1, max_size=12), st.integers(0, 1000))
def test_a_skyline_with_corners_on_straight_lines_has_the_sum_of_its_towers(heights, seed):
    """Towers of width one: the area is the sum of heights; equal neighbours give flat corners."""
    flat = [(float(len(heights)), 0.0), (0.0, 0.0)]
    for i, height in enumerate(heights):
        flat += [(float(i), float(height)), (float(i + 1), float(height))]
    corners = np.column_stack([np.array(flat), np.zeros(len(flat))]) @ rotation(seed).T

    cut = triangulate(corners)

    assert covered_m2(corners, cut.triangles) == pytest.approx(sum(heights), rel=1e-11)
    assert not cut.crosses_itself


def test_a_bow_tie_is_said_to_cross_itself():
    """Its two wings have opposite areas of 1 and 4 m2, which no simple outline can have."""
    bow = np.array([[0, 0, 0], [2, 2, 0], [2, 0, 0], [-1, 1.5, 0]], dtype=float)

    assert triangulate(bow).crosses_itself


def test_a_lifted_corner_is_reported_by_its_distance_from_the_plane():
    """A unit square with one corner lifted by h is h/4 off its best plane at every corner."""
    h = 0.02
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, h], [0, 1, 0]])

    # to first order in h: the plane tilts by h/2 along either axis
    assert triangulate(square).off_plane_m == pytest.approx(h / 4, rel=1e-3)


@pytest.mark.parametrize("corners", [np.ones((3, 3)), np.ones((5, 3)), np.eye(3)[[0, 1, 0]]])
def test_a_polygon_of_one_place_or_one_line_has_no_triangles(corners):
    """Nor a plane, by which anything would have to be divided."""
    found = triangulate(corners)
    assert found.triangles.shape == (0, 3) and found.off_plane_m == 0.0
    assert found.area_m2 == pytest.approx(0.0, abs=1e-15)
