"""Reading rooms: from a specification to a checked room."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from roomfit.base.arguments import check_known, did_you_mean
from roomfit.base.door import check_limit
from roomfit.base.errors import InputError, located
from roomfit.base.findings import Finding
from roomfit.base.polygon import WELD_TOLERANCE_M, area_vector_m2, triangulate
from roomfit.base.typing import FloatArray
from roomfit.files.rooms.tables import read_polygons
from roomfit.files.schema import RoomSpec
from roomfit.formats.catt import read_catt
from roomfit.formats.dxf import read_dxf
from roomfit.formats.ifc import read_ifc
from roomfit.formats.meshes import read_collada, read_mesh_file, read_obj, read_ply
from roomfit.formats.model import METRES_PER_UNIT, RoomModel, joined
from roomfit.formats.roomplan import read_roomplan, read_usdz
from roomfit.formats.skp import TwoSided, read_skp
from roomfit.room.build import build_mesh, oriented
from roomfit.room.inside import is_inside
from roomfit.room.mesh import Mesh, as_shoebox, refuse, shoebox_mesh
from roomfit.room.scene import Room, check_mesh, room_from_mesh

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
    ".skp": lambda path: _inner_sides(*read_skp(path)),
}
_GONE = dict.fromkeys((".ac", ".3ds"), "open it in Blender and save it as OBJ: names are kept")
_STEP_M = 1e-3  # from a face into the air


def read_room(spec: RoomSpec) -> tuple[Room, tuple[Finding, ...]]:
    """Read, repair and check a room.

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
    mesh, built = read_mesh(spec)
    findings = check_mesh(mesh, spec.materials, built).findings
    refuse(findings)
    room, box = room_from_mesh(mesh, spec.materials), as_shoebox(mesh)
    if box is None:
        return room, findings
    x, y, z = box.vertices_m[-1].tolist()
    # materials stay in the order of the file
    own = room.surface_material[[mesh.surfaces.index(s) for s in box.surfaces]]
    return Room(box, room.materials, own, (x, y, z)), findings


def read_mesh(spec: RoomSpec) -> tuple[Mesh, tuple[Finding, ...]]:
    """Read a room as far as its mesh, welded, triangulated and oriented, with findings."""
    lengths = shoebox_lengths_m(spec)
    if lengths is not None:
        with located("[room] shoebox"):
            return shoebox_mesh(lengths), ()
    model, where = read_model(spec)
    vertices_m = _in_metres(model, spec.unit, spec.up, where)
    _check_size(model, vertices_m, where)
    mesh, built = build_mesh(vertices_m, model.faces)
    mesh, turned = oriented(mesh)
    return mesh, (*model.findings, *built, *turned)


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
        if suffix not in READERS:
            hint = _GONE.get(suffix) or did_you_mean(suffix, READERS) or "export the room as OBJ"
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
    rings = [np.array(face.corners, dtype=np.int64) for face in model.faces]
    edges = np.concatenate([np.stack([r, np.roll(r, -1)], axis=1) for r in rings])
    edges = edges[((edges >= 0) & (edges < len(vertices_m))).all(axis=1)]
    # open: not exactly one other between the same points
    _, point = np.unique(np.round(vertices_m / WELD_TOLERANCE_M), axis=0, return_inverse=True)
    ends = np.sort(point.reshape(-1)[edges], axis=1)
    _, times = np.unique(ends, axis=0, return_counts=True)
    check_limit("open_edges", int(times[times != 2].sum()), where)


def _inner_sides(faces: Sequence[TwoSided], findings: tuple[Finding, ...]) -> RoomModel:
    """Return faces with the surface of the side which looks into the room; inches."""
    scale = METRES_PER_UNIT["in"]
    mesh, _ = build_mesh(*joined([(f.corners_in * scale, f.front) for f in faces]))
    middles, normals = np.zeros((len(faces), 3)), np.zeros((len(faces), 3))
    for i, face in enumerate(faces):
        points = face.corners_in * scale
        triangles = triangulate(points).triangles
        if len(triangles):
            normal = area_vector_m2(points)
            normals[i] = normal / np.linalg.norm(normal)
            middles[i] = points[triangles[0]].mean(axis=0)
    # air before the front, or on neither side
    is_front = is_inside(mesh, middles + _STEP_M * normals)
    is_front |= ~is_inside(mesh, middles - _STEP_M * normals)
    polygons = [
        (f.corners_in[::-1], f.front) if front else (f.corners_in, f.back)
        for f, front in zip(faces, is_front, strict=True)
    ]
    return RoomModel(*joined(polygons), findings, "in", "z")
