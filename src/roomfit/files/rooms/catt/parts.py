"""A plane cut into its parts: what an earlier part covers is taken out of the later ones."""

from __future__ import annotations

import numpy as np

from roomfit.geometry.polygon import area_vector_m2, triangulate
from roomfit.geometry.weld import WELD_TOLERANCE_M
from roomfit.typing import FloatArray


def cut_parts(parts: list[FloatArray]) -> list[list[FloatArray]]:
    """Return what is left of each part once the earlier ones are taken out of it.

    Parameters
    ----------
    parts : list of float arrays, shape (n_corners, 3)
        Polygons in one plane, of any outline, in order of precedence.

    Returns
    -------
    list of lists of float arrays, shape (n_corners, 3)
        For each part its polygons, which turn as the part does. A part that nothing is taken out
        of comes back whole; else the pieces are convex and meet without gaps. Pieces thinner than
        the tolerance at which corners are welded are left out.

    Notes
    -----
    Both polygons are cut into triangles. What a triangle leaves of a convex piece is, for each of
    its edges in turn, the share of the piece beyond that edge and within all edges before it.
    """
    left: list[list[FloatArray]] = []
    taken: list[FloatArray] = []
    for part in parts:
        pieces = [part]
        for hole in taken:
            if any(_overlap(piece, hole) for piece in _convex(pieces)):
                pieces = [rest for piece in _convex(pieces) for rest in _without(piece, hole)]
        left.append(pieces)
        taken.extend(_triangles(part))
    return left


def area_m2(polygons: list[FloatArray]) -> float:
    """Return the sum of the areas of some polygons."""
    return float(sum(np.linalg.norm(area_vector_m2(polygon)) for polygon in polygons))


def _triangles(polygon: FloatArray) -> list[FloatArray]:
    return [polygon[corners] for corners in triangulate(polygon).triangles]


def _convex(pieces: list[FloatArray]) -> list[FloatArray]:
    return [t for piece in pieces for t in (_triangles(piece) if len(piece) > 3 else [piece])]


def _overlap(piece: FloatArray, hole: FloatArray) -> bool:
    inside = piece
    for edge in range(3):
        inside = _half(inside, *_line(hole, edge), keep_inside=True)
    return not _thin(inside)


def _without(piece: FloatArray, hole: FloatArray) -> list[FloatArray]:
    """Return the convex pieces of a convex polygon outside a triangle of the same plane."""
    if not _overlap(piece, hole):
        return [piece]
    outside: list[FloatArray] = []
    rest = piece
    for edge in range(3):
        line = _line(hole, edge)
        beyond = _half(rest, *line, keep_inside=False)
        if not _thin(beyond):
            outside.append(beyond)
        rest = _half(rest, *line, keep_inside=True)
    return outside


def _line(hole: FloatArray, edge: int) -> tuple[FloatArray, FloatArray]:
    """Return a point of one edge and the unit vector that leads away from the hole."""
    a, b = hole[edge], hole[(edge + 1) % 3]
    outwards = np.cross(b - a, area_vector_m2(hole))
    return a, outwards / np.linalg.norm(outwards)


def _half(
    polygon: FloatArray, point: FloatArray, outwards: FloatArray, *, keep_inside: bool
) -> FloatArray:
    """Clip a convex polygon at a line (Sutherland and Hodgman 1974)."""
    if not len(polygon):
        return polygon
    height = (polygon - point) @ outwards * (-1.0 if keep_inside else 1.0)
    height[np.abs(height) < 0.1 * WELD_TOLERANCE_M] = 0.0
    corners: list[FloatArray] = []
    for k in range(len(polygon)):
        n = (k + 1) % len(polygon)
        if height[k] >= 0.0:
            corners.append(polygon[k])
        if height[k] * height[n] < 0.0:
            share = height[k] / (height[k] - height[n])
            corners.append(polygon[k] + share * (polygon[n] - polygon[k]))
    return np.array(corners).reshape(-1, 3)


def _thin(polygon: FloatArray) -> bool:
    if len(polygon) < 3:
        return True
    edges = np.linalg.norm(np.roll(polygon, -1, axis=0) - polygon, axis=1)
    return bool(2.0 * area_m2([polygon]) <= WELD_TOLERANCE_M * float(edges.sum()))
