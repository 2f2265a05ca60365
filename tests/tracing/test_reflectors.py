"""Triangles of a plane become convex pieces, in whatever order their corners stand."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.tracing.reflectors import convex_outline, convex_pieces


def square(x: float, y: float) -> np.ndarray:
    """Return two triangles of a unit square, shape (2, 3, 3), counter-clockwise."""
    corners = np.array([[x, y, 0.0], [x + 1, y, 0.0], [x + 1, y + 1, 0.0], [x, y + 1, 0.0]])
    return corners[[[0, 1, 2], [0, 2, 3]]]


def area_m2(piece: np.ndarray) -> float:
    """Return the area of a polygon in the plane z = 0, by the formula of Gauss."""
    x, y = piece[:, 0], piece[:, 1]
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    ("squares", "number"),
    [
        ([(0, 0), (1, 0), (2, 0), (3, 0)], 1),
        ([(0, 0), (1, 0), (0, 1), (1, 1)], 1),
        ([(0, 0), (1, 0), (0, 1)], 2),  # an L is two rectangles
        ([(0, 0), (2, 0)], 2),  # with a gap between them
        ([(0, 0), (1, 1)], 2),  # with a corner in common
    ],
)
def test_pieces_cover_what_the_triangles_cover_and_are_as_few_as_can_be(seed, squares, number):
    """Triangles and their corners in a random order; each number can be counted on a sketch."""
    rng = np.random.default_rng(seed)
    triangles = np.concatenate([square(x - 20.0, y + 5.0) for x, y in squares])
    triangles = np.array([np.roll(t, rng.integers(3), axis=0) for t in rng.permutation(triangles)])
    pieces = convex_pieces(triangles, np.array([0.0, 0.0, 1.0]), 1e-6)
    assert len(pieces) == number
    assert sum(map(area_m2, pieces)) == pytest.approx(len(squares), rel=1e-9)


@pytest.mark.parametrize(("n", "is_hull"), [(12, True), (13, False)])
def test_an_outline_of_up_to_twelve_corners_is_the_hull_and_beyond_a_rectangle_about_it(n, is_hull):
    """A polygon of n sides on a tilted plane, its middle and doubles added."""
    turn = 2.0 * np.pi * np.arange(n) / n + 0.1
    u, v = np.array([0.6, 0.0, 0.8]), np.array([0.0, 1.0, 0.0])
    normal, middle = np.cross(u, v), np.array([1.0, 2.0, 3.0])
    ring = middle + np.outer(np.cos(turn), u) + np.outer(np.sin(turn), v)
    found = convex_outline(np.concatenate((ring, middle[None], ring[:3])), normal)
    assert len(found) == (n if is_hull else 4)
    np.testing.assert_allclose((found - middle) @ normal, 0.0, atol=1e-12)
    edges = np.roll(found, -1, axis=0) - found
    # counter-clockwise: all lies left of every edge
    left = np.cross(normal, edges)
    inside = np.einsum("ek,epk->ep", left, ring - found[:, None])
    assert inside.min() > -1e-12
    if is_hull:
        area = 0.5 * np.cross(found - middle, np.roll(found, -1, axis=0) - middle).sum(axis=0)
        assert area @ normal == pytest.approx(0.5 * n * np.sin(2.0 * np.pi / n))
