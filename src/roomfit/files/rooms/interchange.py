"""COLLADA, IFC, USDZ and SketchUp: rooms that libraries of others read, in a process apart."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.base.door import check_limit, of_child, read_bytes
from roomfit.base.errors import InputError, located
from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import FloatArray
from roomfit.files.rooms.model import (
    METRES_PER_UNIT,
    Polygon,
    RoomModel,
    counted,
    damaged,
    finite,
    joined,
    unknown_space,
)
from roomfit.formats.roomplan import closed_room, part_of, thing_of
from roomfit.room.build import build_mesh
from roomfit.room.inside import is_inside
from roomfit.room.mesh import Surface, area_vector_m2, triangulate

_STEP_M = 1e-3  # from a face into the air
_NAMES = {"dae": "COLLADA", "ifc": "IFC", "usdz": "USDZ", "skp": "SketchUp"}
_INSTEAD = {
    "usdz": ", or give the scan's JSON, which needs nothing and says more",
    "skp": ", or export the model from SketchUp as COLLADA, OBJ, IFC or GLB",
}


def read_collada(path: Path) -> RoomModel:
    """Read the polygons of a COLLADA file's scene [1]_ by pycollada.

    A surface has the name of its geometry, and the file's material. The unit is that of the
    element ``unit``, m where there is none; the axis that points up that of ``up_axis``.

    Raises
    ------
    InputError
        pycollada is not installed; no COLLADA file, damaged, without faces, or with holes.

    References
    ----------
    .. [1] The Khronos Group, "COLLADA - Digital Asset Schema Release 1.4.1" (2008).
    """
    head, polygons = _polygons(path, "dae", "pycollada", "cad")
    factor = finite(str(head["unit_m"]), str(path))
    # a factor that has no name of its own is put into the corners
    unit = next((u for u, m in METRES_PER_UNIT.items() if abs(m - factor) < 1e-9), None)
    vertices, faces = joined(polygons)
    if unit is None:
        vertices, unit = vertices * factor, "m"
    if head["up"] == "X_UP":
        vertices = np.roll(vertices, -1, axis=1)
    up = "y" if head["up"] == "Y_UP" else "z"
    kinds = {str(kind): int(n) for kind, n in dict(head["ignored"]).items()}
    findings: tuple[Finding, ...] = ()
    if kinds:
        text = f"The drawing has parts that are no faces, ignored: {counted(kinds)}."
        findings = (Finding(Code.ENTITIES_IGNORED, About(), text, kinds, graded="info"),)
    return RoomModel(vertices, faces, findings, unit, up)


def read_ifc(path: Path, space: str | None = None) -> RoomModel:
    """Read a space of a building model in IFC [1]_ by ifcopenshell: metres, z up.

    Where the boundaries of the space (IfcRelSpaceBoundary) cover its body, they are the surfaces,
    with the names of walls, doors and windows, their classes as groups, and their materials, those
    of layers joined by " + ". Else the faces of the body are named by the largest boundary on
    which they lie, and what lies within another is passed over with a finding; without boundaries
    surfaces are "floor", "ceiling" and "wall".

    Parameters
    ----------
    path : Path
    space : str, optional
        Name of the space; may be left out where only one has a body.

    Raises
    ------
    InputError
        ifcopenshell is not installed; no IFC file, damaged, or without such a space.

    References
    ----------
    .. [1] ISO 16739-1:2024, "Industry Foundation Classes (IFC)".
    """
    head, polygons = _polygons(path, "ifc", "ifcopenshell", "ifc")
    owners = [str(name) for name in head["spaces"]]
    names = list(dict.fromkeys(owners))
    if space not in names if space is not None else len(names) > 1:
        with located(str(path)):
            raise unknown_space("the building model", names, space, hint="those of each IfcSpace")
    if len(owners) != len(polygons):
        raise damaged("IFC", path, "ifcopenshell gave no answer")
    chosen = space or names[0]
    own = [polygon for polygon, owner in zip(polygons, owners, strict=True) if owner == chosen]
    kinds = {str(k): int(n) for k, n in dict(head["ignored"].get(chosen, {})).items()}
    findings: tuple[Finding, ...] = ()
    if kinds:
        text = (
            f"The boundaries of the space {chosen!r} do not cover it; ignored within others are: "
            f"{counted(kinds)}."
        )
        findings = (Finding(Code.ENTITIES_IGNORED, About(), text, kinds, graded="warning"),)
    return RoomModel(*joined(own), findings, "m", "z")


def read_usdz(path: Path) -> RoomModel:
    """Read a scan by Apple's RoomPlan from its USDZ by usd-core: metres, z up.

    Walls, doors and windows are known by their names, each flat where the middle of its box is.
    See `roomfit.formats.roomplan.closed_room`.

    Raises
    ------
    InputError
        usd-core is not installed; no USDZ file, damaged, no scan, or one that does not close.
    """
    _, shapes = _polygons(path, "usdz", "usd-core", "usd")
    parts = [part_of(s.name, s.group or "", points) for points, s in shapes if s.group != "thing"]
    things = [thing_of(s.name, points) for points, s in shapes if s.group == "thing"]
    with located(str(path)):
        return closed_room(parts, None, things)


def read_skp(path: Path) -> RoomModel:
    """Read the faces of a SketchUp model by openskp: inches, z up.

    A surface has the name of its component or group, "model" outside of them, and the material
    that is painted on the side of the face which looks into the room; unpainted faces have that of
    the component. Hidden faces are of the room as well, for ceilings are hidden to look into it.

    Raises
    ------
    InputError
        openskp is not installed; no SketchUp file, damaged, or without faces.
    """
    head, painted = _polygons(path, "skp", "openskp", "skp")
    corners = [points for points, _ in painted]
    is_front = _air_before(corners)
    polygons = []
    for (points, sides), front in zip(painted, is_front, strict=True):
        # what looks into the room is painted, or else its other side
        inner, outer = sides.file_material, sides.group
        inner, outer = (inner, outer) if front else (outer, inner)
        surface = Surface(sides.name, None, inner or outer)
        polygons.append((points[::-1] if front else points, surface))
    kinds = {str(kind): int(n) for kind, n in dict(head["ignored"]).items()}
    if int(head["hidden"]):
        kinds["hidden face, taken all the same"] = int(head["hidden"])
    findings: tuple[Finding, ...] = ()
    if kinds:
        text = f"The model has parts that are hidden or no faces: {counted(kinds)}."
        findings = (Finding(Code.ENTITIES_IGNORED, About(), text, kinds, graded="info"),)
    return RoomModel(*joined(polygons), findings, "in", "z")


def _air_before(corners_in: Sequence[FloatArray]) -> list[bool]:
    """Return for each polygon whether the room lies before its front, or on neither side."""
    whole = [(points * METRES_PER_UNIT["in"], Surface("face")) for points in corners_in]
    vertices_m, faces = joined(whole)
    mesh, _ = build_mesh(vertices_m, faces)
    middles, normals = np.zeros((len(whole), 3)), np.zeros((len(whole), 3))
    for i, (points, _) in enumerate(whole):
        cut = triangulate(points)
        if len(cut.triangles):
            normal = area_vector_m2(points)
            normals[i] = normal / np.linalg.norm(normal)
            middles[i] = points[cut.triangles[0]].mean(axis=0)
    behind = is_inside(mesh, middles - _STEP_M * normals)
    before = is_inside(mesh, middles + _STEP_M * normals)
    return [bool(x) for x in before | ~behind]


def _polygons(path: Path, kind: str, library: str, extra: str) -> tuple[Any, list[Polygon]]:
    """Return what the process says of the file, and its polygons."""
    content = read_bytes(path, "room file", most="text_bytes")
    try:
        with of_child(kind, content, library) as (head, array):
            corners, each = (array(shape) for shape in head["shapes"])
            surfaces = [
                Surface(str(name), str(group) or None, str(material) or None)
                for name, group, material in head["surfaces"]
            ]
            check_limit("faces", len(each), str(path))
            return head, _cut(corners, each, surfaces)
    except ValueError as error:
        if "ModuleNotFoundError" in str(error):
            raise InputError(
                f"{path.suffix} files are read by {library}, which is not installed",
                where=str(path),
                found=f"a {path.suffix} file, and no {library}",
                needed=f"the package {library}",
                hint=f"pip install roomfit[{extra}]{_INSTEAD.get(kind, '')}",
            ) from None
        raise damaged(_NAMES[kind], path, str(error)[:300]) from error


def _cut(corners: FloatArray, each: FloatArray, surfaces: Sequence[Surface]) -> list[Polygon]:
    """Return polygons from all corners, shape (n, 3), and each one's number of corners and surface.

    Raises
    ------
    ValueError
        They do not go together.
    """
    if corners.ndim != 2 or corners.shape[1:] != (3,) or each.ndim != 2 or each.shape[1:] != (2,):
        raise ValueError("arrays of another shape than it said")
    if not (np.isfinite(corners).all() and (np.abs(corners) < 1e9).all()):
        raise ValueError("a coordinate that is not a finite number")
    numbers = each[:, 0].astype(np.int64)
    if (numbers < 1).any() or numbers.sum() != len(corners):
        raise ValueError("polygons of another number of corners than it said")
    parts = np.split(corners, np.cumsum(numbers)[:-1])
    # an index beyond is an answer that makes no sense, as `of_child` says
    return [(part, surfaces[int(number)]) for part, number in zip(parts, each[:, 1], strict=True)]
