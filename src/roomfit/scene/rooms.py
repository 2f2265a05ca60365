"""Which material each surface of a mesh has."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from roomfit.checks import nearest
from roomfit.errors import InputError
from roomfit.findings import Finding
from roomfit.geometry.faults import fault, place, refuse
from roomfit.geometry.mesh import Mesh, Surface, corners_m, is_double_sided, triangle_areas_m2
from roomfit.scene.room import Room

_SHOWN = 12


def room_from_mesh(
    mesh: Mesh,
    materials: Mapping[str, str],
    shoebox_m: tuple[float, float, float] | None = None,
) -> Room:
    """Give every surface its material.

    Parameters
    ----------
    mesh : Mesh
    materials : mapping from str to str
        From the name of a surface, a group or a file's material, in that precedence, to a
        material. What is not named keeps the file's material name.
    shoebox_m : tuple of three floats, optional
        Lengths, where the mesh is the box of `geometry.shoebox`.

    Returns
    -------
    Room
        Materials in the order of their first surface.

    Raises
    ------
    InputError
        A key matches nothing, or a surface has no material.
    """
    refuse(material_findings(mesh, materials))
    names = [str(name) for name in surface_materials(mesh.surfaces, materials)]
    order = tuple(dict.fromkeys(names))
    return Room(mesh, order, np.array([order.index(n) for n in names]), shoebox_m)


def surface_materials(
    surfaces: Iterable[Surface], materials: Mapping[str, str]
) -> tuple[str | None, ...]:
    """Return the material of every surface, None where neither the mapping nor the file has one."""
    return tuple(_material_of(surface, materials) for surface in surfaces)


def _material_of(surface: Surface, materials: Mapping[str, str]) -> str | None:
    for key in (surface.name, surface.group, surface.file_material):
        if key is not None and key in materials:
            return materials[key]
    return surface.file_material


def material_findings(mesh: Mesh, materials: Mapping[str, str]) -> tuple[Finding, ...]:
    """Return a fault for surfaces without a material.

    Raises
    ------
    InputError
        A key matches no surface, group or material of the file; the names are listed.
    """
    _check_keys(mesh.surfaces, materials)
    found = surface_materials(mesh.surfaces, materials)
    bare = np.array([not name for name in found])[mesh.triangle_surface]
    if not bare.any():
        return ()
    first = int(np.flatnonzero(bare)[0])
    name = mesh.surfaces[mesh.triangle_surface[first]].name
    area = float(triangle_areas_m2(mesh)[bare].sum())
    return (
        fault(
            "no-material",
            "surfaces without a material",
            where=f"{name!r} near {place(corners_m(mesh)[first].mean(axis=0))}",
            found=f"{sum(not n for n in found)} surfaces, {area:.2f} m2",
            needed="a material for every face",
            hint=f'name it in [room.materials], as in "{name}" = "plaster"',
        ),
    )


def material_areas(mesh: Mesh, materials: Mapping[str, str]) -> dict[str | None, float]:
    """Return the area in m2 of each material that sound can strike, largest first.

    The key None stands for surfaces without a material. Both sides of a sheet count.
    """
    areas = triangle_areas_m2(mesh) * np.where(is_double_sided(mesh), 2.0, 1.0)
    per_surface = np.bincount(mesh.triangle_surface, areas, len(mesh.surfaces))
    total: dict[str | None, float] = {}
    for name, area in zip(surface_materials(mesh.surfaces, materials), per_surface, strict=True):
        total[name] = total.get(name, 0.0) + float(area)
    return dict(sorted(total.items(), key=lambda item: -item[1]))


def _check_keys(surfaces: Iterable[Surface], materials: Mapping[str, str]) -> None:
    names = [n for s in surfaces for n in (s.name, s.group, s.file_material) if n]
    known = list(dict.fromkeys(names))
    for key, material in materials.items():
        if not material:
            raise InputError("a material without a name", where=f"[room.materials] {key!r}")
        if key in known:
            continue
        like = nearest(key, known)
        listing = ", ".join(repr(name) for name in known[:_SHOWN])
        more = f" and {len(known) - _SHOWN} more" if len(known) > _SHOWN else ""
        raise InputError(
            "a material is given to a surface that does not exist",
            where="[room.materials]",
            found=repr(key),
            needed=f"a surface, group or material of the file: {listing}{more}",
            hint=f"did you mean {like!r}?" if like else None,
        )
