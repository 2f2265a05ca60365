"""The walls of any room as image sources need them: coplanar triangles merged to one mirror."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roomfit.compiled import kernel
from roomfit.geometry.kernels import Vector, corner, dot, row
from roomfit.geometry.mesh import area_vectors_m2, corners_m, is_double_sided
from roomfit.scene.room import Room
from roomfit.tracing.images_outline import convex_outline, convex_pieces
from roomfit.typing import BoolArray, FloatArray, IntArray

# Share of the room's size within which a point lies in a plane: 20 micrometres in a hall, above
# the rounding of files in single precision and far below a wavelength.
FLATNESS = 1e-6
# Shares of the size that decide on paths must be far smaller: within a hundredth of a millimetre
# of some edge comes one in ten thousand of the paths with twenty hits.
_MARGIN = 1e-8
_EDGE = 1e-9


class Walls(NamedTuple):
    """Mirrors: planes seen from the air side, each with the triangles that lie in it.

    A double-sided sheet belongs to two walls of opposite normal.

    Attributes
    ----------
    tolerance_m : float
        Points so close to a plane lie in it, images so close together are one.
    margin_m : float
        By how much beams are too wide: above the rounding of images many mirrorings away.
    edge_m : float
        So far beyond its edge a wall still reflects, and stops nothing.
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
    edge : float array, shape (n_corners, 4)
        Unit normal and offset of the plane on which each side of an outline stands, inwards.
    ends_sound : bool array, shape (n_walls,)
        Whether sound goes nowhere beyond the outline: its pieces fill it, or it has the whole room
        in front.
    """

    tolerance_m: float
    margin_m: float
    edge_m: float
    normal: FloatArray
    offset_m: FloatArray
    first_piece: IntArray
    piece_m: FloatArray
    piece_triangle: IntArray
    first_corner: IntArray
    outline_m: FloatArray
    edge: FloatArray
    ends_sound: BoolArray


class Blockers(NamedTuple):
    """Convex polygons that may stand between two points of the room, largest first.

    Walls with the whole room in front of them are left out: a convex room has no blockers.

    Attributes
    ----------
    wall : int64 array, shape (n_blockers,)
        The wall whose plane each lies in, so that points of one wall are in front of none of its
        polygons.
    first_corner : int64 array, shape (n_blockers + 1,)
    corner_m : float array, shape (n_corners, 3)
        In turn, counter-clockwise about the wall's normal.
    """

    wall: IntArray
    first_corner: IntArray
    corner_m: FloatArray


def mirrors_of(room: Room) -> tuple[Walls, Blockers]:
    """Return the mirrors of a room and what can hide one point of it from another.

    Coplanar triangles that face the same way are one mirror, of whatever materials they are.
    Triangles without area are left out.
    """
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
    blocking = [
        convex_pieces(piece_m[order[a:b]], n, FLATNESS * size)
        if (corners @ n).max() > o + FLATNESS * size
        else []
        for a, b, n, o in zip(first[:-1], first[1:], normal, offset, strict=True)
    ]
    walls = Walls(
        FLATNESS * size,
        _MARGIN * size,
        _EDGE * size,
        normal,
        offset,
        first.astype(np.int64),
        np.ascontiguousarray(piece_m[order]),
        kept[piece[order]].astype(np.int64),
        _starts(outlines),
        np.concatenate(outlines),
        np.concatenate([_edges(o, n) for o, n in zip(outlines, normal, strict=True)]),
        np.array(
            [
                len(b) == 0 or (len(b) == 1 and len(b[0]) == len(o))
                for b, o in zip(blocking, outlines, strict=True)
            ]
        ),
    )
    return walls, _as_blockers(blocking)


def _edges(outline_m: FloatArray, normal: FloatArray) -> FloatArray:
    along = np.roll(outline_m, -1, axis=0) - outline_m
    inwards = np.cross(normal, along)
    inwards /= np.linalg.norm(inwards, axis=1)[:, None]
    return np.column_stack([inwards, np.einsum("ij,ij->i", inwards, outline_m)])


def _as_blockers(blocking: list[list[FloatArray]]) -> Blockers:
    pieces = [(w, piece) for w, own in enumerate(blocking) for piece in own]
    pieces.sort(key=lambda piece: -float(np.ptp(piece[1], axis=0).max()))
    return Blockers(
        np.array([w for w, _ in pieces], dtype=np.int64),
        _starts([p for _, p in pieces]),
        np.concatenate([np.zeros((0, 3)), *(p for _, p in pieces)]),
    )


def _starts(polygons: list[FloatArray]) -> IntArray:
    return np.concatenate(([0], np.cumsum([len(p) for p in polygons]))).astype(np.int64)


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
