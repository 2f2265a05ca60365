"""The tree of beams of one source: all images that any of its receivers sees, within a distance.

A beam is the cone from an image of the source through the part of its wall that sound can reach.
Each wall within a beam mirrors it into the next; walls that stand before others take their shadow
off. Beams are followed one after the other, deepest first, so that only a handful is kept. They
are a margin too wide and prune only: `beam_path` decides on each path.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roomfit.compiled import kernel
from roomfit.geometry.kernels import Vector, dot, minus, row
from roomfit.tracing.beam_clip import (
    ROWS,
    clip,
    copy_corners,
    distance_m,
    height,
    put,
    sides,
    without_repeats,
)
from roomfit.tracing.beam_found import (
    DONE,
    TOO_MUCH_MEMORY,
    TOO_MUCH_WORK,
    Found,
    Limits,
    cut_to,
    nothing,
    with_room,
)
from roomfit.tracing.beam_narrow import is_sliver, only_wall
from roomfit.tracing.beam_path import is_visible
from roomfit.tracing.beam_shadow import Shadows, cast, lit_pieces, no_shadows
from roomfit.tracing.images_walls import Blockers, Walls
from roomfit.typing import FloatArray, IntArray


class _Chain(NamedTuple):
    """The beam at hand and those it came from, by order; entry 0 is the source."""

    position_m: FloatArray  # (order + 1, 3)
    matrix: FloatArray  # (order + 1, 9)
    wall: IntArray  # (order + 1,)
    points_m: FloatArray  # (order + 2, 3)
    triangle: IntArray  # (order + 1,)
    cosine: FloatArray  # (order + 1,)
    opening_m: FloatArray  # (ROWS, 3), of the beam at hand
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
    """Return the images of a source that each receiver sees.

    Parameters
    ----------
    walls, blockers : Walls, Blockers
    source_m : float array, shape (3,)
    receivers_m : float array, shape (n_receivers, 3)
    to_receiver_m : float array, shape (n_walls,)
        No more than the distance from a point of the wall to the nearest receiver.
    limits : Limits
    """
    chain = _chain_of(source_m, limits.order)
    shadows = no_shadows(blockers)
    waiting = _Waiting(np.empty((64, ROWS, 3)), np.empty((64, 3), dtype=np.int64))
    found = nothing()
    n_images, n_hits, work, top = 0, 0, 0, 0
    order, n_planes, n_corners = 0, 0, 0
    while True:
        for r in range(len(receivers_m)):
            if not _hears(walls, blockers, chain, order, n_planes, receivers_m[r], limits):
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
        np.zeros(n),
        np.zeros((ROWS, 3)),
        np.zeros((ROWS + 1, 4)),
        np.zeros((ROWS, 3)),
    )
    chain.position_m[0] = source_m
    chain.matrix[0, 0] = chain.matrix[0, 4] = chain.matrix[0, 8] = 1.0
    return chain


@kernel(allocates=False)
def _enter(walls: Walls, chain: _Chain, waiting: _Waiting, i: int) -> int:
    """Make waiting beam i the one at hand; return how many planes bound it."""
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
def _hears(
    walls: Walls,
    blockers: Blockers,
    chain: _Chain,
    order: int,
    n_planes: int,
    receiver_m: FloatArray,
    limits: Limits,
) -> bool:
    """Return whether a receiver sees the image at hand."""
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
        chain.cosine,
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
    """Append what the beam at hand makes of every wall within it."""
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
    # a hundred margins wide: of true beams so narrow, none is likely to hold a receiver
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
        found.cosine[first_hit + k] = chain.cosine[k]
