"""Beams clipped by polygons: their sides, the part of a wall in them, and the shadows upon it.

A beam is the cone from an image source through a convex polygon, its opening, beyond the plane in
which that lies. Every cut leaves a margin too much, so that a beam is never too narrow.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roomfit.base.kernels import kernel
from roomfit.base.typing import FloatArray, IntArray
from roomfit.room.inside import Vector, cross, dot, minus, put, row
from roomfit.tracing.reflectors import Blockers, Walls

# Corners that a polygon keeps. One that would get more stays as wide as it is, which is still
# right, for a beam too wide makes more to do and nothing wrong.
CORNERS = 16
# Room for a polygon of fewer than CORNERS after one more cut, however bad its shape.
ROWS = 24
# An edge that is a smaller share of its polygon gives no side, for its direction is too uncertain:
# two corners that clipping has put in one place would make a side that cuts anywhere.
_SHORTEST = 1e-6
# In margins: corners so close are one, and a cone so flat has no side.
_ONE_PLACE = 1e-2
_FLAT = 1e-3


@kernel(allocates=False, inlined=True)
def height(planes: FloatArray, p: int, x: Vector) -> float:
    """Return how far inside plane p (normal inwards, offset) a point lies."""
    return float(planes[p, 0] * x[0] + planes[p, 1] * x[1] + planes[p, 2] * x[2] - planes[p, 3])


@kernel(allocates=False)
def copy_corners(source: FloatArray, start: int, n: int, target: FloatArray) -> None:
    """Copy rows of an (n, 3) array to the top of another, which slices do more slowly."""
    for c in range(n):
        for k in range(3):
            target[c, k] = source[start + c, k]


@kernel(allocates=False)
def sides(
    apex: Vector,
    opening: FloatArray,
    n: int,
    wall_normal: Vector,
    wall_offset_m: float,
    planes: FloatArray,
    margin_m: float,
) -> int:
    """Write the planes that bound a beam, normals inwards, the one of its opening first.

    Shapes: `opening` (ROWS, 3), `planes` (ROWS + 1, 4).
    """
    planes[0, 0], planes[0, 1], planes[0, 2] = -wall_normal[0], -wall_normal[1], -wall_normal[2]
    planes[0, 3] = -wall_offset_m
    return 1 + cone(apex, opening, n, planes, 1, margin_m)


@kernel(allocates=False)
def cone(
    apex: Vector, opening: FloatArray, n: int, planes: FloatArray, start: int, margin_m: float
) -> int:
    """Write the planes through an apex and the edges of a polygon to planes[start:]; count them.

    Where an edge is too short, or so close to the apex that it gives no plane, the cone is left
    open.
    """
    middle = (0.0, 0.0, 0.0)
    for c in range(n):
        middle = (
            middle[0] + opening[c, 0] / n,
            middle[1] + opening[c, 1] / n,
            middle[2] + opening[c, 2] / n,
        )
    to_middle = minus(middle, apex)
    least_m = shortest_m(opening, n)
    count = 0
    for c in range(n):
        a, b = row(opening, c), row(opening, (c + 1) % n)
        edge, ray = minus(b, a), minus(a, apex)
        if dot(edge, edge) < least_m**2:
            continue
        side = cross(ray, edge)
        length = math.sqrt(dot(side, side))
        if length == 0.0:
            continue
        depth = dot(side, to_middle) / length
        if abs(depth) <= _FLAT * margin_m:
            continue
        scale = math.copysign(1.0 / length, depth)
        p = start + count
        planes[p, 0], planes[p, 1], planes[p, 2] = side[0] * scale, side[1] * scale, side[2] * scale
        planes[p, 3] = dot(side, apex) * scale
        count += 1
    return count


@kernel(allocates=False)
def clip(
    polygon: FloatArray,
    n: int,
    planes: FloatArray,
    first: int,
    stop: int,
    least_m: float,
    scratch: FloatArray,
) -> int:
    """Cut a convex polygon in its place to what lies within planes; return its corners [1]_.

    Shapes: `polygon, scratch` (ROWS, 3), `planes` (n_planes, 4).

    References
    ----------
    .. [1] I. E. Sutherland, G. W. Hodgman, "Reentrant polygon clipping", Communications of the
           ACM 17, 32-42 (1974).
    """
    for p in range(first, stop):
        outside = 0
        for c in range(n):
            if height(planes, p, row(polygon, c)) < least_m:
                outside += 1
        if outside == n:
            return 0
        if outside == 0 or n >= CORNERS:
            continue
        kept = _cut(polygon, n, planes, p, least_m, scratch)
        copy_corners(scratch, 0, kept, polygon)
        n = kept
        if n < 3:
            return 0
    return n


@kernel(allocates=False)
def _cut(
    polygon: FloatArray, n: int, planes: FloatArray, p: int, least_m: float, cut: FloatArray
) -> int:
    """Write the part of a polygon above a height over plane p; return its corners."""
    kept = 0
    a = row(polygon, n - 1)
    ha = height(planes, p, a) - least_m
    for c in range(n):
        b = row(polygon, c)
        hb = height(planes, p, b) - least_m
        # a corner at the very height is kept once and gives no crossing of its own
        if (ha > 0.0 and hb < 0.0) or (ha < 0.0 and hb > 0.0):
            share = ha / (ha - hb)
            cut[kept, 0] = a[0] + share * (b[0] - a[0])
            cut[kept, 1] = a[1] + share * (b[1] - a[1])
            cut[kept, 2] = a[2] + share * (b[2] - a[2])
            kept += 1
        if hb >= 0.0:
            put(cut, kept, b)
            kept += 1
        a, ha = b, hb
    return kept


@kernel(allocates=False)
def outside_of(
    polygon: FloatArray, n: int, planes: FloatArray, p: int, margin_m: float, part: FloatArray
) -> int:
    """Write the part of a polygon beyond plane p, a margin more; return its corners.

    0 where no corner is further beyond than two margins: such a sliver is the edge that shadow
    and polygon share.
    """
    farthest = 0.0
    for c in range(n):
        farthest = min(farthest, height(planes, p, row(polygon, c)))
    if farthest >= -2.0 * margin_m or n >= CORNERS:
        return 0
    for k in range(4):
        planes[p, k] = -planes[p, k]
    kept = _cut(polygon, n, planes, p, -margin_m, part)
    for k in range(4):
        planes[p, k] = -planes[p, k]
    return kept if kept > 2 else 0


@kernel(allocates=False)
def shortest_m(polygon: FloatArray, n: int) -> float:
    """Return the length of an edge below which it gives no side."""
    around = 0.0
    for c in range(n):
        edge = minus(row(polygon, (c + 1) % n), row(polygon, c))
        around += math.sqrt(dot(edge, edge))
    return _SHORTEST * around


@kernel(allocates=False)
def without_repeats(polygon: FloatArray, n: int, margin_m: float, least_m: float = 0.0) -> int:
    """Drop corners of a polygon that stand where the one before stands; return how many stay.

    0 where fewer than three do. `least_m` is a distance that counts as one place, if the margin's
    own is smaller.
    """
    least = max(_ONE_PLACE * margin_m, least_m) ** 2
    kept = 0
    for c in range(n):
        x = row(polygon, c)
        if kept > 0:
            step = minus(x, row(polygon, kept - 1))
            if dot(step, step) < least:
                continue
        put(polygon, kept, x)
        kept += 1
    if kept > 1:
        step = minus(row(polygon, 0), row(polygon, kept - 1))
        if dot(step, step) < least:
            kept -= 1
    return kept if kept > 2 else 0


@kernel(allocates=False)
def distance_m(apex: Vector, polygon: FloatArray, n: int, normal: Vector, ahead_m: float) -> float:
    """Return the distance from a point to a convex polygon `ahead_m` away along its normal."""
    foot = (
        apex[0] + ahead_m * normal[0],
        apex[1] + ahead_m * normal[1],
        apex[2] + ahead_m * normal[2],
    )
    square = math.inf
    inside = True
    for c in range(n):
        a, b = row(polygon, c), row(polygon, (c + 1) % n)
        edge, away = minus(b, a), minus(foot, a)
        if dot(cross(edge, away), normal) < 0.0:
            inside = False
            length = dot(edge, edge)
            share = min(max(dot(away, edge) / length, 0.0), 1.0) if length > 0.0 else 0.0
            gap = minus(away, (share * edge[0], share * edge[1], share * edge[2]))
            square = min(square, dot(gap, gap))
    if inside:
        return abs(ahead_m)
    return math.sqrt(square + ahead_m * ahead_m)


# Pieces that one wall may fall into; one that would fall into more stays whole, which is right.
FRAGMENTS = 16
# Shadows of so many largest blockers are taken off; smaller ones are left to the test of paths.
_CASTING = 64
IN_THE_WAY = -1


class Shadows(NamedTuple):
    """The shadows that the blockers cast in the current beam, and working memory."""

    planes: FloatArray  # (n_blockers, ROWS + 1, 4), normals inwards, the blocker's own plane last
    # int64 (n_blockers,), planes of each; 0 where it stands outside the beam, `IN_THE_WAY` where it
    # stands in it and its shadow is too thin to be resolved
    n_planes: IntArray
    pieces: FloatArray  # (FRAGMENTS + ROWS + 1, ROWS, 3)
    next_pieces: FloatArray  # (FRAGMENTS + ROWS + 1, ROWS, 3)
    corners: IntArray  # int64 (FRAGMENTS + ROWS + 1,)
    next_corners: IntArray  # int64 (FRAGMENTS + ROWS + 1,)
    scratch: FloatArray  # (3, ROWS, 3)


@kernel()
def no_shadows(blockers: Blockers) -> Shadows:
    """Return memory for the shadows of some blockers."""
    n, m = min(len(blockers.wall), _CASTING), FRAGMENTS + ROWS + 1
    return Shadows(
        np.empty((n, ROWS + 1, 4)),
        np.zeros(n, dtype=np.int64),
        np.empty((m, ROWS, 3)),
        np.empty((m, ROWS, 3)),
        np.zeros(m, dtype=np.int64),
        np.zeros(m, dtype=np.int64),
        np.empty((3, ROWS, 3)),
    )


@kernel(allocates=False)
def cast(
    walls: Walls,
    blockers: Blockers,
    apex: Vector,
    wall: int,
    planes: FloatArray,
    n_planes: int,
    shadows: Shadows,
) -> None:
    """Compute the shadow of every blocker in a beam (from `wall`, bounded by `planes`)."""
    margin_m = walls.margin_m
    polygon, scratch = shadows.scratch[0], shadows.scratch[1]
    for b in range(len(shadows.n_planes)):
        shadows.n_planes[b] = 0
        w = blockers.wall[b]
        normal = row(walls.normal, w)
        if w == wall or walls.offset_m[w] - dot(normal, apex) <= margin_m:
            continue
        start, stop = blockers.first_corner[b], blockers.first_corner[b + 1]
        n = stop - start
        if n >= ROWS:
            continue
        copy_corners(blockers.corner_m, start, n, polygon)
        # what stands behind the opening casts nothing
        n = clip(polygon, n, planes, 0, min(n_planes, 1), margin_m, scratch)
        n = clip(polygon, n, planes, 1, n_planes, -margin_m, scratch)
        if n == 0:
            continue
        shadows.n_planes[b] = IN_THE_WAY
        # a cone with a side missing would be too wide a shadow: one a little smaller has all
        n = without_repeats(polygon, n, margin_m, 2.0 * shortest_m(polygon, n))
        sides = shadows.planes[b]
        if n == 0 or cone(apex, polygon, n, sides, 0, margin_m) != n:
            continue
        sides[n, 0], sides[n, 1], sides[n, 2] = normal
        sides[n, 3] = walls.offset_m[w]
        shadows.n_planes[b] = n + 1


@kernel(allocates=False)
def lit_pieces(walls: Walls, blockers: Blockers, target: int, shadows: Shadows) -> int:
    """Cut piece 0 of `shadows`, of wall `target`, to what lies in no shadow; return the pieces."""
    n_pieces = 1
    for b in range(len(shadows.n_planes)):
        if shadows.n_planes[b] <= 0 or blockers.wall[b] == target:
            continue
        n_next = 0
        for i in range(n_pieces):
            n_next = _take_off(shadows, i, b, n_next, n_pieces - 1 - i, walls.margin_m)
        n_pieces = n_next
        for i in range(n_pieces):
            n = shadows.next_corners[i]
            copy_corners(shadows.next_pieces[i], 0, n, shadows.pieces[i])
            shadows.corners[i] = n
        if n_pieces == 0:
            return 0
    return n_pieces


@kernel(allocates=False)
def _take_off(shadows: Shadows, i: int, b: int, n_next: int, n_left: int, margin_m: float) -> int:
    """Append to the next pieces what shadow b leaves of piece i; return how many there are.

    Room is kept for the `n_left` pieces that are still to come, which stay whole at least.
    """
    planes, n_planes = shadows.planes[b], shadows.n_planes[b]
    rest, scratch = shadows.scratch[0], shadows.scratch[1]
    whole, n = shadows.pieces[i], shadows.corners[i]
    copy_corners(whole, 0, n, rest)
    meets = clip(rest, n, planes, 0, n_planes, 2.0 * margin_m, scratch) > 0
    if not meets or n_next + n_planes + n_left >= FRAGMENTS + ROWS:
        copy_corners(whole, 0, n, shadows.next_pieces[n_next])
        shadows.next_corners[n_next] = n
        return n_next + 1
    copy_corners(whole, 0, n, rest)
    n = shadows.corners[i]
    for p in range(n_planes):
        if n >= CORNERS:
            # too many corners to be cut again: lit as it is
            copy_corners(rest, 0, n, shadows.next_pieces[n_next])
            shadows.next_corners[n_next] = n
            return n_next + 1
        part = outside_of(rest, n, planes, p, margin_m, shadows.next_pieces[n_next])
        if part > 0:
            part = without_repeats(shadows.next_pieces[n_next], part, margin_m)
        if part > 0:
            shadows.next_corners[n_next] = part
            n_next += 1
        n = clip(rest, n, planes, p, p + 1, 0.0, scratch)
        if n == 0:
            break
    return n_next
