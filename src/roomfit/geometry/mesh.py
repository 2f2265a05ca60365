"""The surface of a room as triangles that remember where they came from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.checks import float_array, int_array
from roomfit.errors import InputError
from roomfit.typing import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Surface:
    """The faces of a file that share a name, a group and a material.

    Attributes
    ----------
    name : str
        Name of the surface, object or plane in the file; "west", "floor", ... for a shoebox.
    group : str or None
        Group in the file, where it has groups.
    file_material : str or None
        Material that the file gives.
    double_sided : bool
        A sheet that stands in the air and reflects on both sides, such as a curtain. It does not
        enclose anything, so it is left out of volume and closure checks; its area counts twice.
    """

    name: str
    group: str | None = None
    file_material: str | None = None
    double_sided: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles in metres, z up, normals pointing out of the air (so a room has volume > 0).

    Attributes
    ----------
    vertices_m : float array, shape (n_vertices, 3)
    triangles : int32 array, shape (n_triangles, 3)
        Indices of the corners, counter-clockwise when looked at from outside the room.
    triangle_surface : int32 array, shape (n_triangles,)
        Index into `surfaces`.
    surfaces : tuple of Surface
    """

    vertices_m: FloatArray
    triangles: IntArray
    triangle_surface: IntArray
    surfaces: tuple[Surface, ...]

    def __post_init__(self) -> None:
        vertices = float_array("vertices", self.vertices_m, (None, 3), low=-1e6, high=1e6, unit="m")
        triangles = int_array("triangles", self.triangles, (None, 3), low=0, high=len(vertices) - 1)
        if len(triangles) == 0:
            raise InputError("a mesh without faces", needed="at least one triangle")
        owner = int_array(
            "surface of each triangle",
            self.triangle_surface,
            (len(triangles),),
            low=0,
            high=len(self.surfaces) - 1,
        )
        object.__setattr__(self, "vertices_m", vertices)
        object.__setattr__(self, "triangles", triangles)
        object.__setattr__(self, "triangle_surface", owner)
        object.__setattr__(self, "surfaces", tuple(self.surfaces))


def corners_m(mesh: Mesh) -> FloatArray:
    """Return the corners of every triangle, shape (n_triangles, 3 corners, 3)."""
    return np.asarray(mesh.vertices_m[mesh.triangles])


def area_vectors_m2(mesh: Mesh) -> FloatArray:
    """Return normal times area of every triangle, shape (n_triangles, 3); it points outwards."""
    a, b, c = np.moveaxis(corners_m(mesh), 1, 0)
    return np.asarray(0.5 * np.cross(b - a, c - a))


def triangle_areas_m2(mesh: Mesh) -> FloatArray:
    """Return the area of one side of every triangle, shape (n_triangles,)."""
    return np.asarray(np.linalg.norm(area_vectors_m2(mesh), axis=1))


def is_double_sided(mesh: Mesh) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return for every triangle whether it is a double-sided sheet, shape (n_triangles,)."""
    flags = np.array([s.double_sided for s in mesh.surfaces], dtype=np.bool_)
    return np.asarray(flags[mesh.triangle_surface])
