"""One polygon: whose it is, its area, and its triangles."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import mapbox_earcut
import numpy as np

from roomfit.base.typing import FloatArray, IntArray

# Corners nearer than 0.1 mm are one corner. An absolute length, because what is welded is the
# rounding of drawing programs (six decimals of a metre, three of a millimetre), which does not grow
# with the room, and because it must stay far below any wavelength (21 mm at 16 kHz).
WELD_TOLERANCE_M = 1e-4
_NO_AREA = 1e-12  # of the squared perimeter: what rounding leaves of a polygon without area


def place(point_m: FloatArray) -> str:
    """Return a point as text, in metres to the millimetre."""
    x, y, z = np.round(np.asarray(point_m, dtype=np.float64), 3) + 0.0  # no "-0.000"
    return f"({x:.3f}, {y:.3f}, {z:.3f}) m"


@dataclass(frozen=True, slots=True)
class Surface:
    """The faces of a file that share a name, a group and a material."""

    name: str  # Of surface, object or plane in the file; "west", "floor", ... for a shoebox
    group: str | None = None  # In the file, where it has groups
    file_material: str | None = None
    # A sheet in the air that reflects on both sides, such as a curtain. It encloses nothing, so it
    # is left out of volume and closure checks; its area counts twice.
    double_sided: bool = False


class Face(NamedTuple):
    """One polygon of a file: indices of its corners in order, and the surface it belongs to."""

    corners: tuple[int, ...]
    surface: Surface


class Triangulation(NamedTuple):
    """The triangles of one polygon."""

    triangles: IntArray  # (n_triangles, 3), corners in the polygon's sense; empty without area
    area_m2: float  # Of the polygon's projection along its normal
    off_plane_m: float  # Largest distance of a corner from the best plane
    crosses_itself: bool  # The triangles do not cover the polygon's area


def area_vector_m2(corners_m: FloatArray) -> FloatArray:
    """Return normal times area of a polygon, shape (3,), by Newell's sum over its edges.

    Counter-clockwise corners give a vector that points to the viewer. Exact for flat polygons of
    any outline; the area of a warped one is that of its shadow along the mean normal.

    `corners_m` has the shape (n_corners, 3).
    """
    x, y, z = from_first = (corners_m - corners_m[0]).T
    u, v, w = np.roll(from_first, -1, axis=1)  # numpy's own product takes three times as long
    return np.asarray(0.5 * np.stack((y * w - z * v, z * u - x * w, x * v - y * u), 1).sum(axis=0))


def triangulate(corners_m: FloatArray) -> Triangulation:
    """Cut a polygon into triangles with the ear-cutting method.

    The polygon may be concave, have corners that stand on a straight line, or the same corner
    twice. A fan from the first corner, as many readers cut it, would cover the notch of an
    L-shaped floor.

    `corners_m`, shape (n_corners, 3): in order around the polygon, the last one not repeating the
    first.
    """
    vector = area_vector_m2(corners_m)
    area = float(np.linalg.norm(vector))
    edges = np.roll(corners_m, -1, axis=0) - corners_m
    perimeter = float(np.linalg.norm(edges, axis=1).sum())
    if len(corners_m) < 3 or not area > _NO_AREA * perimeter**2:
        return Triangulation(np.zeros((0, 3), dtype=np.int64), area, 0.0, False)
    normal = vector / area
    from_middle = corners_m - corners_m.mean(axis=0)
    off_plane = float(np.abs(from_middle @ normal).max())
    if len(corners_m) == 3:
        return Triangulation(np.array([[0, 1, 2]]), area, off_plane, False)
    flat = np.ascontiguousarray(from_middle @ plane_axes(normal).T)
    ring = np.array([len(flat)], dtype=np.uint32)
    cut = mapbox_earcut.triangulate_float64(flat, ring).astype(np.int64).reshape(-1, 3)
    a, b, c = (flat[cut[:, k]] for k in range(3))
    ab, ac = b - a, c - a
    twice = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    cut[twice < 0.0] = cut[twice < 0.0][:, ::-1]
    covered = 0.5 * float(np.abs(twice).sum())
    triangles = cut[np.abs(twice) > _NO_AREA * perimeter**2]
    return Triangulation(triangles, area, off_plane, abs(covered - area) > 1e-6 * area)


def plane_axes(normal: FloatArray) -> FloatArray:
    """Return two unit vectors that with the normal form a right-handed frame, shape (2, 3)."""
    helper = np.zeros(3)
    helper[np.argmin(np.abs(normal))] = 1.0
    u = np.cross(helper, normal)
    u /= np.linalg.norm(u)
    return np.array([u, np.cross(normal, u)])


def area_m2(polygons: Iterable[FloatArray]) -> float:
    """Return the sum of the areas of some polygons."""
    return float(sum(np.linalg.norm(area_vector_m2(polygon)) for polygon in polygons))


def divide(piece: FloatArray, triangle: FloatArray) -> tuple[FloatArray | None, list[FloatArray]]:
    """Return what of a convex polygon lies within a triangle of its plane, and what lies outside.

    Convex polygons: beyond each edge of the triangle in turn, and within all edges before it.
    Where nothing lies within it comes None, and the piece whole.
    """
    inner, outside = piece, []
    for a, b in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
        below, above = halves(inner, a, np.cross(b - a, area_vector_m2(triangle)))
        outside.append(above)
        inner = below
    if is_thin(inner):
        return None, [piece]
    return inner, [rest for rest in outside if not is_thin(rest)]


def halves(
    piece: FloatArray, point_m: FloatArray, normal: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return what of a convex polygon lies below and above a plane."""
    height_m = (piece - point_m) @ (normal / np.linalg.norm(normal))
    height_m[np.abs(height_m) < 0.1 * WELD_TOLERANCE_M] = 0.0
    return _above(piece, -height_m), _above(piece, height_m)


def _above(polygon: FloatArray, height_m: FloatArray) -> FloatArray:
    """Clip a convex polygon at a line by its corners' heights (Sutherland and Hodgman 1974)."""
    corners: list[FloatArray] = []
    for k in range(len(polygon)):
        n = (k + 1) % len(polygon)
        if height_m[k] >= 0.0:
            corners.append(polygon[k])
        if height_m[k] * height_m[n] < 0.0:
            share = height_m[k] / (height_m[k] - height_m[n])
            corners.append(polygon[k] + share * (polygon[n] - polygon[k]))
    return np.array(corners).reshape(-1, 3)


def is_thin(polygon: FloatArray) -> bool:
    """Return whether a polygon is thinner than the tolerance at which corners are welded."""
    if len(polygon) < 3:
        return True
    edges = np.linalg.norm(np.roll(polygon, -1, axis=0) - polygon, axis=1)
    return bool(2.0 * area_m2([polygon]) <= WELD_TOLERANCE_M * float(edges.sum()))
