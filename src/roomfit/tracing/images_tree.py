"""The tree of mirror images of one source, pruned to what some point of the room might see.

The beam of an image is the cone from it through the part of its wall that sound can reach. A wall
outside the beam makes no further image. Walls stand in by their convex outlines and screens are
left out, so that a beam is never too narrow: it prunes only, and `images_visible` decides.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from roomfit.compiled import kernel
from roomfit.errors import InputError
from roomfit.geometry.kernels import Vector, cross, dot, minus, row
from roomfit.tracing.images_walls import Walls
from roomfit.typing import BoolArray, FloatArray, IntArray

# Corners that a beam keeps. One that would get more stays as wide as it is, which is still right.
_CORNERS = 24
_BLOCK = 4_000_000
BYTES_PER_IMAGE = 24 + 3 * 8 + (_CORNERS * 3 + 1) * 8


class Tree(NamedTuple):
    """Images of one source; number 0 is the source itself.

    Attributes
    ----------
    position_m : float array, shape (n_images, 3)
    parent : int64 array, shape (n_images,)
        The image that was mirrored; -1 for the source.
    wall : int64 array, shape (n_images,)
        The wall that mirrored it; -1 for the source.
    order : int64 array, shape (n_images,)
    """

    position_m: FloatArray
    parent: IntArray
    wall: IntArray
    order: IntArray


class _Beams(NamedTuple):
    """The images of one order with the corners of their beams, (n, _CORNERS, 3)."""

    position_m: FloatArray
    wall: IntArray
    corners_m: FloatArray
    n_corners: IntArray


def image_tree(
    walls: Walls,
    source_m: FloatArray,
    order: int,
    max_length_m: float,
    *,
    memory_limit_bytes: float,
) -> Tree:
    """Return the images of a source up to an order, those in sight of no point left out.

    Parameters
    ----------
    walls : Walls
    source_m : float array, shape (3,)
    order : int
        0 or more.
    max_length_m : float
        No path is longer.
    memory_limit_bytes : float
        A tree that would need more is refused.

    Raises
    ------
    InputError
        The tree passes the memory limit.
    """
    beams = _Beams(
        np.array([source_m], dtype=np.float64),
        np.array([-1]),
        np.zeros((1, _CORNERS, 3)),
        np.array([0]),
    )
    levels = [Tree(beams.position_m, np.array([-1]), beams.wall, np.array([0]))]
    total = 1
    for level in range(1, order + 1):
        room_left = memory_limit_bytes / BYTES_PER_IMAGE - total
        parent, beams = _next_order(walls, beams, max_length_m, room_left, level)
        n = len(parent)
        if n == 0:
            break
        start = total - len(levels[-1].wall)
        levels.append(Tree(beams.position_m, parent + start, beams.wall, np.full(n, level)))
        total += n
    return Tree(*(np.concatenate(column) for column in zip(*levels, strict=True)))


def _next_order(
    walls: Walls, beams: _Beams, max_length_m: float, room_left: float, level: int
) -> tuple[IntArray, _Beams]:
    """Mirror every image in every wall within its beam; parents count from 0 within `beams`."""
    block = max(1, _BLOCK // len(walls.offset_m))
    parents, next_walls = [], []
    count = 0
    for low in range(0, len(beams.wall), block):
        alive = _walls_in_beams(walls, beams, low, min(low + block, len(beams.wall)), max_length_m)
        parent, wall = np.nonzero(alive)
        parents.append(parent + low)
        next_walls.append(wall)
        count += len(parent)
        if count > room_left:
            raise InputError(
                "too many image sources for the memory",
                found=f"more than {count} images of order {level}",
                needed=f"at most {int(max(room_left, 0))} of them",
                hint="lower image_order and leave the rest to rays",
            )
    if not parents:
        parents, next_walls = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    parent = np.concatenate(parents).astype(np.int64)
    return parent, _mirror(walls, beams, parent, np.concatenate(next_walls).astype(np.int64))


@kernel(parallel=True)
def _walls_in_beams(
    walls: Walls, beams: _Beams, low: int, high: int, max_length_m: float
) -> BoolArray:
    """Return whether each wall lies partly in the beams low to high, (high - low, n_walls)."""
    n_walls = len(walls.offset_m)
    alive = np.zeros((high - low, n_walls), dtype=np.bool_)
    for i in numba.prange(high - low):
        planes = np.empty((_CORNERS + 1, 4))
        scratch = np.empty((2, _CORNERS, 3))
        apex = row(beams.position_m, low + i)
        n_planes = _sides(walls, beams, low + i, planes)
        for w in range(n_walls):
            ahead = walls.offset_m[w] - dot(row(walls.normal, w), apex)
            if walls.tolerance_m < ahead <= max_length_m and not _all_outside(
                walls, w, planes, n_planes
            ):
                alive[i, w] = _clipped(walls, w, planes, n_planes, scratch) > 2
    return alive


@kernel()
def _mirror(walls: Walls, beams: _Beams, parent: IntArray, wall: IntArray) -> _Beams:
    """Return the mirror images of `parent` in `wall`, each with its beam."""
    n = len(parent)
    position = np.empty((n, 3))
    corners = np.empty((n, _CORNERS, 3))
    n_corners = np.empty(n, dtype=np.int64)
    planes = np.empty((_CORNERS + 1, 4))
    scratch = np.empty((2, _CORNERS, 3))
    for i in range(n):
        apex = row(beams.position_m, parent[i])
        normal = row(walls.normal, wall[i])
        ahead = walls.offset_m[wall[i]] - dot(normal, apex)
        for k in range(3):
            position[i, k] = apex[k] + 2.0 * ahead * normal[k]
        n_planes = _sides(walls, beams, parent[i], planes)
        n_corners[i] = _clipped(walls, wall[i], planes, n_planes, scratch)
        corners[i] = scratch[0]
    return _Beams(position, wall, corners, n_corners)


@kernel()
def _sides(walls: Walls, beams: _Beams, i: int, planes: FloatArray) -> int:
    """Write the planes (normal, offset) that bound beam i, normals inwards; return how many."""
    wall = beams.wall[i]
    if wall < 0:
        return 0
    n = beams.n_corners[i]
    apex = row(beams.position_m, i)
    for k in range(3):
        planes[0, k] = -walls.normal[wall, k]
    planes[0, 3] = -walls.offset_m[wall]
    count = 1
    middle = (0.0, 0.0, 0.0)
    for c in range(n):
        x = row(beams.corners_m[i], c)
        middle = (middle[0] + x[0] / n, middle[1] + x[1] / n, middle[2] + x[2] / n)
    for c in range(n):
        a, b = row(beams.corners_m[i], c), row(beams.corners_m[i], (c + 1) % n)
        side = cross(minus(a, apex), minus(b, apex))
        length = math.sqrt(dot(side, side))
        if length == 0.0:
            continue
        depth = dot(side, minus(middle, apex)) / length
        # a beam without width gives no reliable side: left open there
        if abs(depth) > walls.tolerance_m:
            sign = math.copysign(1.0 / length, depth)
            for k in range(3):
                planes[count, k] = side[k] * sign
            planes[count, 3] = dot(side, apex) * sign
            count += 1
    return count


@kernel()
def _height(planes: FloatArray, p: int, x: Vector) -> float:
    """Return how far inside plane p a point lies."""
    height: float = dot((planes[p, 0], planes[p, 1], planes[p, 2]), x) - planes[p, 3]
    return height


@kernel()
def _all_outside(walls: Walls, w: int, planes: FloatArray, n_planes: int) -> bool:
    """Return whether one plane has the whole wall outside: the cheap test before clipping.

    Plane 0 is the wall before. What does not rise above that one lies in it, such as the back of
    the same sheet, which sound must not go through.
    """
    for p in range(n_planes):
        margin = walls.tolerance_m if p == 0 else -walls.tolerance_m
        outside = True
        for c in range(walls.first_corner[w], walls.first_corner[w + 1]):
            if _height(planes, p, row(walls.outline_m, c)) > margin:
                outside = False
                break
        if outside:
            return True
    return False


@kernel()
def _clipped(walls: Walls, w: int, planes: FloatArray, n_planes: int, scratch: FloatArray) -> int:
    """Write the part of a wall's outline within all planes to scratch[0]; return its corners [1]_.

    References
    ----------
    .. [1] I. E. Sutherland, G. W. Hodgman, "Reentrant polygon clipping", Communications of the
           ACM 17, 32-42 (1974).
    """
    start, stop = walls.first_corner[w], walls.first_corner[w + 1]
    n: int = stop - start
    scratch[0, :n] = walls.outline_m[start:stop]
    for p in range(n_planes):
        if n == _CORNERS:
            return n
        n = _cut(scratch, n, planes, p, walls.tolerance_m)
        scratch[0, :n] = scratch[1, :n]
        if n < 3:
            return n
    return n


@kernel()
def _cut(scratch: FloatArray, n: int, planes: FloatArray, p: int, tolerance_m: float) -> int:
    """Write the part of polygon scratch[0] inside plane p to scratch[1]; return its corners."""
    kept = 0
    for c in range(n):
        a, b = row(scratch[0], c), row(scratch[0], (c + 1) % n)
        ha, hb = _height(planes, p, a), _height(planes, p, b)
        a_inside, b_inside = ha >= -tolerance_m, hb >= -tolerance_m
        if a_inside:
            scratch[1, kept, 0], scratch[1, kept, 1], scratch[1, kept, 2] = a
            kept += 1
        if a_inside != b_inside:
            # the cut lies where the height is -tolerance: both ends on either side of it
            share = (ha + tolerance_m) / (ha - hb)
            for k in range(3):
                scratch[1, kept, k] = a[k] + share * (b[k] - a[k])
            kept += 1
    return kept
