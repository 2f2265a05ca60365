"""What a room is like, and whether it can be traced."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from roomfit.findings import Finding
from roomfit.geometry.doctor import examine
from roomfit.geometry.mesh import Mesh
from roomfit.scene.rooms import material_areas, material_findings


@dataclass(frozen=True, slots=True)
class RoomCheck:
    """What a room is like.

    Attributes
    ----------
    volume_m3 : float
        Approximate where the mesh is not closed.
    surface_m2 : float
        Area that sound can strike; both sides of a sheet in the air count.
    mean_free_path_m : float
        4 V / S.
    size_m : tuple of three floats
        Of the box along x, y and z that just holds the room.
    n_triangles, n_surfaces : int
    closed : bool
    leak : float or None
        Rays lost per hit of a wall; None where no point inside was found.
    material_areas_m2 : tuple of (str or None, float)
        Largest first; None stands for surfaces without a material.
    findings : tuple of Finding
        Repairs, doubts and faults; the latter are the serious ones.
    """

    volume_m3: float
    surface_m2: float
    mean_free_path_m: float
    size_m: tuple[float, float, float]
    n_triangles: int
    n_surfaces: int
    closed: bool
    leak: float | None
    material_areas_m2: tuple[tuple[str | None, float], ...]
    findings: tuple[Finding, ...]

    @property
    def traceable(self) -> bool:
        """Whether no fault forbids tracing the room."""
        return all(finding.severity != "serious" for finding in self.findings)


def check_mesh(
    mesh: Mesh, materials: Mapping[str, str], earlier: Iterable[Finding] = ()
) -> RoomCheck:
    """Examine a mesh and its materials.

    Parameters
    ----------
    mesh : Mesh
        Oriented, see `geometry.orientation`.
    materials : mapping from str to str
        As `scene.rooms.room_from_mesh` takes it.
    earlier : iterable of Finding
        What was found on the way to this mesh; it comes first in the result.

    Raises
    ------
    InputError
        A key of `materials` matches nothing.
    """
    bare = material_findings(mesh, materials)
    examination = examine(mesh)
    x, y, z = (mesh.vertices_m.max(axis=0) - mesh.vertices_m.min(axis=0)).tolist()
    return RoomCheck(
        examination.volume_m3,
        examination.surface_m2,
        examination.mean_free_path_m,
        (x, y, z),
        len(mesh.triangles),
        len(mesh.surfaces),
        examination.closed,
        examination.leak,
        tuple(material_areas(mesh, materials).items()),
        (*earlier, *bare, *examination.findings),
    )
