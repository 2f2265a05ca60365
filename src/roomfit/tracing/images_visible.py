"""Which images of a source a receiver sees: every leg of the path is followed back."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from roomfit.compiled import kernel
from roomfit.geometry.kernels import Vector, along, corner, cross, dot, minus, row
from roomfit.tracing.images_tree import Tree
from roomfit.tracing.images_walls import Screens, Walls
from roomfit.typing import BoolArray, FloatArray, IntArray


class Legs(NamedTuple):
    """The followed paths of all images of a tree.

    Attributes
    ----------
    visible : bool array, shape (n_images,)
        What follows means nothing where an image is not visible.
    triangle : int64 array, shape (n_images, highest order)
        Triangle of each hit, first hit first.
    cosine : float array, shape (n_images, highest order)
        Cosine of incidence of each hit.
    departure : float array, shape (n_images, 3)
        Unit vector from the source to the first hit or to the receiver.
    """

    visible: BoolArray
    triangle: IntArray
    cosine: FloatArray
    departure: FloatArray


@kernel(parallel=True)
def follow_back(
    walls: Walls, screens: Screens, tree: Tree, receiver_m: FloatArray, max_length_m: float
) -> Legs:
    """Follow the path from the receiver to every image of the tree back to the source.

    A path is kept where each reflection point lies in a triangle of its wall and no triangle
    stands between two points. An edge belongs to both its walls, and what touches an edge or
    ends in a wall does not stand in the way of what lies within the tolerance.
    """
    n = len(tree.wall)
    depth = tree.order[n - 1]
    visible = np.zeros(n, dtype=np.bool_)
    triangle = np.full((n, depth), -1, dtype=np.int64)
    cosine = np.zeros((n, depth))
    departure = np.zeros((n, 3))
    numbers = np.arange(n)
    for k in numba.prange(n):
        i = numbers[k]  # k is unsigned, and would turn a parent's number into a float
        points = np.empty((depth + 2, 3))
        away = tree.position_m[i] - receiver_m
        if np.dot(away, away) <= max_length_m**2 and _reflection_points(
            walls, tree, i, receiver_m, points, triangle[i], cosine[i]
        ):
            visible[i] = _clear(screens, points, tree.order[i] + 2, walls.tolerance_m)
            first = minus(row(points, 1), row(points, 0))
            length = math.sqrt(dot(first, first))
            for axis in range(3):
                departure[i, axis] = first[axis] / length
    return Legs(visible, triangle, cosine, departure)


@kernel()
def _reflection_points(
    walls: Walls,
    tree: Tree,
    i: int,
    receiver_m: FloatArray,
    points: FloatArray,
    triangle: IntArray,
    cosine: FloatArray,
) -> bool:
    """Write source, hits and receiver to points[:order + 2]; return False where a wall ends."""
    at = i
    place = tree.order[at]
    points[place + 1] = receiver_m
    target = (receiver_m[0], receiver_m[1], receiver_m[2])
    while tree.parent[at] >= 0:
        w = tree.wall[at]
        normal = row(walls.normal, w)
        image = row(tree.position_m, at)
        before = walls.offset_m[w] - dot(normal, target)
        behind = dot(normal, image) - walls.offset_m[w]
        # a target within the tolerance of the next wall stands in the edge between two
        if before < -walls.tolerance_m:
            return False
        step = minus(image, target)
        target = along(target, step, max(before, 0.0) / (max(before, 0.0) + behind))
        triangle[place - 1] = _triangle_at(walls, w, target)
        if triangle[place - 1] < 0:
            return False
        cosine[place - 1] = abs(dot(normal, step)) / math.sqrt(dot(step, step))
        points[place, 0], points[place, 1], points[place, 2] = target
        place -= 1
        at = tree.parent[at]
    points[0] = tree.position_m[0]
    return True


@kernel()
def _triangle_at(walls: Walls, w: int, x: Vector) -> int:
    """Return the triangle of a wall in which a point of its plane lies deepest, or -1."""
    normal = row(walls.normal, w)
    deepest, found = -walls.tolerance_m, -1
    for i in range(walls.first_piece[w], walls.first_piece[w + 1]):
        depth = np.inf
        for k in range(3):
            a, b = corner(walls.piece_m, i, k), corner(walls.piece_m, i, (k + 1) % 3)
            side = minus(b, a)
            area = dot(cross(side, minus(x, a)), normal)
            depth = min(depth, area / math.sqrt(dot(side, side)))
        if depth > deepest:
            deepest, found = depth, walls.piece_triangle[i]
    return found


@kernel()
def _clear(screens: Screens, points: FloatArray, n: int, tolerance_m: float) -> bool:
    """Return whether no triangle stands between neighbours of the first n points."""
    for leg in range(n - 1):
        p, q = row(points, leg), row(points, leg + 1)
        for i in range(len(screens.offset_m)):
            if _stands_between(screens, i, p, q, tolerance_m):
                return False
    return True


@kernel()
def _stands_between(screens: Screens, i: int, p: Vector, q: Vector, tolerance_m: float) -> bool:
    normal = row(screens.normal, i)
    hp = dot(normal, p) - screens.offset_m[i]
    hq = dot(normal, q) - screens.offset_m[i]
    if not (hp > tolerance_m and hq < -tolerance_m) and not (
        hp < -tolerance_m and hq > tolerance_m
    ):
        return False
    x = along(p, minus(q, p), hp / (hp - hq))
    positive = negative = False
    for k in range(3):
        a, b = corner(screens.corners_m, i, k), corner(screens.corners_m, i, (k + 1) % 3)
        area = dot(cross(minus(b, a), minus(x, a)), normal)
        positive |= area > 0.0
        negative |= area < 0.0
    return not (positive and negative)
