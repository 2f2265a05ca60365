"""The wall that a narrow beam falls on, found without cutting anything."""

from __future__ import annotations

import math

from roomfit.compiled import kernel
from roomfit.geometry.kernels import Vector, along, cross, dot, minus, row
from roomfit.tracing.beam_clip import height, put
from roomfit.tracing.beam_shadow import Shadows
from roomfit.tracing.images_walls import Blockers, Walls
from roomfit.typing import FloatArray


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

    Parameters
    ----------
    apex, wall, opening, n : vector, int, float array (ROWS, 3), int
        The beam, out of an opening of n corners in a wall.
    image : float array, shape (ROWS, 3)
        Receives the part of the wall that the beam falls on, n corners.
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
    would leak through every further wall, for shadows as thin as the margin cannot be told.
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
