"""Reading rooms: from a specification to a checked room."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from roomfit.base.arguments import check_known
from roomfit.base.door import check_limit
from roomfit.base.errors import InputError, located
from roomfit.base.findings import Finding
from roomfit.base.polygon import WELD_TOLERANCE_M
from roomfit.base.typing import FloatArray
from roomfit.files.rooms.tables import plan_model, read_polygons
from roomfit.files.schema import RoomSpec
from roomfit.formats.catt import read_catt
from roomfit.formats.dxf import read_dxf
from roomfit.formats.ifc import read_ifc
from roomfit.formats.meshes import read_collada, read_mesh_file, read_obj, read_ply
from roomfit.formats.model import METRES_PER_UNIT, RoomModel
from roomfit.formats.roomplan import read_roomplan, read_usdz
from roomfit.formats.skp import read_skp
from roomfit.room.build import build_mesh
from roomfit.room.mesh import Mesh, as_shoebox, refuse, shoebox_mesh
from roomfit.room.scene import Room, check_mesh, room_from_mesh
from roomfit.tracing.enclosure import reached

READERS: dict[str, Callable[[Path], RoomModel]] = {
    ".obj": read_obj,
    ".ply": read_ply,
    **dict.fromkeys((".stl", ".glb"), read_mesh_file),
    ".geo": read_catt,
    ".dxf": read_dxf,
    ".dae": read_collada,
    ".ifc": read_ifc,
    ".json": read_roomplan,
    ".usdz": read_usdz,
    ".skp": read_skp,
}
_FOREIGN = {
    **dict.fromkeys((".ac", ".3ds"), "open it in Blender and save it as OBJ: names are kept"),
    ".3dm": "a model of Rhino: export it there as OBJ, with polygon meshes",
    ".poly": "facets of TetGen: write its points as lines v, its facets as lines f of an OBJ file",
}


def read_room(spec: RoomSpec, positions_m: ArrayLike = ()) -> tuple[Room, tuple[Finding, ...]]:
    """Read and check a room: the air that sound reaches, see `roomfit.tracing.enclosure.reached`.

    `positions_m`, shape (n, 3): of sources and receivers, which choose it where there are several.

    Returns
    -------
    room : Room
        In metres, z up, normals out of the air. A file's box with a corner at the origin is a
        shoebox, see `roomfit.room.mesh.as_shoebox`.
    findings : tuple of Finding
        What was repaired and what is doubtful; none is serious.

    Raises
    ------
    InputError
        The room cannot be read, or has a fault that forbids tracing it: the first one is raised,
        `roomfit check` lists them all.

    Examples
    --------
    >>> from roomfit.files.schema import RoomSpec
    >>> room, findings = read_room(RoomSpec(shoebox=(6.0, 5.0, 3.0), materials={"floor": "carpet"}))
    >>> room.materials[4], len(findings)
    ('carpet', 0)
    """
    mesh, built = read_mesh(spec, positions_m)
    findings = check_mesh(mesh, spec.materials, built).findings
    refuse(findings)
    room, box = room_from_mesh(mesh, spec.materials), as_shoebox(mesh)
    if box is None:
        return room, findings
    x, y, z = box.vertices_m[-1].tolist()
    # materials stay in the order of the file
    own = room.surface_material[[room.mesh.surfaces.index(s) for s in box.surfaces]]
    return Room(box, room.materials, own, (x, y, z)), findings


def read_mesh(spec: RoomSpec, positions_m: ArrayLike = ()) -> tuple[Mesh, tuple[Finding, ...]]:
    """Read a room as far as the faces that bound its air, see `read_room`, with findings."""
    lengths = shoebox_lengths_m(spec)
    if lengths is not None:
        with located("[room] shoebox"):
            return shoebox_mesh(lengths), ()
    model, where = read_model(spec)
    vertices_m = _in_metres(model, spec.unit, spec.up, where)
    _check_size(model, vertices_m, where)
    _check_origin(vertices_m, where)
    mesh, built = build_mesh(vertices_m, model.faces)
    mesh, found = reached(mesh, positions_m)
    return mesh, (*model.findings, *built, *found)


def shoebox_lengths_m(spec: RoomSpec) -> tuple[float, float, float] | None:
    """Return the lengths of the box along x, y and z, or None where the room is no shoebox."""
    if spec.shoebox is None:
        return None
    if spec.up not in (None, "z"):
        what = "a shoebox stands with z up"
        hint = "leave up out, and give the height last"
        raise InputError(what, found=f"up = {spec.up!r}", needed='"z"', hint=hint)
    metres = _metres_per(spec.unit or "m", "[room] unit")
    x, y, z = (float(length) * metres for length in spec.shoebox)
    return x, y, z


def read_model(spec: RoomSpec) -> tuple[RoomModel, str]:
    """Return the polygons of a room file in its own unit and axes, and its name for messages."""
    path = Path(spec.file or "")
    suffix = path.suffix.lower()
    with located(hint="correct the file there, or export it again"):
        if spec.polygons is not None:
            own = read_polygons(spec.polygons, spec.unit, spec.materials or ())
            return own, str(spec.polygons.corners[0])
        if spec.plan is not None:
            return plan_model(spec.plan, spec.height or 0.0), "[room] plan"
        if suffix not in READERS:
            hint = _FOREIGN.get(suffix, "export the room as OBJ")
            what, needed = "a room file of unknown format", f"one of {', '.join(READERS)}"
            found = repr(path.suffix)
            raise InputError(what, where=str(path), found=found, needed=needed, hint=hint)
        if spec.space is not None:
            read = read_ifc if suffix == ".ifc" else read_roomplan
            return read(path, spec.space), str(path)
        return READERS[suffix](path), str(path)


def _in_metres(model: RoomModel, unit: str | None, up: str | None, where: str) -> FloatArray:
    """Return the vertices in metres with z up, shape (n_vertices, 3).

    ``up = "y"`` maps (x, y, z) to (x, -z, y), which is a rotation: nothing is mirrored.
    """
    chosen = unit or model.unit
    if chosen is None:
        raise InputError(
            "the unit of the room file is not known",
            where=where,
            found="no unit",
            needed=f"one of {', '.join(METRES_PER_UNIT)}: this format carries none",
            hint='add unit = "m" (or --unit m) and compare the volume that is shown',
        )
    x, y, z = (model.vertices * _metres_per(chosen, where)).reshape(-1, 3).T
    return np.stack([x, -z, y] if (up or model.up) == "y" else [x, y, z], axis=1)


def _metres_per(unit: str, where: str) -> float:
    compare = "compare the volume that roomfit check shows"
    check_known("unknown unit", unit, METRES_PER_UNIT, where=where, else_try=compare)
    return METRES_PER_UNIT[unit]


def _check_size(model: RoomModel, vertices_m: FloatArray, where: str) -> None:
    """Refuse what would take minutes or gigabytes to make a mesh of."""
    check_limit("corners", len(vertices_m), where)
    check_limit("faces", len(model.faces), where)
    lengths = np.array([len(face.corners) for face in model.faces])
    check_limit("polygon_corners", int(lengths.max(initial=0)), where)
    check_limit("polygon_pairs", int((lengths[lengths > 100] ** 2).sum()), where)
    if not (np.abs(vertices_m) < 1e9).all():
        return  # which no mesh can have
    from scipy.spatial import cKDTree  # heavy, and a box needs none

    distinct = np.unique(vertices_m, axis=0)
    if len(distinct):
        tree = cKDTree(distinct)
        near = int(tree.count_neighbors(tree, WELD_TOLERANCE_M)) - len(distinct)
        check_limit("near_pairs", near, where)


def _check_origin(vertices_m: FloatArray, where: str) -> None:
    """Refuse map coordinates, which files of seven digits have rounded to millimetres or worse."""
    low, high = vertices_m.min(axis=0, initial=1e9), vertices_m.max(axis=0, initial=-1e9)
    off_m = np.linalg.norm(np.maximum(np.maximum(low, -high), 0.0)) if vertices_m.size else 0.0
    if off_m > 1e4:
        x, y, z = np.round(low)
        raise InputError(
            "the drawing stands far from its origin, as on a map",
            where=where,
            found=f"{off_m:.6g} m away, with its lowest corner at ({x:.0f}, {y:.0f}, {z:.0f}) m",
            needed="at most 10000 m",
            hint="move the drawing to its origin in the program that drew it, export it again, and "
            "take as much from all positions; or correct the unit",
        )
