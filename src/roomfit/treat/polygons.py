"""Areas on a surface that must stay as they are, given by their corners."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray
from roomfit.room.mesh import corners_m
from roomfit.room.scene import Room, triangle_material

_OFF_PLANE_M = 0.02  # how far a corner may lie before or behind its wall
_ROUNDING = 1e-3  # of an area


def forbidden_area_m2(room: Room, material: str, polygons: Sequence[FloatArray]) -> float:
    """Return the area that polygons cover of the surfaces of a material.

    Shapes: `polygons` (n_corners, 3).
    """
    if material not in room.materials:
        return 0.0
    own = triangle_material(room) == room.materials.index(material)
    triangles = corners_m(room.mesh)[own]
    for number, polygon in enumerate(polygons, start=1):
        _check(polygon, triangles, number)
    for (i, a), (j, b) in combinations(enumerate(polygons, start=1), 2):
        fan = np.stack([b[[0, k, k + 1]] for k in range(1, len(b) - 1)])
        common = abs(_common_m2(a, fan, signed=True))
        if common > _ROUNDING * min(_area_m2(a), _area_m2(b)):
            raise InputError(
                "two forbidden areas overlap",
                found=f"{common:.3g} m2 are in polygon {i} and in polygon {j}",
                needed="each piece of the surface once",
                hint="join the two into one polygon",
            )
    return float(sum(map(_area_m2, polygons)))


def _check(polygon: FloatArray, triangles: FloatArray, number: int) -> None:
    area = _area_m2(polygon)
    if area < 1e-6 or _crosses_itself(polygon):
        raise InputError(
            "a forbidden area is no polygon",
            where=f"polygon {number}",
            found="edges that cross, or no area",
            needed="corners in the order in which they lie around it",
            hint="list the corners along its edge",
        )
    inside = _common_m2(polygon, triangles, signed=False)
    if inside < (1.0 - _ROUNDING) * area:
        raise InputError(
            "a forbidden area does not lie on its surface",
            where=f"polygon {number}",
            found=f"{inside:.3g} of its {area:.3g} m2 do",
            needed=f"corners on one wall of the material, within {100 * _OFF_PLANE_M:g} cm",
            hint="take the corners from the room, in m",
        )


def _vector_m2(polygon: FloatArray) -> FloatArray:
    """Return the area of a plane polygon along its normal, shape (3,)."""
    arms = polygon - polygon[0]
    return np.asarray(0.5 * np.cross(arms, np.roll(arms, -1, axis=0)).sum(axis=0))


def _area_m2(polygon: FloatArray) -> float:
    return float(np.linalg.norm(_vector_m2(polygon)))


def _common_m2(polygon: FloatArray, triangles: FloatArray, *, signed: bool) -> float:
    """Return the area of a polygon within triangles of its plane, shape (n, 3 corners, 3).

    Signed, triangles that turn the other way count negative: as a fan they make up any polygon,
    hollow ones too.
    """
    normal = _vector_m2(polygon) / _area_m2(polygon)
    total = 0.0
    for triangle in triangles:
        across = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
        faces = float(across @ normal) > 0.0
        way, upright = (1.0, triangle) if faces else (-1.0, triangle[::-1])
        height, size = (polygon - triangle[0]) @ across, np.linalg.norm(across)
        if size < 1e-12 or np.any(np.abs(height) > _OFF_PLANE_M * size):
            continue
        left = polygon
        for begin, end in zip(upright, np.roll(upright, -1, axis=0), strict=True):
            left = _on_the_left(left, begin, np.cross(normal, end - begin))
        if len(left) > 2:
            total += (way if signed else 1.0) * abs(float(_vector_m2(left) @ normal))
    return total


def _on_the_left(polygon: FloatArray, begin: FloatArray, inwards: FloatArray) -> FloatArray:
    """Return what of a polygon lies on one side of a line, after Sutherland and Hodgman (1974)."""
    side = (polygon - begin) @ inwards if len(polygon) else np.zeros(0)
    kept: list[FloatArray] = []
    for k in range(len(polygon)):
        here, there = side[k - 1], side[k]
        if (here >= 0.0) != (there >= 0.0):
            kept.append(polygon[k - 1] + here / (here - there) * (polygon[k] - polygon[k - 1]))
        if there >= 0.0:
            kept.append(polygon[k])
    return np.array(kept).reshape(-1, 3)


def _crosses_itself(polygon: FloatArray) -> bool:
    normal, n = _vector_m2(polygon), len(polygon)

    def side(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
        return float(np.cross(b - a, c - a) @ normal)

    for i, j in combinations(range(n), 2):
        if (i + 1) % n == j or (j + 1) % n == i:
            continue
        a, b, c, d = (polygon[k % n] for k in (i, i + 1, j, j + 1))
        if side(a, b, c) * side(a, b, d) < 0.0 and side(c, d, a) * side(c, d, b) < 0.0:
            return True
    return False
