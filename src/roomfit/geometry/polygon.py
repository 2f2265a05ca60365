"""Flat polygons with any outline: their plane, their area and their triangles."""

from __future__ import annotations

from dataclasses import dataclass

import mapbox_earcut
import numpy as np

from roomfit.typing import FloatArray, IntArray

_NO_AREA = 1e-12  # of the squared perimeter: what rounding leaves of a polygon without area


@dataclass(frozen=True, slots=True, eq=False)
class Triangulation:
    """The triangles of one polygon.

    Attributes
    ----------
    triangles : int array, shape (n_triangles, 3)
        Indices into the polygon's corners, turning as the polygon does. Empty where it has no area.
    area_m2 : float
        Area of the polygon seen along its normal.
    off_plane_m : float
        Largest distance of a corner from the best plane.
    crosses_itself : bool
        The triangles do not cover the polygon's area: its outline is no simple one.
    """

    triangles: IntArray
    area_m2: float
    off_plane_m: float
    crosses_itself: bool


def area_vector_m2(corners_m: FloatArray) -> FloatArray:
    """Return normal times area of a polygon, shape (3,), by Newell's sum over its edges.

    Counter-clockwise corners give a vector that points to the viewer. Exact for flat polygons of
    any outline; the area of a warped one is that of its shadow along the mean normal.

    Parameters
    ----------
    corners_m : float array, shape (n_corners, 3)
    """
    from_first = corners_m - corners_m[0]
    return np.asarray(0.5 * np.cross(from_first, np.roll(from_first, -1, axis=0)).sum(axis=0))


def triangulate(corners_m: FloatArray) -> Triangulation:
    """Cut a polygon into triangles with the ear-cutting method.

    The polygon may be concave, hold corners that stand on a straight line, or the same corner
    twice. A fan from the first corner, as many readers cut it, would cover the notch of an
    L-shaped floor.

    Parameters
    ----------
    corners_m : float array, shape (n_corners, 3)
        In order around the polygon, the last one not repeating the first.
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
    flat = np.ascontiguousarray(from_middle @ _plane_axes(normal).T)
    ring = np.array([len(flat)], dtype=np.uint32)
    cut = mapbox_earcut.triangulate_float64(flat, ring).astype(np.int64).reshape(-1, 3)
    twice = _twice_areas(flat, cut)
    cut[twice < 0.0] = cut[twice < 0.0][:, ::-1]
    covered = 0.5 * float(np.abs(twice).sum())
    triangles = cut[np.abs(twice) > _NO_AREA * perimeter**2]
    return Triangulation(triangles, area, off_plane, abs(covered - area) > 1e-6 * area)


def _plane_axes(normal: FloatArray) -> FloatArray:
    """Return two unit vectors that with the normal form a right-handed frame, shape (2, 3)."""
    helper = np.zeros(3)
    helper[np.argmin(np.abs(normal))] = 1.0
    u = np.cross(helper, normal)
    u /= np.linalg.norm(u)
    return np.array([u, np.cross(normal, u)])


def _twice_areas(flat: FloatArray, triangles: IntArray) -> FloatArray:
    a, b, c = (flat[triangles[:, k]] for k in range(3))
    ab, ac = b - a, c - a
    return np.asarray(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
