"""One ray or one point against one triangle, in plain float64.

Slow and simple next to the tracer's kernels, and independent of them, because it is there to check
rooms. Triangles count on both sides, whatever their orientation.
"""

from __future__ import annotations

from typing import TypeAlias

from roomfit.compiled import kernel
from roomfit.typing import FloatArray

Vector: TypeAlias = tuple[float, float, float]

MISSED = -1.0


@kernel()
def minus(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel()
def dot(a: Vector, b: Vector) -> float:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel()
def cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel()
def along(start: Vector, direction: Vector, distance: float) -> Vector:
    """Return start + distance * direction."""
    return (
        start[0] + distance * direction[0],
        start[1] + distance * direction[1],
        start[2] + distance * direction[2],
    )


@kernel()
def row(table: FloatArray, i: int) -> Vector:
    """Return row i of an (n, 3) array."""
    return table[i, 0], table[i, 1], table[i, 2]


@kernel()
def corner(corners_m: FloatArray, i: int, k: int) -> Vector:
    """Return corner k of triangle i of an (n, 3, 3) array."""
    return corners_m[i, k, 0], corners_m[i, k, 1], corners_m[i, k, 2]


@kernel()
def flight_m(corners_m: FloatArray, i: int, start: Vector, direction: Vector) -> float:
    """Return the distance along a unit direction to triangle i, or a negative one for a miss [1]_.

    References
    ----------
    .. [1] T. Moller, B. Trumbore, "Fast, minimum storage ray/triangle intersection", J. Graphics
           Tools 2, 21-28 (1997).
    """
    a = corner(corners_m, i, 0)
    ab = minus(corner(corners_m, i, 1), a)
    ac = minus(corner(corners_m, i, 2), a)
    h = cross(direction, ac)
    determinant = dot(ab, h)
    if determinant == 0.0:
        return MISSED
    s = minus(start, a)
    u = dot(s, h) / determinant
    if u < 0.0 or u > 1.0:
        return MISSED
    k = cross(s, ab)
    v = dot(direction, k) / determinant
    if v < 0.0 or u + v > 1.0:
        return MISSED
    return dot(ac, k) / determinant


@kernel()
def square_distance_m2(corners_m: FloatArray, i: int, x: Vector) -> float:
    """Return the squared distance from a point to triangle i.

    The foot of the perpendicular lies within the triangle, or else a side is nearest.
    """
    a, b, c = corner(corners_m, i, 0), corner(corners_m, i, 1), corner(corners_m, i, 2)
    n = cross(minus(b, a), minus(c, a))
    square = dot(n, n)
    if (
        square > 0.0
        and dot(cross(minus(b, a), minus(x, a)), n) >= 0.0
        and dot(cross(minus(c, b), minus(x, b)), n) >= 0.0
        and dot(cross(minus(a, c), minus(x, c)), n) >= 0.0
    ):
        return dot(minus(x, a), n) ** 2 / square
    return min(_square_to_side(a, b, x), _square_to_side(b, c, x), _square_to_side(c, a, x))


@kernel()
def _square_to_side(a: Vector, b: Vector, x: Vector) -> float:
    side = minus(b, a)
    square = dot(side, side)
    share = 0.0
    if square > 0.0:
        share = min(max(dot(minus(x, a), side) / square, 0.0), 1.0)
    away = minus(x, along(a, side, share))
    return dot(away, away)
