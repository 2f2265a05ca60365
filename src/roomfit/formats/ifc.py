"""Building models in IFC: the faces of a space, named by what bounds it; read by ifcopenshell."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.base.errors import located
from roomfit.formats.model import (
    Outlines,
    RoomModel,
    damaged,
    ignored,
    isolated_polygons,
    joined,
    outline,
    unknown_space,
)

_SAME_M, _SAME_AREA = 0.01, 0.001


def read_ifc(path: Path, space: str | None = None) -> RoomModel:
    """Read a space of a building model in IFC [1]_ by ifcopenshell: metres, z up.

    Where the boundaries of the space (IfcRelSpaceBoundary) cover its body, they are the surfaces,
    with the names of walls, doors and windows, their classes as groups, and their materials, those
    of layers joined by " + ". Else the faces of the body are named by the largest boundary on
    which they lie, and what lies within another is passed over with a finding; without boundaries
    surfaces are "floor", "ceiling" and "wall". `space` may be left out where only one has a body.

    References
    ----------
    .. [1] ISO 16739-1:2024, "Industry Foundation Classes (IFC)".
    """
    head, polygons = isolated_polygons(
        path, "roomfit.formats.ifc:read", "ifcopenshell", "IFC", "roomfit[ifc]"
    )
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
    text = f"The boundaries of the space {chosen!r} do not cover it; ignored within others are"
    return RoomModel(*joined(own), ignored(text, kinds, "warning"), "m", "z")


def read(content: bytes, _: float, place: list[str]) -> tuple[dict[str, Any], list[Any]]:
    """Return the faces of every space that has a body, in m, named by its elements.

    A space whose boundaries cover its body has theirs, doors and windows among them; elsewhere the
    faces of the body are named by the largest boundary on which their centres lie.
    """
    import ifcopenshell
    import ifcopenshell.geom
    from ifcopenshell.util.placement import get_local_placement
    from ifcopenshell.util.unit import calculate_unit_scale

    if not content.rstrip().endswith(b"END-ISO-10303-21;"):
        raise ValueError("it does not end as such files do: not one, or cut short")
    model = ifcopenshell.file.from_string(content.decode("utf-8", errors="replace"))
    geom: Any = ifcopenshell.geom
    settings = geom.settings()
    settings.set("use-world-coords", True)
    scale = calculate_unit_scale(model)

    def triangles(shape: Any) -> Any:
        vertices = np.array(shape.verts, dtype=np.float64).reshape(-1, 3)
        return vertices[np.array(shape.faces, dtype=np.int64).reshape(-1, 3)]

    polygons: Outlines = []
    owners: list[str] = []
    left_out: dict[str, Counter[str]] = {}
    for space in model.by_type("IfcSpace"):
        place[0] = name = str(space.LongName or space.Name or f"#{space.id()}")
        if space.Representation is None:
            continue
        body = triangles(geom.create_shape(settings, space).geometry)
        matrix = get_local_placement(space.ObjectPlacement)
        pieces = []
        for boundary in space.BoundedBy:
            if boundary.ConnectionGeometry is None:
                continue
            surface = boundary.ConnectionGeometry.SurfaceOnRelatingElement
            if getattr(surface, "InnerBoundaries", None):  # which the library passes over
                own = scale * _with_holes(surface)
            else:
                own = triangles(geom.create_shape(settings, surface))
            own = own @ matrix[:3, :3].T + scale * matrix[:3, 3]
            pieces.append((own, _element(boundary.RelatedBuildingElement)))
        pieces.sort(key=lambda piece: -_areas(piece[0]).sum())
        area = _areas(body).sum()
        if abs(sum(_areas(own).sum() for own, _ in pieces) - area) <= _SAME_AREA * area:
            found = [(corners, named) for own, named in pieces for corners in own]
        else:
            found = [(corners, _on_piece(corners, pieces)) for corners in body]
            used = {named for _, named in found}
            left_out[name] = Counter(named[1] for _, named in pieces if named not in used)
        polygons += found
        owners += [name] * len(found)
    if not owners:
        raise ValueError("no IfcSpace with a body: export the model with its spaces (rooms)")
    return outline(polygons, spaces=owners, ignored=left_out)


def _with_holes(surface: Any) -> Any:
    """Return the triangles of a part of a plane between polygons, in the file's unit."""
    from ifcopenshell.util.placement import get_axis2placement
    from mapbox_earcut import triangulate_float64

    loops = []
    for curve in (surface.OuterBoundary, *surface.InnerBoundaries):
        if curve.is_a("IfcPolyline"):
            points = [p.Coordinates[:2] for p in curve.Points]
        elif curve.is_a("IfcIndexedPolyCurve") and not curve.Segments:
            points = [p[:2] for p in curve.Points.CoordList]
        else:
            raise ValueError(f"a boundary with a hole whose edge is no polygon, but {curve.is_a()}")
        loops.append(points[:-1] if points[0] == points[-1] else points)
    flat = np.array([p for loop in loops for p in loop], dtype=np.float64)
    ends = np.cumsum([len(loop) for loop in loops]).astype(np.uint32)
    corners = triangulate_float64(flat, ends).reshape(-1, 3)
    matrix = get_axis2placement(surface.BasisSurface.Position)
    return (flat @ matrix[:3, :2].T + matrix[:3, 3])[corners]


def _areas(triangles: Any) -> Any:

    a, b, c = triangles.transpose(1, 0, 2)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0


def _element(element: Any) -> tuple[str, str, str]:
    """Return name, class and material of what bounds a space."""
    from ifcopenshell.util.element import get_material

    if element is None:
        return "opening", "", "opening"
    kind = str(element.is_a())
    name = str(element.Name or f"{kind} #{element.id()}")
    material = get_material(element, should_skip_usage=True)
    layers = getattr(material, "MaterialLayers", None) or getattr(material, "Materials", None)
    if layers:
        own = [getattr(layer, "Material", layer) for layer in layers]
        return name, kind, " + ".join(str(m.Name) for m in own if m is not None)
    return name, kind, str(getattr(material, "Name", None) or name)


def _on_piece(corners: Any, pieces: list[tuple[Any, tuple[str, str, str]]]) -> tuple[str, str, str]:
    """Return the surface of the first piece that the centre of a triangle lies on."""

    centre = corners.mean(axis=0)
    for own, named in pieces:
        ways = own - centre
        # the three triangles with the centre fill the whole, and no more, if it lies within
        parts = np.linalg.norm(np.cross(ways, np.roll(ways, -1, axis=1)), axis=2).sum(axis=1) / 2.0
        whole = _areas(own)
        if np.any(parts <= whole + _SAME_M * np.sqrt(whole)):
            return named
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    steep = normal[2] / np.linalg.norm(normal) if normal.any() else 0.0
    side = "wall" if abs(steep) < 0.7 else "floor" if steep < 0.0 else "ceiling"
    return side, "", side
