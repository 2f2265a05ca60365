"""One path from a receiver back through its images: where it strikes, and whether it is free."""

from __future__ import annotations

import math

from roomfit.compiled import kernel
from roomfit.geometry.kernels import Vector, along, corner, cross, dot, minus, row
from roomfit.tracing.beam_clip import put
from roomfit.tracing.images_walls import Blockers, Walls
from roomfit.typing import FloatArray, IntArray


@kernel(allocates=False)
def is_visible(
    walls: Walls,
    blockers: Blockers,
    chain_m: FloatArray,
    chain_wall: IntArray,
    order: int,
    receiver_m: FloatArray,
    points: FloatArray,
    triangle: IntArray,
    cosine: FloatArray,
) -> bool:
    """Return whether sound comes from the source by all walls of a chain to the receiver.

    Each reflection point must lie in a triangle of its wall, and no wall may stand between two
    points. An edge belongs to both its walls, and what touches an edge or ends in a wall does not
    stand in the way of what lies within `Walls.edge_m`.

    Parameters
    ----------
    chain_m : float array, shape (at least order + 1, 3)
        The source and its images one by one.
    chain_wall : int64 array, shape (at least order + 1,)
        The wall that made each; entry 0 means nothing.
    order : int
    receiver_m : float array, shape (3,)
    points : float array, shape (at least order + 2, 3)
        Receives source, reflection points and receiver.
    triangle, cosine : arrays, shape (at least order,)
        Receive triangle and cosine of incidence of each hit, first hit first.
    """
    if not _strikes(walls, chain_m, chain_wall, order, receiver_m, points, triangle, cosine):
        return False
    for leg in range(order + 1):
        p, q = row(points, leg), row(points, leg + 1)
        for b in range(len(blockers.wall)):
            if _stands_between(walls, blockers, b, p, q):
                return False
    return True


@kernel(allocates=False)
def _strikes(
    walls: Walls,
    chain_m: FloatArray,
    chain_wall: IntArray,
    order: int,
    receiver_m: FloatArray,
    points: FloatArray,
    triangle: IntArray,
    cosine: FloatArray,
) -> bool:
    target = (receiver_m[0], receiver_m[1], receiver_m[2])
    put(points, order + 1, target)
    for place in range(order, 0, -1):
        w = chain_wall[place]
        normal, image = row(walls.normal, w), row(chain_m, place)
        before = walls.offset_m[w] - dot(normal, target)
        behind = dot(normal, image) - walls.offset_m[w]
        # a target within reach of the next wall stands in the edge between two
        if before < -walls.edge_m:
            return False
        step = minus(image, target)
        target = along(target, step, max(before, 0.0) / (max(before, 0.0) + behind))
        triangle[place - 1] = _triangle_at(walls, w, target)
        if triangle[place - 1] < 0:
            return False
        cosine[place - 1] = abs(dot(normal, step)) / math.sqrt(dot(step, step))
        put(points, place, target)
    put(points, 0, row(chain_m, 0))
    return True


@kernel(allocates=False)
def _triangle_at(walls: Walls, w: int, x: Vector) -> int:
    """Return the triangle of a wall in which a point of its plane lies deepest, or -1."""
    normal = row(walls.normal, w)
    deepest, found = -walls.edge_m, -1
    for i in range(walls.first_piece[w], walls.first_piece[w + 1]):
        depth = math.inf
        for k in range(3):
            a, b = corner(walls.piece_m, i, k), corner(walls.piece_m, i, (k + 1) % 3)
            side = minus(b, a)
            area = dot(cross(side, minus(x, a)), normal)
            depth = min(depth, area / math.sqrt(dot(side, side)))
            if depth <= deepest:
                break
        if depth > deepest:
            deepest, found = depth, walls.piece_triangle[i]
    return found


@kernel(allocates=False)
def _stands_between(walls: Walls, blockers: Blockers, b: int, p: Vector, q: Vector) -> bool:
    w = blockers.wall[b]
    normal = row(walls.normal, w)
    hp = dot(normal, p) - walls.offset_m[w]
    hq = dot(normal, q) - walls.offset_m[w]
    edge_m = walls.edge_m
    if not (hp > edge_m and hq < -edge_m) and not (hp < -edge_m and hq > edge_m):
        return False
    x = along(p, minus(q, p), hp / (hp - hq))
    start, stop = blockers.first_corner[b], blockers.first_corner[b + 1]
    for c in range(start, stop):
        a = row(blockers.corner_m, c)
        to = row(blockers.corner_m, c + 1 if c + 1 < stop else start)
        if dot(cross(minus(to, a), minus(x, a)), normal) < 0.0:
            return False
    return True
