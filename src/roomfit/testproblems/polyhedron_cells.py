"""Rooms of flat walls as convex cells that open into one another, for simulated measurements."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from roomfit.typing import FloatArray, IntArray


class CellFace(NamedTuple):
    """A convex polygon of a cell's surface.

    Attributes
    ----------
    cell : int
    corners : tuple of int
        Counter-clockwise when looked at from outside the cell.
    material : int
        -1 for an opening.
    beyond : int
        The cell behind an opening, else -1.
    """

    cell: int
    corners: tuple[int, ...]
    material: int
    beyond: int = -1


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """A room cut into convex cells; a convex room is one of them.

    Attributes
    ----------
    vertices_m : float array, shape (n_vertices, 3)
    faces : tuple of CellFace
        In the order of their cells.
    materials : tuple of str
    """

    vertices_m: FloatArray
    faces: tuple[CellFace, ...]
    materials: tuple[str, ...]

    def __post_init__(self) -> None:
        vertices = np.array(self.vertices_m, dtype=np.float64)
        vertices.setflags(write=False)
        object.__setattr__(self, "vertices_m", vertices)


class CellArrays(NamedTuple):
    """The same as arrays, for compiled code.

    Attributes
    ----------
    first_face : int64 array, shape (n_cells + 1,)
    normal : float array, shape (n_faces, 3)
        Unit normals out of the cell.
    offset_m : float array, shape (n_faces,)
    first_corner : int64 array, shape (n_faces + 1,)
    corner_m : float array, shape (n_corners, 3)
    material, beyond : int64 arrays, shape (n_faces,)
    """

    first_face: IntArray
    normal: FloatArray
    offset_m: FloatArray
    first_corner: IntArray
    corner_m: FloatArray
    material: IntArray
    beyond: IntArray


def cell_arrays(cells: Cells) -> CellArrays:
    """Return planes and corners of every face."""
    owner = np.array([face.cell for face in cells.faces])
    corners = [cells.vertices_m[list(face.corners)] for face in cells.faces]
    normals = np.array([plane_of(c)[0] for c in corners])
    offsets = np.array([plane_of(c)[1] for c in corners])
    counts = [len(c) for c in corners]
    return CellArrays(
        np.searchsorted(owner, np.arange(owner.max() + 2)).astype(np.int64),
        normals,
        offsets,
        np.concatenate(([0], np.cumsum(counts))).astype(np.int64),
        np.concatenate(corners),
        np.array([face.material for face in cells.faces], dtype=np.int64),
        np.array([face.beyond for face in cells.faces], dtype=np.int64),
    )


def plane_of(corners_m: FloatArray) -> tuple[FloatArray, float]:
    """Return unit normal and offset of a flat polygon (M. E. Newell's sum over its edges)."""
    following = np.roll(corners_m, -1, axis=0)
    vector = np.cross(corners_m, following).sum(axis=0)
    normal = vector / np.linalg.norm(vector)
    return normal, float(np.mean(corners_m @ normal))


def cell_volume_m3(cells: Cells) -> float:
    """Return the volume: a third of area times height over the origin, summed over the walls."""
    total = 0.0
    for face in cells.faces:
        corners = cells.vertices_m[list(face.corners)]
        vector = 0.5 * np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0)
        total += float(vector @ corners[0]) / 3.0
    return total


def with_moved_planes(cells: Cells, shift_m: FloatArray) -> Cells:
    """Return a room with each wall's plane moved outwards, for convex rooms.

    Every corner goes to where the planes of its three faces meet now.

    Parameters
    ----------
    cells : Cells
        One cell with three faces at every corner.
    shift_m : float array, shape (n_faces,)
    """
    arrays = cell_arrays(cells)
    moved = np.empty_like(cells.vertices_m)
    for v in range(len(moved)):
        own = [i for i, face in enumerate(cells.faces) if v in face.corners]
        offsets = arrays.offset_m[own] + shift_m[own]
        moved[v] = np.linalg.solve(arrays.normal[own], offsets)
    return Cells(moved, cells.faces, cells.materials)


def obj_text(cells: Cells) -> str:
    """Return the walls as Wavefront OBJ, metres and z up, with a `usemtl` for each material."""
    lines = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in cells.vertices_m]
    for number, face in enumerate(cells.faces):
        if face.material >= 0:
            name = cells.materials[face.material]
            lines += [f"o {name}_{number}", f"usemtl {name}"]
            lines.append("f " + " ".join(str(c + 1) for c in face.corners))
    return "\n".join(lines) + "\n"
