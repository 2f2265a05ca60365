"""The program that reads one file in a process of its own; `roomfit.base.door.of_child` starts it.

Damaged files lead libraries of others (HDF5, COLLADA, IFC, USD, SKP) into endless loops, and to
read and write where they must not. So they run where nothing can be lost: with limits of memory
and time, the file on standard input, and on standard output one line of JSON (what there is, or an
error), and behind it the numbers as float64 in that order. Nothing of roomfit is imported.

Arguments: kind of the file, bytes of memory, seconds of processor time, bytes of numbers.
"""

from __future__ import annotations

import io
import json
import os
import re
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

# netCDF keeps a dimension that has no values of its own as a variable with this remark
_ONLY_A_DIMENSION = "This is a netCDF dimension but not a netCDF variable"
_BESIDE_A_DIMENSION = "_nc4_non_coord_"
# What libraries raise on files that are not what they claim to be.
_UNREADABLE = (
    *(OSError, RuntimeError, ValueError, TypeError, KeyError, IndexError, AttributeError),
    *(MemoryError, ArithmeticError, UnicodeError, NotImplementedError, SyntaxError, ImportError),
)
_MOST_ATTRIBUTES = 10_000
_SAME_M, _SAME_AREA = 0.01, 0.001


def main(arguments: list[str]) -> None:
    """Read standard input and write what it holds to standard output."""
    kind, rest = arguments[0], arguments[1:]
    memory_bytes, seconds, most_bytes = (int(float(a)) for a in rest)
    _limit_this_process(memory_bytes, seconds)
    content = sys.stdin.buffer.read()
    place = ["the file"]
    try:
        head, arrays = _READERS[kind](content, most_bytes, place)
        if sum(a.nbytes for a in arrays) > most_bytes:
            raise ValueError(f"more than {most_bytes:.4g} bytes of numbers")
        text = json.dumps(head)
    except _UNREADABLE as error:
        message = f"{place[0]}: {type(error).__name__}: {error}"
        text, arrays = json.dumps({"error": " ".join(message.split())[:500]}), []
    out = sys.stdout.buffer
    out.write(text.encode("ascii") + b"\n")
    for values in arrays:
        out.write(values.tobytes())
    out.flush()
    # the library would tidy up, and may fail at that
    os._exit(0)


def _limit_this_process(memory_bytes: int, seconds: int) -> None:
    try:
        import resource
    except ImportError:  # Windows: the parent's clock alone
        return
    for kind, most in (
        (resource.RLIMIT_AS, memory_bytes),
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_FSIZE, memory_bytes),
    ):
        _, hard = resource.getrlimit(kind)
        least = most if hard == resource.RLIM_INFINITY else min(most, hard)
        try:
            resource.setrlimit(kind, (least, hard))
        except (ValueError, OSError):  # macOS has no limit of addresses
            continue


def _hdf5(content: bytes, most_bytes: int, place: list[str]) -> tuple[dict[str, Any], list[Any]]:
    """Return what the root of the file holds, and the arrays of its variables in that order."""
    import h5py

    members: list[dict[str, Any]] = []
    arrays: list[Any] = []
    n_bytes = 0
    with h5py.File(io.BytesIO(content), "r") as file:
        attributes = _attributes(file)
        for name in file:
            place[0] = repr(name)
            # a link to another file would read what this file does not contain
            if not isinstance(file.get(name, getlink=True), h5py.HardLink):
                continue
            member = file[name]
            own = _attributes(member)
            entry: dict[str, Any] = {"name": name, "attributes": own, "axes": [], "shape": None}
            if isinstance(member, h5py.Dataset):
                if str(own.get("NAME", "")).startswith(_ONLY_A_DIMENSION):
                    continue
                entry["name"] = name.removeprefix(_BESIDE_A_DIMENSION)
                entry["axes"] = _axes(member)
                n_bytes += 8 * (member.size or 0)
                if n_bytes > most_bytes:
                    raise ValueError(f"more than {most_bytes:.4g} bytes of numbers")
                values = _real_numbers(member)
                if values is not None:
                    entry["shape"] = values.shape
                    arrays.append(values)
            members.append(entry)
    return {"members": members, "attributes": attributes}, arrays


def _real_numbers(dataset: Any) -> Any:
    """Return the values of a dataset as float64, or None where they are no real numbers."""
    import numpy as np

    if dataset.shape is None or dataset.dtype.kind not in "iuf":
        return None
    if dataset.external or dataset.is_virtual:
        raise ValueError("its numbers lie in other files")
    return np.asarray(dataset[()], dtype=np.float64)


def _axes(dataset: Any) -> list[str]:
    """Return the names of the dimensions of four or more axes, which netCDF attaches as scales.

    Up to three axes have one order only, and the library may count scales for ever in a damaged
    file: it is not asked in vain.
    """
    if dataset.ndim < 4:
        return ["" for _ in range(dataset.ndim)]
    names = (str(axis[0].name or "") if len(axis) else "" for axis in dataset.dims)
    return [name.rpartition("/")[2] for name in names]


def _attributes(member: Any) -> dict[str, str | float]:
    """Return texts and single numbers; lists of references and the like are passed over."""
    import h5py
    import numpy as np

    found: dict[str, str | float] = {}
    if len(member.attrs) > _MOST_ATTRIBUTES:
        raise ValueError(f"{len(member.attrs)} attributes")
    for name in member.attrs:
        kind = member.attrs.get_id(name).dtype
        if kind.kind not in "Siuf" and h5py.check_string_dtype(kind) is None:
            continue
        value = np.asarray(member.attrs[name]).reshape(-1)
        if value.size != 1 or isinstance(value[0], h5py.Empty):
            continue
        (single,) = value.tolist()
        if isinstance(single, bytes):
            single = single.decode("utf-8", errors="replace")
        if isinstance(single, str | int | float):
            found[name] = single.rstrip("\0") if isinstance(single, str) else float(single)
    return found


_Rooms = list[tuple[Any, tuple[str, str, str]]]  # corners (n, 3) of a polygon, and its surface


def _outline(polygons: _Rooms, **more: Any) -> tuple[dict[str, Any], list[Any]]:
    """Return a room's polygons as all corners, and how many and which surface each has."""
    import numpy as np

    if not polygons:
        raise ValueError("no faces")
    surfaces = list(dict.fromkeys(surface for _, surface in polygons))
    number = {surface: i for i, surface in enumerate(surfaces)}
    corners = np.concatenate([np.asarray(c, dtype=np.float64) for c, _ in polygons])
    each = np.array([(len(c), number[s]) for c, s in polygons], dtype=np.float64)
    return {"shapes": [corners.shape, each.shape], "surfaces": surfaces, **more}, [corners, each]


def _collada(content: bytes, _: int, place: list[str]) -> tuple[dict[str, Any], list[Any]]:
    """Return the polygons of a COLLADA file's scene, every node where its transforms put it."""
    import collada

    if re.search(rb"<(\w+:)?ph\b", content):
        raise ValueError("polygons with holes: triangulate them before the export")
    try:
        file = collada.Collada(io.BytesIO(content))
        if file.scene is None:
            raise ValueError("no scene")
        polygons: _Rooms = []
        ignored: Counter[str] = Counter()
        for geometry in file.scene.objects("geometry"):
            name = str(geometry.original.name or geometry.original.id)
            place[0] = repr(name)
            for part in geometry.primitives():
                if not hasattr(part, "polygons") and not hasattr(part, "triangles"):
                    ignored[type(part).__name__.removeprefix("Bound")] += 1
                    continue
                own = part.material
                of = (
                    own
                    if isinstance(own, str)
                    else getattr(own, "name", None) or getattr(own, "id", "")
                )
                shapes = part.polygons() if hasattr(part, "polygons") else part.triangles()
                polygons += [(shape.vertices, (name, "", str(of or ""))) for shape in shapes]
    except collada.DaeError as error:
        raise ValueError(f"{type(error).__name__}: {error}") from error
    asset = file.assetInfo
    return _outline(polygons, unit_m=asset.unitmeter or 1.0, up=asset.upaxis, ignored=ignored)


def _ifc(content: bytes, _: int, place: list[str]) -> tuple[dict[str, Any], list[Any]]:
    """Return the faces of every space of an IFC file that has a body, in m, named by its elements.

    A space whose boundaries cover its body has theirs, doors and windows among them; elsewhere the
    faces of the body are named by the largest boundary on which their centres lie.
    """
    import ifcopenshell
    import ifcopenshell.geom
    import numpy as np
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

    polygons: _Rooms = []
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
    return _outline(polygons, spaces=owners, ignored=left_out)


def _with_holes(surface: Any) -> Any:
    """Return the triangles of a part of a plane between polygons, in the file's unit."""
    import numpy as np
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
    import numpy as np

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
    import numpy as np

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


def _usdz(content: bytes, _: int, place: list[str]) -> tuple[dict[str, Any], list[Any]]:
    """Return the points of each wall, door, window and opening of a scan by RoomPlan, m, z up.

    They are known by names, as Wall0 or Door_0; whatever else ends in a number is a thing, of the
    group "thing".
    """
    os.environ["PXR_WORK_THREAD_LIMIT"] = "1"  # each thread takes addresses, which are limited
    import numpy as np
    from pxr import Tf, Usd, UsdGeom

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "scan.usdz")
        file.write_bytes(content)
        try:
            stage = Usd.Stage.Open(str(file))
        except Tf.ErrorException as error:
            # its text has places in the library and of this copy
            raise ValueError("no layer of USD that can be opened") from error
        for layer in stage.GetUsedLayers():
            if not (layer.anonymous or layer.realPath.startswith(str(file))):
                raise ValueError("it leads to other files")
        found: dict[tuple[str, str, str], list[Any]] = {}
        for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
            if not prim.IsA(UsdGeom.Gprim):
                continue
            place[0] = str(prim.GetPath())
            kind, number = _numbered(prim)
            if kind in ("wall", "door", "window", "opening"):
                named = (f"{kind.capitalize()}{number}", kind, "")
                found.setdefault(named, []).append(_points(prim))
            elif kind not in ("", "floor", "ceiling"):
                found.setdefault((f"{kind}{number}", "thing", ""), []).append(_points(prim))
        metres, up = UsdGeom.GetStageMetersPerUnit(stage), UsdGeom.GetStageUpAxis(stage)
    if all(group == "thing" for _, group, _ in found):
        raise ValueError("nothing in it is named Wall0: no scan by RoomPlan; export it as GLB")
    polygons: _Rooms = []
    for named, parts in found.items():
        x, y, z = metres * np.concatenate(parts).T
        polygons.append((np.stack([x, -z, y] if up == "Y" else [x, y, z], axis=1), named))
    return _outline(polygons)


def _numbered(prim: Any) -> tuple[str, str]:
    """Return kind and number in the name of a shape, or else of what it belongs to."""
    while prim and not prim.IsPseudoRoot():
        match = re.fullmatch(r"([A-Za-z]+)_?([0-9]+)", prim.GetName())
        if match:
            return match[1].lower(), match[2]
        prim = prim.GetParent()
    return "", ""


def _points(prim: Any) -> Any:
    """Return the points of a mesh, or the corners of what encloses another shape, in the scene."""
    import numpy as np
    from pxr import Usd, UsdGeom

    own = UsdGeom.Mesh(prim).GetPointsAttr().Get() if prim.IsA(UsdGeom.Mesh) else None
    if own is None:
        now = Usd.TimeCode.Default()
        low, high = np.array(
            UsdGeom.Boundable.ComputeExtentFromPlugins(UsdGeom.Boundable(prim), now)
        )
        own = [np.where([i & 1, i & 2, i & 4], high, low) for i in range(8)]
    points = np.array(own, dtype=np.float64).reshape(-1, 3)
    matrix = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(prim))
    return points @ matrix[:3, :3] + matrix[3, :3]


def _skp(content: bytes, most_bytes: int, place: list[str]) -> tuple[dict[str, Any], list[Any]]:
    """Return the faces of a SketchUp model, every component where it is placed, in inches, z up.

    Corners run counter-clockwise as seen from a face's front. A surface is named as the component
    or group; in place of group and material are the materials of back and front.
    """
    import numpy as np
    from openskp import SkpFile
    from openskp.errors import SkpParseError

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "room.skp")
        file.write_bytes(content)
        try:
            model = SkpFile(file).parse()
        except SkpParseError as error:
            raise ValueError(str(error)) from error
    names = {i: str(material.name) for i, material in model.materials_by_id.items()}
    polygons: _Rooms = []
    ignored: Counter[str] = Counter()
    n_bytes, hidden = 0, 0
    # what is placed, how, under which name and paint, hidden or not, and within what
    stack = [(model.root, np.eye(4)[:3], "model", "", False, frozenset[int]())]
    while stack:
        own, matrix, name, paint, is_hidden, within = stack.pop()
        place[0] = repr(name)
        for face in own.faces.values():
            back, front = (names.get(i, paint) for i in (face.back_material_id, face.material_id))
            for corners in _face_corners(own, face, matrix):
                polygons.append((corners, (name, back, front)))
                n_bytes += corners.nbytes
                hidden += is_hidden or bool(face.hidden)
            if n_bytes > most_bytes:
                raise ValueError(f"more than {most_bytes:.4g} bytes of numbers")
        for part in own.instances:
            inner = model.definitions.get(part.ref_idx)
            if inner is None or inner.is_image or inner.always_faces_camera:
                ignored["part without a definition" if inner is None else "picture"] += 1
                continue
            if part.ref_idx in within:
                raise ValueError("a component that contains itself")
            m = np.array(part.matrix[:12], dtype=np.float64)
            turn = matrix[:, :3] @ m[:9].reshape(3, 3)
            put = np.column_stack([turn, matrix[:, :3] @ m[9:] + matrix[:, 3]])
            called = str(part.name or inner.name or "group")
            shown = names.get(part.material_id, paint), is_hidden or bool(part.hidden)
            stack.append((inner, put, called, *shown, within | {part.ref_idx}))
    return _outline(polygons, ignored=ignored, hidden=hidden)


def _face_corners(own: Any, face: Any, matrix: Any) -> list[Any]:
    """Return the outline of a face, or where it has holes the triangles around them."""
    import numpy as np
    from mapbox_earcut import triangulate_float64

    loops = []
    for loop in face.loops:
        ends = [(own.edges[edge], forwards) for edge, forwards in loop]
        at = [own.vertices[e.v1_id if forwards > 0 else e.v2_id] for e, forwards in ends]
        loops.append(np.array([(v.x, v.y, v.z) for v in at], dtype=np.float64))
    loops.sort(key=lambda loop: -float(np.linalg.norm(_normal(loop))))
    if face.normal is not None and _normal(loops[0]) @ np.array(face.normal) < 0.0:
        loops[0] = loops[0][::-1]
    normal = _normal(loops[0])
    if len(loops) == 1:
        parts = loops
    else:
        points = np.concatenate(loops)
        axes = np.linalg.svd(normal[None])[2][1:]
        rings = np.cumsum([len(loop) for loop in loops]).astype(np.uint32)
        flat = np.ascontiguousarray(points @ axes.T)
        parts = list(points[triangulate_float64(flat, rings).astype(np.int64).reshape(-1, 3)])
        parts = [p if _normal(p) @ normal > 0.0 else p[::-1] for p in parts]
    # a mirror leaves the front where it was, and turns the corners round
    sense = 1 if np.linalg.det(matrix[:, :3]) > 0.0 else -1
    return [(p @ matrix[:, :3].T + matrix[:, 3])[::sense] for p in parts]


def _normal(corners: Any) -> Any:
    """Return twice the area of a polygon along its normal, shape (3,)."""
    import numpy as np

    return np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0)


_READERS = {"hdf5": _hdf5, "dae": _collada, "ifc": _ifc, "usdz": _usdz, "skp": _skp}

if __name__ == "__main__":
    main(sys.argv[1:])
