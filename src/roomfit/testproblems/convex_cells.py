"""A convex room of a campaign as one cell of the simulator that mirrors rooms."""

from __future__ import annotations

import numpy as np

from roomfit.geometry.mesh import area_vectors_m2, corners_m, is_double_sided
from roomfit.scene.room import Room, triangle_material
from roomfit.testproblems.polyhedron_cells import CellFace, Cells
from roomfit.typing import FloatArray, IntArray

_FLAT_M = 1e-3
_ALIKE = 1e-6


def convex_cells(room: Room) -> Cells | None:
    """Return the room as one convex cell; None where it is not convex or holds sheets.

    A flat wall of one material is one face; a wall of several keeps its triangles.
    """
    if bool(is_double_sided(room.mesh).any()):
        return None
    vectors = area_vectors_m2(room.mesh)
    normals = vectors / np.linalg.norm(vectors, axis=1)[:, None]
    first = corners_m(room.mesh)[:, 0]
    offsets = np.einsum("ij,ij->i", normals, first)
    if np.max(room.mesh.vertices_m @ normals.T - offsets) > _FLAT_M:
        return None
    owner = triangle_material(room)
    faces: list[CellFace] = []
    for plane in _planes(normals, offsets):
        triangles = [tuple(int(v) for v in room.mesh.triangles[t]) for t in plane]
        materials = {int(owner[t]) for t in plane}
        if len(materials) > 1 or len(plane) == 1:
            faces += [CellFace(0, t, int(owner[i])) for t, i in zip(triangles, plane, strict=True)]
            continue
        corners = np.unique(np.concatenate([np.array(t) for t in triangles]))
        outline = _outline(room.mesh.vertices_m, corners, normals[plane[0]])
        faces.append(CellFace(0, outline, materials.pop()))
    return Cells(room.mesh.vertices_m, tuple(faces), room.materials)


def _planes(normals: FloatArray, offsets: FloatArray) -> list[list[int]]:
    """Return the triangles of each plane."""
    planes: list[list[int]] = []
    for t in range(len(normals)):
        for plane in planes:
            same = float(normals[t] @ normals[plane[0]]) > 1.0 - _ALIKE
            if same and abs(offsets[t] - offsets[plane[0]]) < _FLAT_M:
                plane.append(t)
                break
        else:
            planes.append([t])
    return planes


def _outline(vertices_m: FloatArray, corners: IntArray, normal: FloatArray) -> tuple[int, ...]:
    """Return corners of a convex polygon, counter-clockwise when looked at against the normal."""
    middle = vertices_m[corners].mean(axis=0)
    across = vertices_m[corners[0]] - middle
    across = across / np.linalg.norm(across)
    along = np.cross(normal, across)
    steps = vertices_m[corners] - middle
    order = np.argsort(np.arctan2(steps @ along, steps @ across))
    return tuple(int(c) for c in corners[order])
