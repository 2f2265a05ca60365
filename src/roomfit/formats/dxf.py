"""DXF drawings: faces, meshes and closed polygons, with the layer as surface and material."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.base.door import check_limit, quiet, read_bytes
from roomfit.base.errors import DAMAGE, InputError
from roomfit.base.findings import About, Code, Finding, Severity
from roomfit.base.polygon import Surface
from roomfit.formats.model import (
    Polygon,
    RoomModel,
    counted,
    damaged,
    finite,
    ignored,
    joined,
    malformed,
    no_faces,
)

_UNITS = {1: "in", 2: "ft", 4: "mm", 5: "cm", 6: "m"}  # $INSUNITS
_DEEPEST = 20
_BODIES = ("3DSOLID", "BODY", "REGION", "ACAD_PROXY_ENTITY")
_FLAT = ("HATCH", "SOLID", "TRACE", "SPLINE", "WIPEOUT", "open LWPOLYLINE", "open POLYLINE")


def read_dxf(path: Path) -> RoomModel:
    """Read the surfaces in the model space of a DXF file (text or binary) [1]_.

    Faces come from 3DFACE, POLYLINE (polygon and polyface meshes), MESH (at its coarsest level)
    and closed LWPOLYLINE and POLYLINE, the last two with straight edges; blocks are taken apart,
    where layer 0 means the layer of the insertion. The layer is the name and the material of a
    surface, the block its group. Entities without area (lines, texts, dimensions and so on) and
    those on layers that are off or frozen are passed over and counted in a finding. z is up; the
    unit is the one of $INSUNITS, where it is inch, foot, mm, cm or m.

    References
    ----------
    .. [1] Autodesk, "DXF Reference" (2018).
    """
    with quiet("ezdxf"):
        return _room(_opened(path), path)


def _room(document: Any, path: Path) -> RoomModel:
    polygons: list[Polygon] = []
    unread: Counter[str] = Counter()
    hidden: Counter[str] = Counter()  # on layers that are off
    try:
        counts: Counter[str] = Counter()
        for entity, layer, block in _taken_apart(document.modelspace(), path, counts):
            kind = str(entity.dxftype())
            drawn_on = document.layers.get(layer) if layer in document.layers else None
            if drawn_on is not None and (drawn_on.is_off() or drawn_on.is_frozen()):
                hidden[layer] += 1
                continue
            where = f"{path}, {kind} on layer {layer!r} (handle {entity.dxf.handle})"
            found = _polygons(entity, kind, where)
            if found is None:
                unread[f"open {kind}" if kind.endswith("POLYLINE") else kind] += 1
                continue
            surface = Surface(layer, block, layer)
            check_limit("faces", len(polygons) + len(found), str(path))
            for corners in found:
                points = [[finite(str(float(value)), where) for value in c] for c in corners]
                polygons.append((np.array(points).reshape(-1, 3), surface))
        unit = _UNITS.get(int(document.header.get("$INSUNITS", 0)))
    except DAMAGE as error:
        raise damaged("DXF", path, f"{type(error).__name__}: {error}"[:200]) from error
    if not polygons:
        said = counted(unread + hidden) or "an empty drawing"
        needed = "3DFACE, polyface or MESH entities, or closed polylines, in the model space"
        raise no_faces(path, said, needed, "explode solids into faces before the export")
    graded: Severity = "warning" if any(kind in _FLAT for kind in unread) else "info"
    findings = ignored("The drawing has entities that are no faces, ignored", unread, graded)
    if hidden:
        text = f"Entities on layers that are off or frozen were passed over: {counted(hidden)}."
        findings += (Finding(Code.LAYERS_IGNORED, About(), text, dict(hidden)),)
    return RoomModel(*joined(polygons), findings, unit)


def _opened(path: Path) -> Any:
    try:
        from ezdxf.filemanagement import readfile
        from ezdxf.lldxf.const import DXFError
    except ImportError:
        what, needed = "DXF files are read by ezdxf, which is not installed", "the package ezdxf"
        found, hint = "a DXF file, and no ezdxf", "pip install roomfit[cad]"
        raise InputError(what, where=str(path), found=found, needed=needed, hint=hint) from None
    read_bytes(path, "room file", most="text_bytes")
    try:
        return readfile(path)
    except (*DAMAGE, DXFError, StopIteration) as error:
        raise damaged("DXF", path, f"{type(error).__name__}: {error}"[:200]) from error


def _taken_apart(
    entities: Any,
    path: Path,
    counts: Counter[str],
    layer: str | None = None,
    block: str | None = None,
    depth: int = 0,
) -> Iterator[tuple[Any, str, str | None]]:
    """Yield every entity with its layer and block, those of inserted blocks transformed.

    `counts` goes on from block to block: twenty that each insert ten of the next would never end.
    """
    if depth > _DEEPEST:
        what, found = "blocks are inserted into each other", f"block {block!r}, at depth {depth}"
        needed = f"blocks within blocks, at most {_DEEPEST} deep"
        raise malformed(what, str(path), found, needed, "explode them in the drawing program")
    for entity in entities:
        counts["entities"] += 1
        check_limit("entities", counts["entities"], str(path))
        own = str(entity.dxf.layer)
        own = layer if own == "0" and layer is not None else own
        if entity.dxftype() != "INSERT":
            yield entity, own, block
            continue
        name = str(entity.dxf.name)
        definition = entity.block()
        if definition is None or definition.block.is_xref:
            what, needed = "a block of the drawing is not in the file", "every inserted block"
            hint = "bind external references before the export"
            raise malformed(what, str(path), name, needed, hint)
        inserts = entity.multi_insert() if entity.mcount > 1 else (entity,)
        for insert in inserts:
            counts["inserts"] += 1
            check_limit("inserts", counts["inserts"], str(path))
            inner = _exploded(insert, f"{path}, block {name!r}")
            yield from _taken_apart(inner, path, counts, own, name, depth + 1)


def _exploded(insert: Any, where: str) -> list[Any]:
    lost: list[str] = []

    def note(entity: Any, reason: str) -> None:
        lost.append(f"{entity.dxftype()}: {reason}")

    entities = list(insert.virtual_entities(skipped_entity_callback=note))
    if lost:
        what, needed = "a block of the drawing cannot be taken apart", "entities to be exploded"
        raise malformed(what, where, lost[0], needed, "explode it in the drawing program")
    return entities


def _unreadable(where: str, found: str) -> InputError:
    what = "a surface of the drawing cannot be read"
    needed = "3DFACE, polyface or MESH entities, or closed polylines with straight edges"
    return malformed(what, where, found, needed, "explode it, or turn it into a mesh")


def _polygons(entity: Any, kind: str, where: str) -> list[list[Any]] | None:
    """Return the polygons of an entity, None where it has no area."""
    if kind in _BODIES or kind.endswith("SURFACE"):
        raise _unreadable(where, "a body of a solid modeller, which has no faces in the file")
    if entity.dxf.hasattr("thickness") and entity.dxf.thickness:
        raise _unreadable(where, "a thickness: walls extruded from a line")
    if kind == "3DFACE":
        return [list(entity.wcs_vertices())]
    if kind == "MESH":
        return _mesh_polygons(list(entity.vertices), list(entity.faces), where)
    if kind == "POLYLINE" and (entity.is_poly_face_mesh or entity.is_polygon_mesh):
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
    for corner in (corner for face in faces for corner in face):
        if not 0 <= corner < len(vertices):
            what, needed = "a face names a corner that does not exist", f"0 to {len(vertices) - 1}"
            raise malformed(what, where, f"corner {corner}", needed)
    return [[vertices[corner] for corner in face] for face in faces]
