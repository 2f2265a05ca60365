"""What of a wall a beam meets where other walls stand before it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roomfit.compiled import kernel
from roomfit.geometry.kernels import Vector, dot, row
from roomfit.tracing.beam_clip import (
    CORNERS,
    ROWS,
    clip,
    cone,
    copy_corners,
    outside_of,
    shortest_m,
    without_repeats,
)
from roomfit.tracing.images_walls import Blockers, Walls
from roomfit.typing import FloatArray, IntArray

# Pieces that one wall may fall into; one that would fall into more stays whole, which is right.
FRAGMENTS = 16
# Shadows of so many largest blockers are taken off; smaller ones are left to the test of paths.
_CASTING = 64
IN_THE_WAY = -1


class Shadows(NamedTuple):
    """The shadows that the blockers cast in the beam at hand, and room to work in.

    Attributes
    ----------
    planes : float array, shape (n_blockers, ROWS + 1, 4)
        Normals inwards, the blocker's own plane last.
    n_planes : int64 array, shape (n_blockers,)
        Planes of each; 0 where it stands outside the beam, `IN_THE_WAY` where it stands in it and
        its shadow is too thin to be told.
    pieces, next_pieces : float arrays, shape (FRAGMENTS + ROWS + 1, ROWS, 3)
    corners, next_corners : int64 arrays, shape (FRAGMENTS + ROWS + 1,)
    scratch : float array, shape (3, ROWS, 3)
    """

    planes: FloatArray
    n_planes: IntArray
    pieces: FloatArray
    next_pieces: FloatArray
    corners: IntArray
    next_corners: IntArray
    scratch: FloatArray


@kernel()
def no_shadows(blockers: Blockers) -> Shadows:
    """Return room for the shadows of some blockers."""
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
    """Work out the shadow of every blocker in a beam (from `wall`, bounded by `planes`)."""
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
