"""DXF drawings: faces, meshes and closed polygons, with the layer as surface and material."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.errors import InputError
from roomfit.findings import Code, Finding, Severity
from roomfit.geometry.build import Face
from roomfit.geometry.mesh import Surface
from roomfit.io.rooms.model import PARSER_ERRORS, RoomModel, finite, read_bytes

_UNITS = {1: "in", 2: "ft", 4: "mm", 5: "cm", 6: "m"}  # $INSUNITS
_DEEPEST = 20
_BODIES = ("3DSOLID", "BODY", "REGION", "ACAD_PROXY_ENTITY")
_FLAT = ("HATCH", "SOLID", "TRACE", "SPLINE", "WIPEOUT", "open LWPOLYLINE", "open POLYLINE")

Corner = tuple[float, float, float]


@dataclass(slots=True)
class _Drawing:
    """What has been read so far."""

    path: Path
    vertices: list[Corner] = field(default_factory=list)
    faces: list[Face] = field(default_factory=list)
    passed_over: Counter[str] = field(default_factory=Counter)
    hidden: Counter[str] = field(default_factory=Counter)  # faces on layers that are off


def read_dxf(path: Path) -> RoomModel:
    """Read the surfaces in the model space of a DXF file (text or binary) [1]_.

    Faces come from 3DFACE, POLYLINE (polygon and polyface meshes), MESH (at its coarsest level)
    and closed LWPOLYLINE and POLYLINE, the last two with straight edges; blocks are taken apart,
    where layer 0 means the layer of the insertion. The layer is the name and the material of a
    surface, the block its group. Entities without area (lines, texts, dimensions and so on) and
    those on layers that are off or frozen are passed over and counted in a finding. z is up; the
    unit is the one of $INSUNITS, where it is inch, foot, mm, cm or m.

    Raises
    ------
    InputError
        ezdxf is not installed; not a DXF file, cut short, without faces; or it contains surfaces
        that cannot be read: bodies of a solid modeller, extruded lines, curved outlines, missing
        blocks.

    References
    ----------
    .. [1] Autodesk, "DXF Reference" (2018).
    """
    document = _opened(path)
    drawing = _Drawing(path)
    try:
        for entity, layer, block in _taken_apart(document.modelspace(), path):
            if _is_off(document, layer):
                drawing.hidden[layer] += 1
            else:
                _add(drawing, entity, Surface(layer, block, layer))
        unit = _UNITS.get(int(document.header.get("$INSUNITS", 0)))
    except PARSER_ERRORS as error:
        raise _damaged(path, error) from error
    if not drawing.faces:
        raise InputError(
            "the room file has no faces",
            where=str(path),
            found=_counted(drawing.passed_over + drawing.hidden) or "an empty drawing",
            needed="3DFACE, polyface or MESH entities, or closed polylines, in the model space",
            hint="explode solids into faces before the export",
        )
    return RoomModel(np.array(drawing.vertices), tuple(drawing.faces), _findings(drawing), unit)


def _opened(path: Path) -> Any:
    try:
        from ezdxf.filemanagement import readfile
        from ezdxf.lldxf.const import DXFError
    except ImportError:
        raise InputError(
            "DXF files are read by ezdxf, which is not installed",
            where=str(path),
            hint="pip install roomfit[cad]",
        ) from None
    read_bytes(path)
    try:
        return readfile(path)
    except (*PARSER_ERRORS, DXFError, StopIteration) as error:
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> InputError:
    return InputError(
        "this DXF file cannot be read",
        where=str(path),
        found=f"{type(error).__name__}: {error}"[:200],
        hint="the file may be damaged or cut short: export it again",
    )


def _taken_apart(
    entities: Any, path: Path, layer: str | None = None, block: str | None = None, depth: int = 0
) -> Iterator[tuple[Any, str, str | None]]:
    """Yield every entity with its layer and block, those of inserted blocks transformed."""
    if depth > _DEEPEST:
        raise InputError("blocks are inserted into each other", where=str(path), found=block)
    for entity in entities:
        own = str(entity.dxf.layer)
        own = layer if own == "0" and layer is not None else own
        if entity.dxftype() != "INSERT":
            yield entity, own, block
            continue
        name = str(entity.dxf.name)
        definition = entity.block()
        if definition is None or definition.block.is_xref:
            raise InputError(
                "a block of the drawing is not in the file",
                where=str(path),
                found=name,
                hint="bind external references before the export",
            )
        inserts = entity.multi_insert() if entity.mcount > 1 else (entity,)
        for insert in inserts:
            inner = _exploded(insert, f"{path}, block {name!r}")
            yield from _taken_apart(inner, path, own, name, depth + 1)


def _exploded(insert: Any, where: str) -> list[Any]:
    lost: list[str] = []

    def note(entity: Any, reason: str) -> None:
        lost.append(f"{entity.dxftype()}: {reason}")

    entities = list(insert.virtual_entities(skipped_entity_callback=note))
    if lost:
        raise InputError(
            "a block of the drawing cannot be taken apart",
            where=where,
            found=lost[0],
            hint="explode it in the drawing program",
        )
    return entities


def _is_off(document: Any, layer: str) -> bool:
    if layer not in document.layers:
        return False
    entry = document.layers.get(layer)
    return bool(entry.is_off() or entry.is_frozen())


def _add(drawing: _Drawing, entity: Any, surface: Surface) -> None:
    """Add the faces of one entity, or count it as one without."""
    kind = str(entity.dxftype())
    where = f"{drawing.path}, {kind} on layer {surface.name!r} (handle {entity.dxf.handle})"
    if kind in _BODIES or kind.endswith("SURFACE"):
        raise _unreadable(where, "a body of a solid modeller, which has no faces in the file")
    if entity.dxf.hasattr("thickness") and entity.dxf.thickness:
        raise _unreadable(where, "a thickness: walls extruded from a line")
    polygons = _polygons(entity, kind, where)
    if polygons is None:
        drawing.passed_over[f"open {kind}" if kind.endswith("POLYLINE") else kind] += 1
        return
    for polygon in polygons:
        first = len(drawing.vertices)
        for point in polygon:
            x, y, z = (finite(str(float(value)), where) for value in point)
            drawing.vertices.append((x, y, z))
        drawing.faces.append(Face(tuple(range(first, len(drawing.vertices))), surface))


def _unreadable(where: str, found: str) -> InputError:
    return InputError(
        "a surface of the drawing cannot be read",
        where=where,
        found=found,
        needed="3DFACE, polyface or MESH entities, or closed polylines with straight edges",
        hint="explode it, or turn it into a mesh, before the export",
    )


def _polygons(entity: Any, kind: str, where: str) -> list[list[Any]] | None:
    """Return the polygons of an entity, None where it has no area."""
    if kind == "3DFACE":
        return [list(entity.wcs_vertices())]
    if kind == "MESH":
        return _mesh_polygons(list(entity.vertices), list(entity.faces), where)
    if (kind == "POLYLINE" and entity.is_poly_face_mesh) or (
        kind == "POLYLINE" and entity.is_polygon_mesh
    ):
        from ezdxf.render.mesh import MeshBuilder

        mesh = MeshBuilder.from_polyface(entity)
        return _mesh_polygons(list(mesh.vertices), list(mesh.faces), where)
    if kind == "LWPOLYLINE":
        points, closed = list(entity.vertices_in_wcs()), bool(entity.closed)
    elif kind == "POLYLINE":
        points, closed = list(entity.points_in_wcs()), bool(entity.is_closed)
    else:
        return None
    if len(points) > 3 and points[0].isclose(points[-1]):
        points, closed = points[:-1], True
    if not closed or len(points) < 3:
        return None
    if entity.has_arc:
        raise _unreadable(where, "a polygon with curved edges")
    return [points]


def _mesh_polygons(vertices: list[Any], faces: list[Any], where: str) -> list[list[Any]]:
    for face in faces:
        for corner in face:
            if not 0 <= corner < len(vertices):
                raise InputError(
                    "a face names a corner that does not exist",
                    where=where,
                    found=f"corner {corner}",
                    needed=f"0 to {len(vertices) - 1}",
                )
    return [[vertices[corner] for corner in face] for face in faces]


def _findings(drawing: _Drawing) -> tuple[Finding, ...]:
    found = []
    over, hidden = drawing.passed_over, drawing.hidden
    if over:
        graded: Severity = "warning" if any(kind in _FLAT for kind in over) else "info"
        text = f"The drawing has entities that are no faces, ignored: {_counted(over)}."
        found.append(Finding(Code.ENTITIES_IGNORED, text, dict(over), graded=graded))
    if hidden:
        text = f"Entities on layers that are off or frozen were passed over: {_counted(hidden)}."
        found.append(Finding(Code.LAYERS_IGNORED, text, dict(hidden)))
    return tuple(found)


def _counted(kinds: Counter[str]) -> str:
    return ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))
