"""A room from tables of corners and planes: which planes hold, and what the tables doubt."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from roomfit.checks import nearest
from roomfit.errors import InputError
from roomfit.files.rooms.model import METRES_PER_UNIT, RoomModel
from roomfit.files.rooms.spec import PolygonSpec
from roomfit.files.rooms.tables import Plane, read_corners, read_planes
from roomfit.findings import Finding
from roomfit.geometry.build import Face
from roomfit.geometry.mesh import Surface
from roomfit.geometry.polygon import area_vector_m2
from roomfit.typing import FloatArray

_AREA_DISAGREES = 0.02
_SHOWN = 5

Corners = dict[str, tuple[float, float, float]]


def read_polygons(tables: PolygonSpec, unit: str | None = None) -> RoomModel:
    """Read a room from tables.

    The name of a surface is its plane's number, its group the plane's description.

    Parameters
    ----------
    tables : PolygonSpec
    unit : str, optional
        Unit of the corners, for comparing areas with those that the table states in m2.

    Raises
    ------
    InputError
        A table cannot be read, a plane to drop or replace is not there, or a plane names a corner
        that does not exist.
    """
    corners, moved = _merged_corners(tables.corners)
    planes, replaced = _chosen_planes(tables)
    index = {number: i for i, number in enumerate(corners)}
    vertices = np.array(list(corners.values()))
    faces = []
    for plane in planes.values():
        sides = tables.sides.get(plane.number, 2 if plane.double_sided else 1)
        surface = Surface(plane.number, plane.description, plane.material, sides == 2)
        faces.append(Face(_indices(plane, index), surface))
    scale = METRES_PER_UNIT.get(unit or "m", 1.0)
    areas = _areas_m2(vertices * scale, faces)
    findings = (*moved, *replaced, *_area_findings(planes, areas), *_alike(planes))
    return RoomModel(vertices, tuple(faces), findings, "m", "z")


def _merged_corners(paths: tuple[Path, ...]) -> tuple[Corners, list[Finding]]:
    corners: Corners = {}
    moved: dict[str, float] = {}
    for path in paths:
        for number, point in read_corners(path).items():
            if point != corners.get(number, point):
                moved[number] = float(np.linalg.norm(np.subtract(point, corners[number])))
            corners[number] = point
    if not moved:
        return corners, []
    text = (
        f"{len(moved)} corners differ between the tables, by up to {max(moved.values()):.3g}; the "
        f"last table holds: {_some(list(moved))}."
    )
    return corners, [Finding("corners-differ", "info", text, {"moved": moved})]


def _chosen_planes(tables: PolygonSpec) -> tuple[dict[str, Plane], list[Finding]]:
    planes: dict[str, Plane] = {}
    findings: list[Finding] = []
    for path in tables.planes:
        found = read_planes(path)
        twice = [number for number in found if number in planes]
        if twice:
            text = f"{len(twice)} planes of {path.name} replace earlier ones: {_some(twice)}."
            findings.append(Finding("planes-replaced", "info", text, {"planes": twice}))
        planes.update(found)
    drop = [str(number) for number in tables.drop]
    _check_known("drop", drop, planes)
    _check_known("replace", tables.replace, planes)
    _check_known("sides", tables.sides, planes)
    for number in drop:
        planes.pop(number, None)
    for number, path in tables.replace.items():
        planes.pop(number, None)
        for plane in read_planes(path).values():
            if plane.number in planes:
                raise InputError(
                    "a plane is there already",
                    where=plane.where,
                    found=f"plane {plane.number}",
                    hint="number it differently, or drop the other one",
                )
            planes[plane.number] = plane
    return planes, findings


def _check_known(key: str, numbers: Mapping[str, object] | list[str], planes: object) -> None:
    known = planes if isinstance(planes, dict) else {}
    for number in numbers:
        if number not in known:
            like = nearest(number, known)
            raise InputError(
                "no plane has this number",
                where=f"polygons, {key}",
                found=number,
                needed="a number from the first column of the plane tables",
                hint=f"did you mean {like}?" if like else None,
            )


def _indices(plane: Plane, index: Mapping[str, int]) -> tuple[int, ...]:
    for corner in plane.corners:
        if corner not in index:
            raise InputError(
                "a plane names a corner that does not exist",
                where=plane.where,
                found=f"corner {corner} in plane {plane.number}",
                needed="a corner of the corner tables",
                hint="add the corner table that holds it",
            )
    return tuple(index[corner] for corner in plane.corners)


def _areas_m2(vertices_m: FloatArray, faces: list[Face]) -> list[float]:
    return [float(np.linalg.norm(area_vector_m2(vertices_m[list(f.corners)]))) for f in faces]


def _area_findings(planes: Mapping[str, Plane], areas: list[float]) -> list[Finding]:
    """Compare with the stated areas, allowing for their two decimals."""
    wrong = {
        plane.number: (plane.stated_area_m2, area)
        for plane, area in zip(planes.values(), areas, strict=True)
        if plane.stated_area_m2 is not None
        and abs(plane.stated_area_m2 - area) > max(_AREA_DISAGREES * area, 0.02)
    }
    if not wrong:
        return []
    told = [
        f"plane {n}: {stated:g} m2 stated, {area:.2f} m2" for n, (stated, area) in wrong.items()
    ]
    text = f"{len(wrong)} stated areas disagree with the corners, which hold: {_some(told)}."
    return [Finding("stated-area-disagrees", "warning", text, {"planes": wrong})]


def _alike(planes: Mapping[str, Plane]) -> list[Finding]:
    """Tell of material names that differ in blanks, underscores, case or a plural s only."""
    families: dict[str, set[str]] = {}
    for plane in planes.values():
        if plane.material:
            plain = "".join(c for c in plane.material.lower() if c not in " _-").rstrip("s")
            families.setdefault(plain, set()).add(plane.material)
    alike = [sorted(names) for names in families.values() if len(names) > 1]
    return [
        Finding(
            "materials-look-alike",
            "warning",
            f"The materials {' and '.join(map(repr, names))} differ in spelling only and are kept "
            "apart; give them one name in [room.materials] if they are one.",
            {"materials": names},
        )
        for names in alike
    ]


def _some(items: list[str]) -> str:
    more = f" and {len(items) - _SHOWN} more" if len(items) > _SHOWN else ""
    return ", ".join(items[:_SHOWN]) + more
