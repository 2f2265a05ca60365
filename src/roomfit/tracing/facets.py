"""Walls of any room as facets: triangles, and parallelograms where two triangles make one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roomfit.compiled import kernel
from roomfit.errors import InputError
from roomfit.geometry.mesh import corners_m, is_double_sided
from roomfit.scene.room import Room, triangle_material
from roomfit.tracing.bounce import Vector
from roomfit.typing import BoolArray, FloatArray, IntArray

# Facets are this much wider than their corners say, so that rounding opens no gap between two.
EDGE_M = 1e-9
# A ray that starts this near to the plane of a facet, on either side, starts on it.
TOUCH_M = 1e-9
# Squared cosine from which on walls count as parallel: 1e-4 radians, above the rounding of files.
_PARALLEL = 1.0 - 1e-8


class Facets(NamedTuple):
    """Facets with their transforms worked out beforehand [1]_.

    A point p of a facet's plane has the coordinates ``u = U . p + u0`` along one side and
    ``v = V . p + v0`` along the other, 0 to 1; a triangle ends at ``u + v = 1``.

    Attributes
    ----------
    table : float array, shape (n_facets, 16)
        In two cache lines: unit normal out of the air (3), its product with the plane's points in
        m (1), U in 1/m (3), u0 (1), V in 1/m (3), v0 (1), `EDGE_M` in units of u and v (1), 1 for
        a triangle and 0 for a parallelogram (1), 1 for a double-sided sheet (1), nothing (1).
    normal : float array, shape (n_facets, 3)
    material : int32 array, shape (n_facets,)

    References
    ----------
    .. [1] D. Baldwin, M. Weber, "Fast ray-triangle intersections by coordinate transformation",
           J. Computer Graphics Techniques 5 (3), 39-49 (2016).
    """

    table: FloatArray
    normal: FloatArray
    material: IntArray


def facets_of(room: Room) -> tuple[Facets, FloatArray]:
    """Return the facets of a room and their boxes; triangles without area are left out.

    Returns
    -------
    Facets
    float array, shape (n_facets, 2, 3)
        Lowest and highest coordinates of each facet, in metres.
    """
    corners = corners_m(room.mesh)
    vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    solid = np.flatnonzero(np.linalg.norm(vectors, axis=1) > 0.0)
    if not solid.size:
        raise InputError("the room has no surface", found="triangles without area only")
    corners = corners[solid]
    owner = triangle_material(room)[solid]
    sheet = is_double_sided(room.mesh)[solid]
    kind = 2 * owner.astype(np.int64) + sheet
    apex, mate = _parallelograms(corners, room.mesh.triangles[solid].astype(np.int64), kind)
    kept = np.flatnonzero(mate >= 0)
    first = corners[kept, apex[kept]]
    second = corners[kept, (apex[kept] + 1) % 3]
    third = corners[kept, (apex[kept] + 2) % 3]
    is_triangle = mate[kept] == kept
    facets = _facets(first, second, third, is_triangle, sheet[kept], owner[kept])
    fourth = np.where(is_triangle[:, None], first, second + third - first)
    points = np.stack((first, second, third, fourth))
    return facets, np.stack((points.min(axis=0), points.max(axis=0)), axis=1)


def _parallelograms(
    corners: FloatArray, vertices: IntArray, kind: IntArray
) -> tuple[IntArray, IntArray]:
    """Pair triangles that make a parallelogram and agree in vertices, kind and orientation.

    Returns
    -------
    apex : int array, shape (n_triangles,)
        The corner opposite to the side shared with the mate; 0 for a triangle that stays alone.
    mate : int array, shape (n_triangles,)
        The other triangle; itself for one that stays alone; -1 for the second of a pair.
    """
    n = len(corners)
    tails, heads = vertices, np.roll(vertices, -1, axis=1)
    base = int(vertices.max(initial=0)) + 1
    forward = (tails * base + heads).reshape(-1)
    backward = (heads * base + tails).reshape(-1)
    order = np.argsort(forward, kind="stable")
    place = np.minimum(np.searchsorted(forward[order], backward), 3 * n - 1)
    shared = order[place]
    side = np.flatnonzero(forward[shared] == backward)
    other = shared[side]
    own, own_apex = side // 3, (side % 3 + 2) % 3
    far, far_apex = other // 3, (other % 3 + 2) % 3
    ends = corners[own, (own_apex + 1) % 3] + corners[own, (own_apex + 2) % 3]
    misfit = ends - corners[own, own_apex] - corners[far, far_apex]
    # half the slack of the edges, so that merging opens no gap to the neighbours
    fits = (np.abs(misfit).max(axis=1) < 0.5 * EDGE_M) & (kind[own] == kind[far]) & (own < far)
    apex, mate = np.zeros(n, dtype=np.int64), np.arange(n)
    free = np.ones(n, dtype=np.bool_)
    for a, corner, b in zip(own[fits], own_apex[fits], far[fits], strict=True):
        if free[a] and free[b]:
            free[a] = free[b] = False
            apex[a], mate[a], mate[b] = corner, b, -1
    return apex, mate


def _facets(
    first: FloatArray,
    second: FloatArray,
    third: FloatArray,
    is_triangle: BoolArray,
    sheet: BoolArray,
    owner: IntArray,
) -> Facets:
    a, b = second - first, third - first
    n = np.cross(a, b)
    square = np.einsum("ij,ij->i", n, n)[:, None]
    normal = n / np.sqrt(square)
    u, v = np.cross(b, n) / square, np.cross(n, a) / square
    table = np.zeros((len(first), 16))
    table[:, 0:3], table[:, 3] = normal, np.einsum("ij,ij->i", normal, first)
    table[:, 4:7], table[:, 7] = u, -np.einsum("ij,ij->i", u, first)
    table[:, 8:11], table[:, 11] = v, -np.einsum("ij,ij->i", v, first)
    table[:, 12] = EDGE_M * np.linalg.norm(np.stack((u, v, u + v)), axis=2).max(axis=0)
    table[:, 13] = is_triangle
    table[:, 14] = sheet
    return Facets(table, normal, owner.astype(np.int32))


@kernel(allocates=False)
def _is_parallel(table: FloatArray, i: int, left: Vector) -> bool:
    cosine = table[i, 0] * left[0] + table[i, 1] * left[1] + table[i, 2] * left[2]
    return bool(cosine * cosine > _PARALLEL)


@kernel(allocates=False)
def facet_distance(
    table: FloatArray, i: int, o: Vector, d: Vector, left: Vector, limit: float
) -> float:
    """Return the distance to facet i along a unit direction; infinity for a miss or over `limit`.

    A wall is met where the ray goes out of the air through it, also when rounding has put the
    start a little behind it (distance 0 then): that keeps rays in at corners. From behind, or on a
    sheet, it is met only where the start is clear of its plane.

    Parameters
    ----------
    left : vector
        Normal of the wall on which the ray starts, zeros for none. What lies in one plane with
        that wall is not met: else a ray would never leave a panel of two faces back to back.
    """
    speed = table[i, 0] * d[0] + table[i, 1] * d[1] + table[i, 2] * d[2]
    gap = table[i, 3] - (table[i, 0] * o[0] + table[i, 1] * o[1] + table[i, 2] * o[2])
    t = gap / speed
    if not t <= limit:
        return np.inf
    if speed > 0.0 and table[i, 14] == 0.0:
        if gap < -TOUCH_M or (gap <= TOUCH_M and _is_parallel(table, i, left)):
            return np.inf
    elif t <= 0.0 or abs(gap) <= TOUCH_M:
        return np.inf
    x, y, z = o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2]
    u = table[i, 4] * x + table[i, 5] * y + table[i, 6] * z + table[i, 7]
    v = table[i, 8] * x + table[i, 9] * y + table[i, 10] * z + table[i, 11]
    low, high = -table[i, 12], 1.0 + table[i, 12]
    if u < low or v < low or u + table[i, 13] * v > high or v + table[i, 13] * u > high:
        return np.inf
    return float(max(t, 0.0))
