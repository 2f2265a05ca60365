"""Convex rooms of few planes: a ray leaves through the plane that it meets first."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from roomfit.compiled import kernel
from roomfit.geometry.mesh import area_vectors_m2, corners_m, is_double_sided
from roomfit.scene.room import Room, triangle_material
from roomfit.tracing.bounce import Vector
from roomfit.typing import FloatArray, IntArray

MAX_PLANES = 32
# Share of the room's size by which a corner may stand off a plane and still lie in it: a micrometre
# in a hall, far below a wavelength and above the rounding of files with seven digits.
_FLATNESS = 1e-7


class Planes(NamedTuple):
    """The walls of a convex room, as infinite planes.

    Attributes
    ----------
    normal : float array, shape (n_planes, 3)
        Unit normals out of the room.
    offset_m : float array, shape (n_planes,)
        ``normal . x`` of the plane's points.
    material : int32 array, shape (n_planes,)
        -1 where the plane carries several.
    first_piece : int64 array, shape (n_planes + 1,)
        Plane k owns the pieces ``first_piece[k]:first_piece[k + 1]``.
    piece_corners_m : float array, shape (n_pieces, 3 corners, 3)
    piece_material : int32 array, shape (n_pieces,)
    """

    normal: FloatArray
    offset_m: FloatArray
    material: IntArray
    first_piece: IntArray
    piece_corners_m: FloatArray
    piece_material: IntArray


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
    # distances are compared as fractions, because a division costs more than all the rest
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
    return material if material >= 0 else _piece_material(planes, k, p)


@kernel(allocates=False)
def _piece_material(planes: Planes, k: int, p: Vector) -> int:
    n = planes.normal[k]
    best, found = -np.inf, 0
    for i in range(planes.first_piece[k], planes.first_piece[k + 1]):
        depth = np.inf
        for side in range(3):
            a = planes.piece_corners_m[i, side]
            b = planes.piece_corners_m[i, (side + 1) % 3]
            ex, ey, ez = b[0] - a[0], b[1] - a[1], b[2] - a[2]
            px, py, pz = p[0] - a[0], p[1] - a[1], p[2] - a[2]
            inside = (
                n[0] * (ey * pz - ez * py) + n[1] * (ez * px - ex * pz) + n[2] * (ex * py - ey * px)
            )
            depth = min(depth, inside / math.sqrt(ex * ex + ey * ey + ez * ez))
        if depth > best:
            best, found = depth, int(planes.piece_material[i])
    return found
