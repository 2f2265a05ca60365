"""The tree of beams of one source: its images visible from any receiver, within a distance.

A beam is the cone from an image of the source through the part of its wall that sound can reach,
its opening, beyond the plane in which that lies. Each wall within a beam mirrors it into the next,
less the shadows of walls in front of it. Beams are followed one after the other, deepest first, so
that only a handful is kept. They are a margin too wide and prune only: `_is_visible` decides on
each path, from the receiver back through its images.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from roomfit.base.kernels import kernel
from roomfit.base.typing import FloatArray, IntArray
from roomfit.room.inside import Vector, along, cross, deepest, dot, minus, put, row
from roomfit.tracing.reflectors import Blockers, Walls

# Corners that a polygon keeps. One that would get more stays as wide as it is, which is still
# right, for a beam too wide makes more to do and nothing wrong.
_CORNERS = 16
# Room for a polygon of fewer than _CORNERS after one more cut, however bad its shape.
ROWS = 24
# An edge that is a smaller share of its polygon gives no side, for its direction is too uncertain:
# two corners that clipping has put in one place would make a side that cuts anywhere.
_SHORTEST = 1e-6
# In margins: corners so close are one, and a cone so flat has no side.
_ONE_PLACE, _FLAT = 1e-2, 1e-3
# Pieces that one wall may fall into; one that would fall into more stays whole, which is right.
_FRAGMENTS = 16
# Shadows of so many largest blockers are taken off; smaller ones are left to the test of paths.
_CASTING = 64
_IN_THE_WAY = -1

DONE, TOO_MUCH_WORK, TOO_MUCH_MEMORY, _FULL = 0, 1, 2, 3


class Limits(NamedTuple):
    """Where the tree ends: by its paths, and by its cost."""

    order: int  # most hits of a path
    length_m: float
    work: int  # most walls tested against beams
    n_hits: int  # most hits and paths found, together


class Found(NamedTuple):
    """Visible images in the order in which they were found, one after the other."""

    receiver: IntArray  # int32 (n_images,)
    order: IntArray  # int32 (n_images,)
    position_m: FloatArray  # (n_images, 3)
    matrix: FloatArray  # (n_images, 9), product of the reflections, see `roomfit.tracing.paths`
    triangle: IntArray  # int32 (n_hits,), first hit first, path after path


class _Chain(NamedTuple):
    """The current beam and those it came from, by order; entry 0 is the source."""

    position_m: FloatArray  # (order + 1, 3)
    matrix: FloatArray  # (order + 1, 9)
    wall: IntArray  # (order + 1,)
    points_m: FloatArray  # (order + 2, 3)
    triangle: IntArray  # (order + 1,)
    opening_m: FloatArray  # (ROWS, 3), of the current beam
    planes: FloatArray  # (ROWS + 1, 4)
    scratch: FloatArray  # (ROWS, 3)


class _Waiting(NamedTuple):
    """Beams still to be followed, the last one first."""

    opening_m: FloatArray  # (n, ROWS, 3)
    what: IntArray  # (n, 3): order, wall, corners


class _Shadows(NamedTuple):
    """The shadows that the blockers cast in the current beam, and working memory."""

    planes: FloatArray  # (n_blockers, ROWS + 1, 4), normals inwards, the blocker's own plane last
    # int64 (n_blockers,), planes of each; 0 where it stands outside the beam, `_IN_THE_WAY` where
    # it stands in it and its shadow is too thin to be resolved
    n_planes: IntArray
    pieces: FloatArray  # (_FRAGMENTS + ROWS + 1, ROWS, 3), like the three after it
    next_pieces: FloatArray
    corners: IntArray
    next_corners: IntArray
    scratch: FloatArray  # (3, ROWS, 3)


def beam_tree(
    walls: Walls,
    blockers: Blockers,
    source_m: FloatArray,
    receivers_m: FloatArray,
    limits: Limits,
) -> tuple[Found, int, int]:
    """Return the images of a source visible from each receiver, how it ended, and its work.

    The latter is the number of walls tested against beams.

    Shapes: `source_m` (3,), `receivers_m` (n_receivers, 3).
    """
    heights = np.abs(walls.normal @ receivers_m.T - walls.offset_m[:, None])
    to_receiver_m = np.min(heights, axis=1, initial=np.inf)  # of each wall's plane, at least
    n, m, k = limits.order + 2, min(len(blockers.wall), _CASTING), _FRAGMENTS + ROWS + 1
    chain = _Chain(
        np.zeros((n, 3)),
        np.zeros((n, 9)),
        np.full(n, -1),
        np.zeros((n, 3)),
        np.zeros(n, np.int64),
        np.zeros((ROWS, 3)),
        np.zeros((ROWS + 1, 4)),
        np.zeros((ROWS, 3)),
    )
    chain.position_m[0], chain.matrix[0] = source_m, np.eye(3).ravel()
    shadows = _Shadows(
        np.empty((m, ROWS + 1, 4)),
        np.zeros(m, np.int64),
        np.empty((k, ROWS, 3)),
        np.empty((k, ROWS, 3)),
        np.zeros(k, np.int64),
        np.zeros(k, np.int64),
        np.empty((3, ROWS, 3)),
    )
    waiting = _Waiting(np.empty((64, ROWS, 3)), np.empty((64, 3), np.int64))
    found = Found(
        np.empty(256, np.int32),
        np.empty(256, np.int32),
        np.empty((256, 3)),
        np.empty((256, 9)),
        np.empty(4096, np.int32),
    )
    # images and hits found, work, beams waiting, order of the current one, its planes and corners
    at = np.zeros(7, np.int64)
    while True:
        ending = _follow(
            walls, blockers, receivers_m, to_receiver_m, limits, chain, shadows, waiting, found, at
        )
        if ending != _FULL:
            cut: list[Any] = [array[: at[0]].copy() for array in found[:-1]]
            cut.append(found.triangle[: at[1]].copy())
            return Found(*cut), ending, int(at[2])
        n_receivers, order = len(receivers_m), int(at[4])
        arrays: list[Any] = list(found)
        if at[0] + n_receivers > len(found.receiver):
            arrays[:-1] = [_longer(array, n_receivers) for array in arrays[:-1]]
        elif at[1] + n_receivers * order > len(found.triangle):
            arrays[-1] = _longer(found.triangle, n_receivers * order)
        else:
            waiting = _Waiting(*(_longer(array, 64) for array in waiting))
        found = Found(*arrays)


def _longer(array: Any, least: int) -> Any:
    """Return an array of twice the length, or so much more."""
    more = np.empty((max(len(array), least), *array.shape[1:]), array.dtype)
    return np.concatenate((array, more))


@kernel(allocates=False)
def _follow(
    walls: Walls,
    blockers: Blockers,
    receivers_m: FloatArray,
    to_receiver_m: FloatArray,
    limits: Limits,
    chain: _Chain,
    shadows: _Shadows,
    waiting: _Waiting,
    found: Found,
    at: IntArray,
) -> int:
    """Follow beams until none waits, a limit is reached, or memory is full; then call it again."""
    while True:
        n_images, n_hits, top, order, n_planes = at[0], at[1], at[3], at[4], at[5]
        n = len(receivers_m)
        if n_images + n > len(found.receiver) or n_hits + n * order > len(found.triangle):
            return _FULL
        if order < limits.order:
            top = _next_beams(
                walls,
                blockers,
                chain,
                order,
                n_planes,
                to_receiver_m,
                limits,
                shadows,
                waiting,
                top,
            )
            if top < 0:
                return _FULL
            at[2] += len(walls.offset_m)
        for r in range(n):
            x = row(receivers_m, r)
            if not _is_visible(walls, blockers, chain, order, n_planes, x, limits):
                continue
            found.receiver[n_images], found.order[n_images] = r, order
            put(found.position_m, n_images, row(chain.position_m, order))
            for k in range(9):
                found.matrix[n_images, k] = chain.matrix[order, k]
            for k in range(order):
                found.triangle[n_hits + k] = chain.triangle[k]
            n_images += 1
            n_hits += order
        at[0], at[1], at[3] = n_images, n_hits, top
        if n_images + n_hits > limits.n_hits:
            return TOO_MUCH_MEMORY
        if at[2] > limits.work:
            return TOO_MUCH_WORK
        if top == 0:
            return DONE
        at[3] = top - 1
        at[4] = waiting.what[top - 1, 0]
        at[5] = _enter(walls, chain, waiting, top - 1)


@kernel(allocates=False)
def _next_beams(
    walls: Walls,
    blockers: Blockers,
    chain: _Chain,
    order: int,
    n_planes: int,
    to_receiver_m: FloatArray,
    limits: Limits,
    shadows: _Shadows,
    waiting: _Waiting,
    top: int,
) -> int:
    """Append the beams that the current one makes at every wall within it; return their new top.

    -1 where the memory does not hold them.
    """
    apex = row(chain.position_m, order)
    if len(blockers.wall) > 0:
        _cast(walls, blockers, apex, chain.wall[order], chain.planes, n_planes, shadows)
    # the last one noted is the first one followed: images come in the order of the walls
    for w in range(len(walls.offset_m) - 1, -1, -1):
        normal = row(walls.normal, w)
        ahead = walls.offset_m[w] - dot(normal, apex)
        longest_m = limits.length_m - to_receiver_m[w]
        if not walls.margin_m < ahead <= longest_m:
            continue
        n = _lit(walls, w, chain, n_planes, shadows.pieces[0])
        if n == 0:
            continue
        n_pieces = 1
        shadows.corners[0] = n
        if len(blockers.wall) > 0:
            n_pieces = _lit_pieces(walls, blockers, w, shadows)
        if top + n_pieces > len(waiting.what):
            return -1
        for i in range(n_pieces):
            n = shadows.corners[i]
            opening = waiting.opening_m[top]
            _copy_corners(shadows.pieces[i], 0, n, opening)
            # a hundred margins wide: of true beams so narrow, none is likely to hold a receiver
            if _is_sliver(opening, n, walls.tolerance_m):
                continue
            if _distance_m(apex, opening, n, normal, ahead) <= longest_m:
                waiting.what[top, 0], waiting.what[top, 1] = order + 1, w
                waiting.what[top, 2] = n
                top += 1
    return top


@kernel(allocates=False)
def _lit(walls: Walls, w: int, chain: _Chain, n_planes: int, polygon: FloatArray) -> int:
    """Write the part of a wall's outline within the beam at hand; return its corners.

    What does not rise above the plane of the wall before lies in it, such as the back of the same
    sheet, which sound must not go through.
    """
    start, stop = walls.first_corner[w], walls.first_corner[w + 1]
    n = stop - start
    if n_planes > 0:
        highest = 0.0
        for c in range(start, stop):
            highest = max(highest, height(chain.planes, 0, row(walls.outline_m, c)))
        if highest <= walls.tolerance_m:
            return 0
    _copy_corners(walls.outline_m, start, n, polygon)
    n = clip(polygon, n, chain.planes, 0, n_planes, -walls.margin_m, chain.scratch)
    return without_repeats(polygon, n, walls.margin_m)


@kernel(allocates=False)
def _enter(walls: Walls, chain: _Chain, waiting: _Waiting, i: int) -> int:
    """Make waiting beam i the current one; return how many planes bound it."""
    order, w, n = waiting.what[i, 0], waiting.what[i, 1], waiting.what[i, 2]
    normal = row(walls.normal, w)
    before = row(chain.position_m, order - 1)
    twice = 2.0 * (walls.offset_m[w] - dot(normal, before))
    for k in range(3):
        chain.position_m[order, k] = before[k] + twice * normal[k]
    for column in range(3):
        # (I - 2 n n^T) times the matrix before, column by column
        product = 0.0
        for k in range(3):
            product += normal[k] * chain.matrix[order - 1, 3 * k + column]
        for k in range(3):
            entry = chain.matrix[order - 1, 3 * k + column] - 2.0 * normal[k] * product
            chain.matrix[order, 3 * k + column] = entry
    chain.wall[order] = w
    _copy_corners(waiting.opening_m[i], 0, n, chain.opening_m)
    # normals inwards, the plane of the opening first
    planes = chain.planes
    planes[0, 0], planes[0, 1], planes[0, 2] = -normal[0], -normal[1], -normal[2]
    planes[0, 3] = -walls.offset_m[w]
    return 1 + cone(row(chain.position_m, order), chain.opening_m, n, planes, 1, walls.margin_m)


@kernel(allocates=False)
def _is_visible(
    walls: Walls,
    blockers: Blockers,
    chain: _Chain,
    order: int,
    n_planes: int,
    receiver_m: Vector,
    limits: Limits,
) -> bool:
    """Return whether sound travels from the source by all walls of the chain to a receiver.

    Each reflection point must lie in a triangle of its wall, and no wall may obstruct the path
    between two points. An edge belongs to both its walls, and a wall does not obstruct a path
    within `Walls.edge_m` of its edge or of its plane at either end.
    """
    away = minus(receiver_m, row(chain.position_m, order))
    if dot(away, away) > limits.length_m**2:
        return False
    for p in range(n_planes):
        if height(chain.planes, p, receiver_m) < -walls.margin_m:
            return False
    target, points = receiver_m, chain.points_m
    put(points, order + 1, target)
    for place in range(order, 0, -1):
        w = chain.wall[place]
        normal, image = row(walls.normal, w), row(chain.position_m, place)
        before = walls.offset_m[w] - dot(normal, target)
        behind = dot(normal, image) - walls.offset_m[w]
        # a target within reach of the next wall stands in the edge between two
        if before < -walls.edge_m:
            return False
        step = minus(image, target)
        target = along(target, step, max(before, 0.0) / (max(before, 0.0) + behind))
        start, stop = walls.first_piece[w], walls.first_piece[w + 1]
        piece = deepest(walls.piece_m, start, stop, normal, target, -walls.edge_m)
        if piece < 0:
            return False
        chain.triangle[place - 1] = walls.piece_triangle[piece]
        put(points, place, target)
    put(points, 0, row(chain.position_m, 0))
    for leg in range(order + 1):
        begin, end = row(points, leg), row(points, leg + 1)
        for b in range(len(blockers.wall)):
            if _stands_between(walls, blockers, b, begin, end):
                return False
    return True


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


@kernel(allocates=False, inlined=True)
def height(planes: FloatArray, p: int, x: Vector) -> float:
    """Return how far inside plane p (normal inwards, offset) a point lies."""
    return float(planes[p, 0] * x[0] + planes[p, 1] * x[1] + planes[p, 2] * x[2] - planes[p, 3])


@kernel(allocates=False)
def _copy_corners(source: FloatArray, start: int, n: int, target: FloatArray) -> None:
    """Copy rows of an (n, 3) array to the top of another, which slices do more slowly."""
    for c in range(n):
        for k in range(3):
            target[c, k] = source[start + c, k]


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
    least_m = _shortest_m(opening, n)
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
        if outside == 0 or n >= _CORNERS:
            continue
        kept = _cut(polygon, n, planes, p, least_m, scratch)
        _copy_corners(scratch, 0, kept, polygon)
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
def _outside_of(
    polygon: FloatArray, n: int, planes: FloatArray, p: int, margin_m: float, part: FloatArray
) -> int:
    """Write the part of a polygon beyond plane p, a margin more; return its corners.

    0 where no corner is further beyond than two margins: such a sliver is the edge that shadow
    and polygon share.
    """
    farthest = 0.0
    for c in range(n):
        farthest = min(farthest, height(planes, p, row(polygon, c)))
    if farthest >= -2.0 * margin_m or n >= _CORNERS:
        return 0
    for k in range(4):
        planes[p, k] = -planes[p, k]
    kept = _cut(polygon, n, planes, p, -margin_m, part)
    for k in range(4):
        planes[p, k] = -planes[p, k]
    return kept if kept > 2 else 0


@kernel(allocates=False)
def _shortest_m(polygon: FloatArray, n: int) -> float:
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
def _is_sliver(polygon: FloatArray, n: int, width_m: float) -> bool:
    """Return whether a polygon is narrower than a width: twice its area over its perimeter.

    Where a beam meets the edge of a wall, its margin makes slivers that no sound reaches, and these
    would leak through every further wall, for shadows as thin as the margin are not resolved.
    """
    twice = (0.0, 0.0, 0.0)
    around = 0.0
    a = row(polygon, 0)
    for c in range(n):
        b = row(polygon, c)
        edge = minus(row(polygon, (c + 1) % n), b)
        twice = along(twice, cross(minus(b, a), edge), 1.0)
        around += math.sqrt(dot(edge, edge))
    return math.sqrt(dot(twice, twice)) < width_m * around


@kernel(allocates=False)
def _distance_m(apex: Vector, polygon: FloatArray, n: int, normal: Vector, ahead_m: float) -> float:
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


@kernel(allocates=False)
def _cast(
    walls: Walls,
    blockers: Blockers,
    apex: Vector,
    wall: int,
    planes: FloatArray,
    n_planes: int,
    shadows: _Shadows,
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
        _copy_corners(blockers.corner_m, start, n, polygon)
        # what stands behind the opening casts nothing
        n = clip(polygon, n, planes, 0, min(n_planes, 1), margin_m, scratch)
        n = clip(polygon, n, planes, 1, n_planes, -margin_m, scratch)
        if n == 0:
            continue
        shadows.n_planes[b] = _IN_THE_WAY
        # a cone with a side missing would be too wide a shadow: one a little smaller has all
        n = without_repeats(polygon, n, margin_m, 2.0 * _shortest_m(polygon, n))
        sides = shadows.planes[b]
        if n == 0 or cone(apex, polygon, n, sides, 0, margin_m) != n:
            continue
        sides[n, 0], sides[n, 1], sides[n, 2] = normal
        sides[n, 3] = walls.offset_m[w]
        shadows.n_planes[b] = n + 1


@kernel(allocates=False)
def _lit_pieces(walls: Walls, blockers: Blockers, target: int, shadows: _Shadows) -> int:
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
            _copy_corners(shadows.next_pieces[i], 0, n, shadows.pieces[i])
            shadows.corners[i] = n
        if n_pieces == 0:
            return 0
    return n_pieces


@kernel(allocates=False)
def _take_off(shadows: _Shadows, i: int, b: int, n_next: int, n_left: int, margin_m: float) -> int:
    """Append to the next pieces what shadow b leaves of piece i; return how many there are.

    Room is kept for the `n_left` pieces that are still to come, which stay whole at least.
    """
    planes, n_planes = shadows.planes[b], shadows.n_planes[b]
    rest, scratch = shadows.scratch[0], shadows.scratch[1]
    whole, n = shadows.pieces[i], shadows.corners[i]
    _copy_corners(whole, 0, n, rest)
    meets = clip(rest, n, planes, 0, n_planes, 2.0 * margin_m, scratch) > 0
    if not meets or n_next + n_planes + n_left >= _FRAGMENTS + ROWS:
        _copy_corners(whole, 0, n, shadows.next_pieces[n_next])
        shadows.next_corners[n_next] = n
        return n_next + 1
    _copy_corners(whole, 0, n, rest)
    n = shadows.corners[i]
    for p in range(n_planes):
        if n >= _CORNERS:
            # too many corners to be cut again: lit as it is
            _copy_corners(rest, 0, n, shadows.next_pieces[n_next])
            shadows.next_corners[n_next] = n
            return n_next + 1
        part = _outside_of(rest, n, planes, p, margin_m, shadows.next_pieces[n_next])
        if part > 0:
            part = without_repeats(shadows.next_pieces[n_next], part, margin_m)
        if part > 0:
            shadows.next_corners[n_next] = part
            n_next += 1
        n = clip(rest, n, planes, p, p + 1, 0.0, scratch)
        if n == 0:
            break
    return n_next
