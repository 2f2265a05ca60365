"""Walls for rays: facets or the planes of a convex room, reflection, and its random numbers.

Facets are triangles, or parallelograms where two triangles make one. From a convex room of few
planes a ray leaves through the plane that it meets first. Random numbers depend only on seed,
source, ray and hit: none is drawn from a stream, so that a trace gives the same bits however its
rays are dealt out to threads. The hash is the finaliser of splitmix64 [1]_ applied to a counter.

References
----------
.. [1] G. L. Steele, D. Lea, C. H. Flood, "Fast splittable pseudorandom number generators", Proc.
       OOPSLA 2014, 453-472; constants of variant 13 by D. Stafford.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from roomfit.base.errors import InputError
from roomfit.base.kernels import kernel
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.room.inside import Vector, deepest, row
from roomfit.room.mesh import area_vectors_m2, corners_m, is_double_sided
from roomfit.room.scene import Room, triangle_material

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)
_30, _27, _31, _11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
_UNIT = 2.0**-53


@kernel(allocates=False)
def mixed(x: np.uint64) -> np.uint64:
    """Return a 64-bit number each of whose bits depends on every bit of `x`."""
    x = (x ^ (x >> _30)) * _FIRST
    x = (x ^ (x >> _27)) * _SECOND
    return x ^ (x >> _31)


@kernel(allocates=False)
def ray_key(seed: int, source: int, ray: int) -> np.uint64:
    """Return the key of one ray for every later draw."""
    key = mixed(np.uint64(seed) + _GOLDEN)
    key = mixed(key ^ (np.uint64(source) + _GOLDEN))
    return mixed(key ^ (np.uint64(ray) + _GOLDEN))


@kernel(allocates=False)
def uniform(key: np.uint64, draw: int) -> float:
    """Return draw number `draw` of a key, uniform in [0, 1) in steps of 2**-53."""
    bits = mixed(key + (np.uint64(draw) + np.uint64(1)) * _GOLDEN)
    return np.float64(bits >> _11) * _UNIT


@kernel(allocates=False)
def mirrored(d: Vector, normal: Vector) -> Vector:
    """Return the specular direction; the sense of the unit normal does not matter."""
    twice = 2.0 * (d[0] * normal[0] + d[1] * normal[1] + d[2] * normal[2])
    return d[0] - twice * normal[0], d[1] - twice * normal[1], d[2] - twice * normal[2]


@kernel(allocates=False)
def scattered(d: Vector, normal: Vector, u: float, v: float) -> Vector:
    """Return a direction by Lambert's cosine law on the side from which `d` came.

    The two directions across the normal are those of T. Duff et al., "Building an orthonormal
    basis, revisited", J. Computer Graphics Techniques 6 (1), 1-8 (2017).
    """
    x, y, z = normal
    if d[0] * x + d[1] * y + d[2] * z > 0.0:
        x, y, z = -x, -y, -z
    # the change of basis lies far from z = 0, where upright walls differ by rounding alone
    sign = 1.0 if z > -0.6 else -1.0
    a = -1.0 / (sign + z)
    b = x * y * a
    along = math.sqrt(1.0 - u)
    across = math.sqrt(u)
    p = across * math.cos(2.0 * math.pi * v)
    q = across * math.sin(2.0 * math.pi * v)
    return (
        along * x + p * (1.0 + sign * x * x * a) + q * b,
        along * y + p * sign * b + q * (sign + y * y * a),
        along * z - p * sign * x - q * y,
    )


@kernel(allocates=False, inlined=True)
def after_wall(
    d: Vector, normal: Vector, scattering: float, key: np.uint64, hit: int
) -> tuple[Vector, bool]:
    """Return the direction after a hit and whether it was drawn from Lambert's law."""
    if scattering > 0.0 and uniform(key, 3 * hit) < scattering:
        out = scattered(d, normal, uniform(key, 3 * hit + 1), uniform(key, 3 * hit + 2))
        return out, True
    return mirrored(d, normal), False


# Facets are wider than their corners by this, so that rounding opens no gap between two.
EDGE_M = 1e-9
# A ray that starts this near to the plane of a facet, on either side, starts on it.
TOUCH_M = 1e-9
# Squared cosine from which on walls count as parallel: 1e-4 radians, above the rounding of files.
_PARALLEL = 1.0 - 1e-8


class Facets(NamedTuple):
    """Facets with precomputed transforms [1]_.

    A point p of a facet's plane has the coordinates ``u = U . p + u0`` along one side and
    ``v = V . p + v0`` along the other, 0 to 1; a triangle ends at ``u + v = 1``.

    References
    ----------
    .. [1] D. Baldwin, M. Weber, "Fast ray-triangle intersections by coordinate transformation",
           J. Computer Graphics Techniques 5 (3), 39-49 (2016).
    """

    # (n_facets, 16), two cache lines: unit normal out of the air (3), its product with the
    # plane's points in m (1), U in 1/m (3), u0 (1), V in 1/m (3), v0 (1), `EDGE_M` in units of u
    # and v (1), 1 for a triangle and 0 for a parallelogram (1), 1 for a double-sided sheet (1),
    # nothing (1)
    table: FloatArray
    normal: FloatArray  # (n_facets, 3)
    material: IntArray  # int32 (n_facets,)


def facets_of(room: Room) -> tuple[Facets, FloatArray]:
    """Return the facets of a room and their boxes; triangles without area are left out."""
    corners = corners_m(room.mesh)
    vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    solid = np.flatnonzero(np.linalg.norm(vectors, axis=1) > 0.0)
    if not solid.size:
        raise InputError(
            "the room has no surface",
            found="triangles without area only",
            needed="a triangle with an area",
            hint="export the room again, with surfaces that have an area",
        )
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
    facets = facet_table(first, second, third, is_triangle, sheet[kept], owner[kept])
    fourth = np.where(is_triangle[:, None], first, second + third - first)
    points = np.stack((first, second, third, fourth))
    return facets, np.stack((points.min(axis=0), points.max(axis=0)), axis=1)


def _parallelograms(
    corners: FloatArray, vertices: IntArray, kind: IntArray
) -> tuple[IntArray, IntArray]:
    """Pair triangles that make a parallelogram and agree in vertices, kind and orientation.

    Shapes: apex (n_triangles,), mate (n_triangles,).
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
    for a, tip, b in zip(own[fits], own_apex[fits], far[fits], strict=True):
        if free[a] and free[b]:
            free[a] = free[b] = False
            apex[a], mate[a], mate[b] = tip, b, -1
    return apex, mate


def facet_table(
    first: FloatArray,
    second: FloatArray,
    third: FloatArray,
    is_triangle: BoolArray,
    sheet: BoolArray,
    owner: IntArray,
) -> Facets:
    """Return facets from three corners of each, the last two beside the first, all (n, 3)."""
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


MAX_PLANES = 32
# Share of the room's size by which a corner may stand off a plane and still lie in it: a micrometre
# in a hall, far below a wavelength and above the rounding of files with seven digits.
_FLATNESS = 1e-7


class Planes(NamedTuple):
    """The walls of a convex room, as infinite planes."""

    normal: FloatArray  # (n_planes, 3): unit normals out of the room
    offset_m: FloatArray  # (n_planes,), ``normal . x`` of the plane's points
    material: IntArray  # int32 (n_planes,), -1 where the plane has several
    first_piece: (
        IntArray  # int64 (n_planes + 1,), where the pieces of each plane begin, and the end
    )
    piece_corners_m: FloatArray  # (n_pieces, 3 corners, 3)
    piece_material: IntArray  # int32 (n_pieces,)


def convex_planes(room: Room) -> Planes | None:
    """Return the planes of a closed convex room with single-sided walls, or None for any other.

    Triangles in one plane are merged. The room is convex and closed where every corner lies on
    the inner side of every plane and the triangles have the area and volume of the convex hull.
    """
    mesh = room.mesh
    vectors = area_vectors_m2(mesh)
    areas = np.linalg.norm(vectors, axis=1)
    if is_double_sided(mesh).any() or not (areas > 0.0).all():
        return None
    corners = corners_m(mesh)
    used = corners.reshape(-1, 3)
    tolerance = _FLATNESS * float(np.linalg.norm(np.ptp(used, axis=0)))
    plane = np.full(len(areas), -1, dtype=np.int64)
    normals: list[FloatArray] = []
    offsets: list[float] = []
    for seed in np.argsort(-areas, kind="stable"):
        if plane[seed] >= 0:
            continue
        if len(normals) == MAX_PLANES:
            return None
        normal = vectors[seed] / areas[seed]
        heights = corners @ normal - corners[seed].mean(axis=0) @ normal
        if heights.max() > tolerance:
            return None
        flat = (np.abs(heights).max(axis=1) <= tolerance) & (vectors @ normal > 0.0)
        plane[flat & (plane < 0)] = len(normals)
        normals.append(normal)
        offsets.append(float(corners[seed].mean(axis=0) @ normal))
    if not _fills_its_hull(used, corners, vectors, areas):
        return None
    return _planes(np.array(normals), np.array(offsets), plane, corners, triangle_material(room))


def _fills_its_hull(
    points: FloatArray, corners: FloatArray, vectors: FloatArray, areas: FloatArray
) -> bool:
    from scipy.spatial import ConvexHull, QhullError  # heavy, and for rays alone

    try:
        hull = ConvexHull(points)
    except QhullError:  # all corners in one plane
        return False
    middle = points.mean(axis=0)
    volume = np.einsum("ij,ij->", corners.mean(axis=1) - middle, vectors) / 3.0
    return bool(
        np.isclose(areas.sum(), hull.area, rtol=1e-6) and np.isclose(volume, hull.volume, rtol=1e-6)
    )


def _planes(
    normals: FloatArray, offsets: FloatArray, plane: IntArray, corners: FloatArray, owner: IntArray
) -> Planes:
    order = np.argsort(plane, kind="stable")
    first = np.searchsorted(plane[order], np.arange(len(normals) + 1))
    pieces = owner[order]
    material = np.array(
        [pieces[a] if (pieces[a:b] == pieces[a]).all() else -1 for a, b in pairwise(first)]
    )
    return Planes(
        normals,
        offsets,
        material.astype(np.int32),
        first.astype(np.int64),
        corners[order],
        pieces.astype(np.int32),
    )


@kernel(allocates=False, inlined=True)
def nearest_plane(planes: Planes, o: Vector, d: Vector) -> tuple[float, int]:
    """Return the distance to the plane through which a ray leaves a convex room, and the plane.

    One is always found, and no wall just hit needs to be left out: after a reflection the ray
    moves away from it. A start that rounding has put behind a wall gives distance 0.
    """
    # distances are compared as fractions, because a division costs more than all else
    gap, approach, hit = 1.0, 0.0, -1
    normal, offset = planes.normal, planes.offset_m
    for k in range(len(offset)):
        x, y, z = normal[k, 0], normal[k, 1], normal[k, 2]
        speed = x * d[0] + y * d[1] + z * d[2]
        room = offset[k] - (x * o[0] + y * o[1] + z * o[2])
        if speed > 0.0 and room * approach < gap * speed:
            gap, approach, hit = room, speed, k
    return max(gap / approach, 0.0), hit


@kernel(allocates=False)
def material_in_plane(planes: Planes, k: int, p: Vector) -> int:
    """Return the material at a point of plane k: that of the piece in which it lies deepest."""
    material = int(planes.material[k])
    if material >= 0:
        return material
    first, stop = planes.first_piece[k], planes.first_piece[k + 1]
    piece = deepest(planes.piece_corners_m, first, stop, row(planes.normal, k), p, -math.inf)
    return int(planes.piece_material[max(piece, 0)])
