"""A mesh whose every face has a material."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.checks import int_array, unique_names
from roomfit.errors import InputError
from roomfit.geometry.mesh import Mesh, is_double_sided, triangle_areas_m2
from roomfit.typing import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Room:
    """A closed mesh and the material of each of its surfaces.

    A material is a set of faces that share one absorption. What that absorption is, a room does
    not know.

    Attributes
    ----------
    mesh : Mesh
    materials : tuple of str
        In the order of every array with a material axis.
    surface_material : int32 array, shape (n_surfaces,)
        Index into `materials` for each of `mesh.surfaces`.
    shoebox_m : tuple of three floats or None
        Lengths in x, y, z where the room is a box with one corner at the origin, so that image
        sources can use the lattice; `mesh.surfaces` are then west (x = 0), east, south (y = 0),
        north, floor and ceiling, in that order.
    """

    mesh: Mesh
    materials: tuple[str, ...]
    surface_material: IntArray
    shoebox_m: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "materials", unique_names("material", self.materials))
        if not self.materials:
            raise InputError("a room without materials", needed="at least one material")
        owner = int_array(
            "material of each surface",
            self.surface_material,
            (len(self.mesh.surfaces),),
            low=0,
            high=len(self.materials) - 1,
        )
        object.__setattr__(self, "surface_material", owner)


def triangle_material(room: Room) -> IntArray:
    """Return the material index of every triangle, shape (n_triangles,)."""
    return np.asarray(room.surface_material[room.mesh.triangle_surface])


def material_areas_m2(room: Room) -> FloatArray:
    """Return the area of each material that sound can strike, shape (n_materials,).

    Both sides of a double-sided sheet count.
    """
    areas = triangle_areas_m2(room.mesh) * np.where(is_double_sided(room.mesh), 2.0, 1.0)
    owner = triangle_material(room)
    return np.asarray(np.bincount(owner, areas, len(room.materials)), dtype=np.float64)
