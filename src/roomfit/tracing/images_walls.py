"""The walls of any room as image sources need them: coplanar triangles merged to one mirror."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roomfit.compiled import kernel
from roomfit.geometry.kernels import Vector, corner, dot, row
from roomfit.geometry.mesh import area_vectors_m2, corners_m, is_double_sided
from roomfit.scene.room import Room
from roomfit.typing import FloatArray, IntArray

# Share of the room's size within which a point lies in a plane and an edge belongs to both its
# walls: 20 micrometres in a hall, above the rounding of files in single precision and far below
# a wavelength.
FLATNESS = 1e-6
_OUTLINE_CORNERS = 12


class Walls(NamedTuple):
    """Mirrors: planes seen from the air side, each with the triangles that lie in it.

    A double-sided sheet belongs to two walls of opposite normal.

    Attributes
    ----------
    tolerance_m : float
    normal : float array, shape (n_walls, 3)
        Unit normal out of the air.
    offset_m : float array, shape (n_walls,)
        ``normal . x`` of the plane's points.
    first_piece : int64 array, shape (n_walls + 1,)
        Wall k owns the pieces ``first_piece[k]:first_piece[k + 1]``.
    piece_m : float array, shape (n_pieces, 3 corners, 3)
        Triangles, counter-clockwise about the wall's normal.
    piece_triangle : int64 array, shape (n_pieces,)
        Index of the triangle in the mesh.
    first_corner : int64 array, shape (n_walls + 1,)
    outline_m : float array, shape (n_corners, 3)
        A convex polygon about each wall's pieces, corners in turn.
    """

    tolerance_m: float
    normal: FloatArray
    offset_m: FloatArray
    first_piece: IntArray
    piece_m: FloatArray
    piece_triangle: IntArray
    first_corner: IntArray
    outline_m: FloatArray


class Screens(NamedTuple):
    """All triangles, as what may stand between two points.

    Attributes
    ----------
    corners_m : float array, shape (n_triangles, 3, 3)
    normal : float array, shape (n_triangles, 3)
    offset_m : float array, shape (n_triangles,)
        Of the plane of the wall that the triangle belongs to, so that points of one wall are in
        front of none of its triangles.
    """

    corners_m: FloatArray
    normal: FloatArray
    offset_m: FloatArray


def mirrors_of(room: Room) -> tuple[Walls, Screens]:
    """Return the mirrors of a room and the screens in it. Triangles without area are left out."""
    mesh = room.mesh
    vectors = area_vectors_m2(mesh)
    areas = np.linalg.norm(vectors, axis=1)
    kept = np.flatnonzero(areas > 0.0)
    corners = corners_m(mesh)[kept]
    normals = vectors[kept] / areas[kept, None]
    sheet = is_double_sided(mesh)[kept]
    # the back of every sheet stands behind all fronts
    piece = np.concatenate([np.arange(len(kept)), np.flatnonzero(sheet)])
    turned = np.arange(len(piece)) >= len(kept)
    piece_m = np.where(turned[:, None, None], corners[piece][:, ::-1], corners[piece])
    piece_normal = np.where(turned[:, None], -normals[piece], normals[piece])
    size = float(np.linalg.norm(np.ptp(corners.reshape(-1, 3), axis=0)))
    largest_first = np.argsort(-areas[kept][piece], kind="stable")
    owner, normal, offset = _group(piece_m, piece_normal, largest_first, FLATNESS * size)
    order = np.argsort(owner, kind="stable")
    first = np.searchsorted(owner[order], np.arange(len(normal) + 1))
    outlines = [
        convex_outline(piece_m[order[a:b]].reshape(-1, 3), n)
        for a, b, n in zip(first[:-1], first[1:], normal, strict=True)
    ]
    walls = Walls(
        FLATNESS * size,
        normal,
        offset,
        first.astype(np.int64),
        np.ascontiguousarray(piece_m[order]),
        kept[piece[order]].astype(np.int64),
        np.concatenate(([0], np.cumsum([len(o) for o in outlines]))).astype(np.int64),
        np.concatenate(outlines),
    )
    front = owner[: len(kept)]
    return walls, Screens(np.ascontiguousarray(corners), normal[front], offset[front])


def convex_outline(points_m: FloatArray, normal: FloatArray) -> FloatArray:
    """Return a convex polygon that holds points of a plane, counter-clockwise about its normal.

    The convex hull [1]_ where that has few corners, else a rectangle about it.

    References
    ----------
    .. [1] A. M. Andrew, "Another efficient algorithm for convex hulls in two dimensions",
           Information Processing Letters 9, 216-219 (1979).
    """
    axis = np.eye(3)[np.argmin(np.abs(normal))]
    u = np.cross(axis, normal) / np.linalg.norm(np.cross(axis, normal))
    axes = np.array([u, np.cross(normal, u)])
    flat = points_m @ axes.T
    order = np.lexsort((flat[:, 1], flat[:, 0]))
    hull = _half_hull(flat, order)[:-1] + _half_hull(flat, order[::-1])[:-1]
    if len(hull) <= _OUTLINE_CORNERS:
        return np.asarray(points_m[hull])
    (left, low), (right, high) = flat.min(axis=0), flat.max(axis=0)
    rectangle = np.array([[left, low], [right, low], [right, high], [left, high]])
    return np.asarray(rectangle @ axes + np.dot(points_m[0], normal) * normal)


def _half_hull(flat: FloatArray, order: IntArray) -> list[int]:
    chain: list[int] = []
    for i in order:
        while len(chain) > 1 and not _turns_left(flat[chain[-2]], flat[chain[-1]], flat[i]):
            chain.pop()
        chain.append(int(i))
    return chain


def _turns_left(a: FloatArray, b: FloatArray, c: FloatArray) -> bool:
    return bool((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0.0)


@kernel()
def _lies_in(
    piece_m: FloatArray, i: int, normal: Vector, offset_m: float, tolerance_m: float
) -> bool:
    farthest = 0.0
    for k in range(3):
        farthest = max(farthest, abs(dot(normal, corner(piece_m, i, k)) - offset_m))
    return farthest <= tolerance_m


@kernel()
def _group(
    piece_m: FloatArray, piece_normal: FloatArray, order: IntArray, tolerance_m: float
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Give each piece to the first wall whose plane holds its corners, or start a new one."""
    n = len(order)
    owner = np.full(n, -1, dtype=np.int64)
    normal = np.empty((n, 3))
    offset = np.empty(n)
    n_walls = 0
    for i in order:
        facing = row(piece_normal, i)
        for w in range(n_walls):
            if dot(row(normal, w), facing) > 0.5 and _lies_in(
                piece_m, i, row(normal, w), offset[w], tolerance_m
            ):
                owner[i] = w
                break
        if owner[i] < 0:
            owner[i] = n_walls
            normal[n_walls] = piece_normal[i]
            offset[n_walls] = np.dot(piece_normal[i], piece_m[i, 0])
            n_walls += 1
    return owner, normal[:n_walls].copy(), offset[:n_walls].copy()
