"""The tree of beams of one source: its images visible from any receiver, within a distance.

A beam is the cone from an image of the source through the part of its wall that sound can reach.
Each wall within a beam mirrors it into the next, less the shadows of walls in front of it. Beams
are followed one after the other, deepest first, so that only a handful is kept. They are a margin
too wide and prune only: `is_visible` decides on each path, from the receiver back through its
images.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roomfit.base.kernels import kernel
from roomfit.base.typing import FloatArray, IntArray
from roomfit.room.inside import Vector, along, cross, deepest, dot, minus, put, row
from roomfit.tracing.beam_clipping import (
    ROWS,
    Shadows,
    cast,
    clip,
    copy_corners,
    distance_m,
    height,
    lit_pieces,
    no_shadows,
    sides,
    without_repeats,
)
from roomfit.tracing.reflectors import Blockers, Walls

DONE, TOO_MUCH_WORK, TOO_MUCH_MEMORY = 0, 1, 2


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
    ending: int  # DONE, TOO_MUCH_WORK or TOO_MUCH_MEMORY
    work: int  # walls tested against beams


@kernel()
def nothing() -> Found:
    """Return no images, with memory for some."""
    return _room_for(256, 4096)


@kernel()
def _room_for(n_images: int, n_hits: int) -> Found:
    return Found(
        np.empty(n_images, dtype=np.int32),
        np.empty(n_images, dtype=np.int32),
        np.empty((n_images, 3)),
        np.empty((n_images, 9)),
        np.empty(n_hits, dtype=np.int32),
        DONE,
        0,
    )


@kernel()
def with_room(found: Found, n_images: int, n_hits: int) -> Found:
    """Return the same images with memory for so many images and hits."""
    have_images, have_hits = len(found.receiver), len(found.triangle)
    if n_images <= have_images and n_hits <= have_hits:
        return found
    wider = _room_for(max(have_images, 2 * n_images), max(have_hits, 2 * n_hits))
    wider.receiver[:have_images] = found.receiver
    wider.order[:have_images] = found.order
    wider.position_m[:have_images] = found.position_m
    wider.matrix[:have_images] = found.matrix
    wider.triangle[:have_hits] = found.triangle
    return wider


@kernel()
def cut_to(found: Found, n_images: int, n_hits: int, ending: int, work: int) -> Found:
    """Return the images and hits found so far, without spare memory."""
    return Found(
        found.receiver[:n_images].copy(),
        found.order[:n_images].copy(),
        found.position_m[:n_images].copy(),
        found.matrix[:n_images].copy(),
        found.triangle[:n_hits].copy(),
        ending,
        work,
    )


@kernel(allocates=False)
def only_wall(
    walls: Walls,
    blockers: Blockers,
    apex: Vector,
    wall: int,
    opening: FloatArray,
    n: int,
    shadows: Shadows,
    image: FloatArray,
) -> int:
    """Return the wall that the whole beam falls on, or -1 where it may be several.

    Most beams of a high order are narrow and fall on one wall only: nothing need be cut.

    Shapes: `image` (ROWS, 3).
    """
    middle = (0.0, 0.0, 0.0)
    for c in range(n):
        middle = along(middle, row(opening, c), 1.0 / n)
    w = _first_hit(walls, apex, minus(middle, apex), wall)
    if w < 0 or not walls.ends_sound[w]:
        return -1
    normal = row(walls.normal, w)
    ahead = walls.offset_m[w] - dot(normal, apex)
    for c in range(n):
        ray = minus(row(opening, c), apex)
        speed = dot(normal, ray)
        # at least as far as the opening, and not along the wall
        if not ahead >= speed > 0.0:
            return -1
        x = along(apex, ray, ahead / speed)
        if not _is_over(walls, w, x):
            return -1
        # looked at from outside, the corners of an opening run the other way round ahead of it
        put(image, n - 1 - c, x)
    for b in range(len(shadows.n_planes)):
        if shadows.n_planes[b] != 0 and blockers.wall[b] != w and _rises(walls, blockers, b, w):
            return -1
    if len(blockers.wall) > len(shadows.n_planes):
        return -1
    return w


@kernel(allocates=False)
def _first_hit(walls: Walls, apex: Vector, ray: Vector, wall: int) -> int:
    """Return the wall whose outline a ray meets first once it has left a wall, or -1."""
    first, found = math.inf, -1
    for w in range(len(walls.offset_m)):
        normal = row(walls.normal, w)
        speed = dot(normal, ray)
        ahead = walls.offset_m[w] - dot(normal, apex)
        # written so that one division is made only for what may be the first
        if not (speed > 0.0 and ahead > speed and ahead < first * speed):
            continue
        # the back of the sheet that the beam comes from
        if ahead - speed <= walls.tolerance_m and dot(normal, row(walls.normal, wall)) < -0.5:
            continue
        x = along(apex, ray, ahead / speed)
        if _is_over(walls, w, x):
            first, found = ahead / speed, w
    return found


@kernel(allocates=False)
def _is_over(walls: Walls, w: int, x: Vector) -> bool:
    """Return whether a point of the plane of a wall lies within its outline."""
    for e in range(walls.first_corner[w], walls.first_corner[w + 1]):
        if height(walls.edge, e, x) < 0.0:
            return False
    return True


@kernel(allocates=False)
def is_sliver(polygon: FloatArray, n: int, width_m: float) -> bool:
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
def _rises(walls: Walls, blockers: Blockers, b: int, w: int) -> bool:
    """Return whether some corner of a blocker stands in front of a wall."""
    normal = row(walls.normal, w)
    for c in range(blockers.first_corner[b], blockers.first_corner[b + 1]):
        x = row(blockers.corner_m, c)
        if dot(normal, x) < walls.offset_m[w] - walls.margin_m:
            return True
    return False


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
) -> bool:
    """Return whether sound travels from the source by all walls of a chain to the receiver.

    Each reflection point must lie in a triangle of its wall, and no wall may obstruct the path
    between two points. An edge belongs to both its walls, and a wall does not obstruct a path
    within `Walls.edge_m` of its edge or of its plane at either end.

    Shapes: `chain_m` (at least order + 1, 3), `chain_wall` (at least order + 1,), `receiver_m`
    (3,), `points` (at least order + 2, 3), `triangle` (at least order,).
    """
    if not _strikes(walls, chain_m, chain_wall, order, receiver_m, points, triangle):
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
        start, stop = walls.first_piece[w], walls.first_piece[w + 1]
        piece = deepest(walls.piece_m, start, stop, normal, target, -walls.edge_m)
        if piece < 0:
            return False
        triangle[place - 1] = walls.piece_triangle[piece]
        put(points, place, target)
    put(points, 0, row(chain_m, 0))
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


@kernel()
def beam_tree(
    walls: Walls,
    blockers: Blockers,
    source_m: FloatArray,
    receivers_m: FloatArray,
    to_receiver_m: FloatArray,
    limits: Limits,
) -> Found:
    """Return the images of a source visible from each receiver.

    Shapes: `source_m` (3,), `receivers_m` (n_receivers, 3), `to_receiver_m` (n_walls,).
    """
    chain = _chain_of(source_m, limits.order)
    shadows = no_shadows(blockers)
    waiting = _Waiting(np.empty((64, ROWS, 3)), np.empty((64, 3), dtype=np.int64))
    found = nothing()
    n_images, n_hits, work, top = 0, 0, 0, 0
    order, n_planes, n_corners = 0, 0, 0
    while True:
        for r in range(len(receivers_m)):
            if not _reaches_receiver(
                walls, blockers, chain, order, n_planes, receivers_m[r], limits
            ):
                continue
            found = with_room(found, n_images + 1, n_hits + order)
            _note(found, chain, r, order, n_images, n_hits)
            n_images += 1
            n_hits += order
            if n_images + n_hits > limits.n_hits:
                return cut_to(found, n_images, n_hits, TOO_MUCH_MEMORY, work)
        if order < limits.order:
            waiting, top = _next_beams(
                walls,
                blockers,
                chain,
                order,
                n_planes,
                n_corners,
                to_receiver_m,
                limits,
                shadows,
                waiting,
                top,
            )
            work += len(walls.offset_m)
            if work > limits.work:
                return cut_to(found, n_images, n_hits, TOO_MUCH_WORK, work)
        if top == 0:
            return cut_to(found, n_images, n_hits, DONE, work)
        top -= 1
        order, n_corners = waiting.what[top, 0], waiting.what[top, 2]
        n_planes = _enter(walls, chain, waiting, top)


@kernel()
def _chain_of(source_m: FloatArray, order: int) -> _Chain:
    n = order + 2
    chain = _Chain(
        np.zeros((n, 3)),
        np.zeros((n, 9)),
        np.full(n, -1),
        np.zeros((n, 3)),
        np.zeros(n, dtype=np.int64),
        np.zeros((ROWS, 3)),
        np.zeros((ROWS + 1, 4)),
        np.zeros((ROWS, 3)),
    )
    chain.position_m[0] = source_m
    chain.matrix[0, 0] = chain.matrix[0, 4] = chain.matrix[0, 8] = 1.0
    return chain


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
        along = 0.0
        for k in range(3):
            along += normal[k] * chain.matrix[order - 1, 3 * k + column]
        for k in range(3):
            entry = chain.matrix[order - 1, 3 * k + column] - 2.0 * normal[k] * along
            chain.matrix[order, 3 * k + column] = entry
    chain.wall[order] = w
    copy_corners(waiting.opening_m[i], 0, n, chain.opening_m)
    return sides(
        row(chain.position_m, order),
        chain.opening_m,
        n,
        normal,
        walls.offset_m[w],
        chain.planes,
        walls.margin_m,
    )


@kernel(allocates=False)
def _reaches_receiver(
    walls: Walls,
    blockers: Blockers,
    chain: _Chain,
    order: int,
    n_planes: int,
    receiver_m: FloatArray,
    limits: Limits,
) -> bool:
    """Return whether the current image is visible from a receiver."""
    x = (receiver_m[0], receiver_m[1], receiver_m[2])
    away = minus(x, row(chain.position_m, order))
    if dot(away, away) > limits.length_m**2:
        return False
    for p in range(n_planes):
        if height(chain.planes, p, x) < -walls.margin_m:
            return False
    return is_visible(
        walls,
        blockers,
        chain.position_m,
        chain.wall,
        order,
        receiver_m,
        chain.points_m,
        chain.triangle,
    )


@kernel()
def _next_beams(
    walls: Walls,
    blockers: Blockers,
    chain: _Chain,
    order: int,
    n_planes: int,
    n_corners: int,
    to_receiver_m: FloatArray,
    limits: Limits,
    shadows: Shadows,
    waiting: _Waiting,
    top: int,
) -> tuple[_Waiting, int]:
    """Append the beams that the current one makes at every wall within it."""
    apex = row(chain.position_m, order)
    if len(blockers.wall) > 0:
        cast(walls, blockers, apex, chain.wall[order], chain.planes, n_planes, shadows)
    if top + 1 > len(waiting.what):
        waiting = _with_more_room(waiting)
    if order > 0:
        w = only_wall(
            walls,
            blockers,
            apex,
            chain.wall[order],
            chain.opening_m,
            n_corners,
            shadows,
            waiting.opening_m[top],
        )
        if w >= 0:
            return waiting, top + _await(
                walls, w, apex, order + 1, n_corners, to_receiver_m, limits, waiting, top
            )
    # the last one noted is the first one followed: images come in the order of the walls
    for w in range(len(walls.offset_m) - 1, -1, -1):
        ahead = walls.offset_m[w] - dot(row(walls.normal, w), apex)
        if not walls.margin_m < ahead <= limits.length_m - to_receiver_m[w]:
            continue
        n = _lit(walls, w, chain, n_planes, shadows.pieces[0])
        if n == 0:
            continue
        n_pieces = 1
        shadows.corners[0] = n
        if len(blockers.wall) > 0:
            n_pieces = lit_pieces(walls, blockers, w, shadows)
        if top + n_pieces > len(waiting.what):
            waiting = _with_more_room(waiting)
        for i in range(n_pieces):
            n = shadows.corners[i]
            copy_corners(shadows.pieces[i], 0, n, waiting.opening_m[top])
            top += _await(walls, w, apex, order + 1, n, to_receiver_m, limits, waiting, top)
    return waiting, top


@kernel(allocates=False)
def _await(
    walls: Walls,
    w: int,
    apex: Vector,
    order: int,
    n: int,
    to_receiver_m: FloatArray,
    limits: Limits,
    waiting: _Waiting,
    top: int,
) -> int:
    """Note what belongs to the opening at the top; return 1, or 0 if it is too far or too thin."""
    # a hundred margins wide: of true beams so narrow, none is likely to contain a receiver
    if is_sliver(waiting.opening_m[top], n, walls.tolerance_m):
        return 0
    normal = row(walls.normal, w)
    ahead = walls.offset_m[w] - dot(normal, apex)
    reach = distance_m(apex, waiting.opening_m[top], n, normal, ahead)
    if reach > limits.length_m - to_receiver_m[w]:
        return 0
    waiting.what[top, 0] = order
    waiting.what[top, 1] = w
    waiting.what[top, 2] = n
    return 1


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
    copy_corners(walls.outline_m, start, n, polygon)
    n = clip(polygon, n, chain.planes, 0, n_planes, -walls.margin_m, chain.scratch)
    return without_repeats(polygon, n, walls.margin_m)


@kernel()
def _with_more_room(waiting: _Waiting) -> _Waiting:
    n = len(waiting.what)
    wider = _Waiting(np.empty((2 * n, ROWS, 3)), np.empty((2 * n, 3), dtype=np.int64))
    wider.opening_m[:n] = waiting.opening_m
    wider.what[:n] = waiting.what
    return wider


@kernel(allocates=False)
def _note(found: Found, chain: _Chain, r: int, order: int, i: int, first_hit: int) -> None:
    found.receiver[i] = r
    found.order[i] = order
    put(found.position_m, i, row(chain.position_m, order))
    for k in range(9):
        found.matrix[i, k] = chain.matrix[order, k]
    for k in range(order):
        found.triangle[first_hit + k] = chain.triangle[k]
