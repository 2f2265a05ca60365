"""Meshes: polygons of Wavefront OBJ, Stanford PLY and COLLADA, triangles of GLB and STL by trimesh.

OBJ is read here because trimesh loses names of groups and materials, PLY because it refuses binary
files whose polygons differ in length and passes over what is missing at the end of a text.
"""

from __future__ import annotations

import io
import json
import re
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.base.door import check_limit, decoded, read_bytes, read_text
from roomfit.base.polygon import Face, Surface
from roomfit.formats.model import (
    METRES_PER_UNIT,
    Outlines,
    RoomModel,
    damaged,
    finite,
    ignored,
    isolated_polygons,
    joined,
    malformed,
    no_faces,
    outline,
    whole,
)


def read_obj(path: Path) -> RoomModel:
    """Read the faces of an OBJ file [1]_.

    `usemtl` gives the material of a face, `o` its surface name (its group's or material's name
    where there is no `o`), `g` its group. The .mtl file describes only looks and is not opened, so
    it may be missing. Lines, points, curves, normals and texture coordinates are passed over.

    References
    ----------
    .. [1] Wavefront Technologies, "Advanced Visualizer Manual", appendix B1: Object files.
    """
    vertices: list[tuple[float, float, float]] = []
    faces: list[Face] = []
    lines: list[int] = []  # of each face in the file
    names: dict[str, str | None] = {}  # that apply to the next face
    for number, words, rest in _statements(read_text(path, "room file")):
        where = f"{path}, line {number}"
        match words[0]:
            case "v":
                if len(words) < 4:
                    what = "a vertex needs three coordinates"
                    raise malformed(what, where, " ".join(words), "v x y z")
                x, y, z = (finite(word, where) for word in words[1:4])
                vertices.append((x, y, z))
            case "f" | "fo":
                group, material = names.get("g"), names.get("usemtl")
                name = names.get("o") or group or material or "unnamed"
                corners = _corners(words, len(vertices), where)
                faces.append(Face(corners, Surface(name, group, material)))
                lines.append(number)
                check_limit("faces", len(faces), where)
            case "usemtl" | "g" | "o" as key:
                names[key] = rest or None
    if not faces:
        hint = "export again with faces, or check that this is an OBJ file"
        raise no_faces(path, f"{len(vertices)} vertices", 'lines that start with "f"', hint)
    n = len(vertices)
    for face, line in zip(faces, lines, strict=True):
        for corner in face.corners:
            if not 0 <= corner < n:
                what = "a face names a corner that does not exist"
                needed = f"1 to {n}, or -1 to -{n} counted back"
                raise malformed(what, f"{path}, line {line}", f"corner {corner + 1}", needed)
    return RoomModel(np.array(vertices).reshape(-1, 3), tuple(faces))


def _statements(text: str) -> Iterator[tuple[int, list[str], str]]:
    """Yield line number, words without comment, and all that follows the first word.

    A backslash at its end continues a line. A name may contain a "#", as in "Material #25".
    """
    pending: list[str] = []
    for number, line in enumerate(text.split("\n"), start=1):
        if line.endswith("\\"):
            pending.append(line[:-1])
            continue
        whole_line = " ".join([*pending, line])
        words = whole_line.split("#", 1)[0].split()
        if words:
            yield number - len(pending), words, whole_line.strip()[len(words[0]) :].strip()
        pending.clear()


def _corners(words: list[str], n_vertices: int, where: str) -> tuple[int, ...]:
    """Return the corners of a face, from 0; the file counts from 1, or back from the latest."""
    if len(words) < 4:
        what = "a face has fewer than three corners"
        raise malformed(what, where, " ".join(words), "at least three")
    corners = []
    for word in words[1:]:
        index = whole(word.split("/", 1)[0], where)
        # 0 is nothing and is refused with the others
        corners.append(index - 1 if index > 0 else n_vertices + index if index else -1)
    return tuple(corners)


_WORDS = ["char", "uchar", "short", "ushort", "int", "uint", "float", "double"]
_SIZES = ["int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64"]
_TYPES = dict(zip([*_WORDS, *_SIZES], 2 * "bBhHiIfd", strict=True))
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_CORNERS = ("vertex_indices", "vertex_index")
_Row = dict[str, list[float]]


def read_ply(path: Path) -> RoomModel:
    """Read vertices and polygons of a PLY file [1]_; everything else in it is passed over.

    The format carries no names: there is one surface, named as the file, without a material. Where
    I-Simpa [2]_ wrote layers behind the faces, a layer is a surface and its material.

    References
    ----------
    .. [1] G. Turk, "The PLY polygon file format" (1994).
    .. [2] Université Gustave Eiffel, I-Simpa, ``rply_interface.cpp`` (2007-2014).
    """
    content = read_bytes(path, "room file", most="text_bytes")
    try:
        rows = _ply_rows(content)
        points = [
            [finite(str(row[a][0]), f"{path}, vertex {n}") for a in "xyz"]
            for n, row in enumerate(rows.get("vertex", []))
        ]
        names = [
            decoded(bytes(int(letter) & 0xFF for letter in row["layer_name"])) or f"layer {n}"
            for n, row in enumerate(rows.get("layer", []))
        ]
        layers = [Surface(name, None, name) for name in names]
        faces = []
        for row in rows.get("face", []):
            number = int(row["layer_id"][0]) if layers and "layer_id" in row else -1
            if not -1 <= number < len(layers):
                raise ValueError(f"a face in layer {number} of {len(layers)}")
            corners = next((row[name] for name in _CORNERS if name in row), [])
            surface = layers[number] if number >= 0 else Surface(path.stem or "unnamed")
            faces.append(Face(tuple(int(c) for c in corners), surface))
    except (ValueError, LookupError, struct.error) as error:
        raise damaged("PLY", path, f"{type(error).__name__}: {error}"[:200]) from error
    if not faces or not points:
        raise no_faces(path, found=f"{len(points)} vertices and {len(faces)} faces")
    return RoomModel(np.array(points), tuple(faces))


def _ply_rows(content: bytes) -> dict[str, list[_Row]]:
    """Return the rows of each element, by its name, with the values of each property."""
    head, found, rest = content.partition(b"end_header")
    lines = head.decode("latin-1").splitlines()
    if not found or not lines or lines[0].strip() != "ply":
        raise ValueError("no 'ply' at its beginning, or no 'end_header' below")
    take, elements = None, list[tuple[str, int, list[tuple[str, str, str]]]]()
    for line in lines:
        match line.split():
            case ["format", order, *_]:
                take = _taker(rest[rest.find(b"\n") + 1 :], _ORDERS[order])
            case ["element", name, count]:
                elements.append((name, int(count), []))
            case ["property", "list", count, kind, name]:
                elements[-1][2].append((name, _TYPES[kind], _TYPES[count]))
            case ["property", kind, name]:
                elements[-1][2].append((name, _TYPES[kind], ""))
    if take is None:
        raise ValueError("no line 'format'")
    rows: dict[str, list[_Row]] = {}
    for name, n_rows, properties in elements:
        own = rows.setdefault(name, [])
        for _ in range(n_rows if properties else 0):
            row = {}
            for key, code, counted_by in properties:
                n = max(int(take(counted_by, 1)[0]), 0) if counted_by else 1
                row[key] = take(code, n)
            own.append(row)
    return rows


def _taker(body: bytes, order: str) -> Callable[[str, int], list[float]]:
    """Return a function that gives the next n numbers of a type, in text or binary."""
    words, at = [] if order else body.decode("latin-1").split(), 0

    def text(code: str, n: int) -> list[float]:
        nonlocal at
        at += n
        if at > len(words):
            raise ValueError("it ends early")
        return [float(w) if code in "fd" else int(w) for w in words[at - n : at]]

    def binary(code: str, n: int) -> list[float]:
        nonlocal at
        start, at = at, at + n * struct.calcsize(code)
        if at > len(body):
            raise ValueError("it ends early")
        return list(struct.unpack_from(f"{order}{n}{code}", body, start))

    return binary if order else text


def read_mesh_file(path: Path) -> RoomModel:
    """Read a GLB file (glTF 2.0 [1]_: metres, y up) or an STL file (no unit) by trimesh.

    In a GLB file the name of a surface is its node's, its material the file's. STL carries no
    names: there is one surface, named as the file, without a material.

    References
    ----------
    .. [1] ISO/IEC 12113:2022, "Runtime 3D asset delivery format (glTF 2.0)".
    """
    kind = path.suffix.lower()[1:]
    most = "file_bytes" if kind == "glb" else "text_bytes"
    read = f"roomfit.formats.meshes:{kind}"
    _, polygons = isolated_polygons(path, read, "trimesh", kind.upper(), "roomfit", most=most)
    if kind == "glb":
        return RoomModel(*joined(polygons), (), "m", "y")
    surface = Surface(path.stem or "unnamed")
    return RoomModel(*joined([(points, surface) for points, _ in polygons]))


def glb(content: bytes, _: float, place: list[str]) -> tuple[dict[str, Any], list[Any]]:
    """Return the triangles of a GLB file, every node where its transforms put it."""
    (length,) = struct.unpack_from("<I", content, 12)
    head = json.loads(content[20 : 20 + length])
    if head.get("extensionsRequired"):
        raise ValueError(f"it needs {', '.join(map(str, head['extensionsRequired']))}")
    accessors = head.get("accessors", [])
    if any("sparse" in accessor for accessor in accessors):
        raise ValueError("points that are stored sparsely")
    if sum(accessor["count"] for accessor in accessors) > len(content):
        raise ValueError("it says that it has more numbers than bytes")
    return _triangles(content, "glb", place)


def stl(content: bytes, _: float, place: list[str]) -> tuple[dict[str, Any], list[Any]]:
    """Return the triangles of an STL file."""
    return _triangles(content, "stl", place)


def _triangles(content: bytes, kind: str, place: list[str]) -> tuple[dict[str, Any], list[Any]]:
    import trimesh

    polygons: Outlines = []
    scene = trimesh.load_scene(io.BytesIO(content), file_type=kind, process=False)
    for node in scene.graph.nodes_geometry:
        transform, key = scene.graph[node]
        mesh = scene.geometry[key]
        if not isinstance(mesh, trimesh.Trimesh):
            continue
        place[0] = repr(node)
        material = getattr(getattr(mesh.visual, "material", None), "name", None)
        named = (str(node), "", str(material or ""))
        corners = trimesh.transform_points(mesh.vertices, transform)[mesh.faces]
        polygons += [(triangle, named) for triangle in corners]
    return outline(polygons)


def read_collada(path: Path) -> RoomModel:
    """Read the polygons of a COLLADA file's scene [1]_ by pycollada.

    A surface has the name of its geometry, and the file's material. The unit is that of the
    element ``unit``, m where there is none; the axis that points up that of ``up_axis``.

    References
    ----------
    .. [1] The Khronos Group, "COLLADA - Digital Asset Schema Release 1.4.1" (2008).
    """
    read = "roomfit.formats.meshes:collada"
    head, polygons = isolated_polygons(path, read, "pycollada", "COLLADA", "roomfit[cad]")
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
    findings = ignored("The drawing has parts that are no faces, ignored", kinds)
    return RoomModel(vertices, faces, findings, unit, up)


def collada(content: bytes, _: float, place: list[str]) -> tuple[dict[str, Any], list[Any]]:
    """Return the polygons of a COLLADA file's scene, every node where its transforms put it."""
    import collada

    if re.search(rb"<(\w+:)?ph\b", content):
        raise ValueError("polygons with holes: triangulate them before the export")
    try:
        file = collada.Collada(io.BytesIO(content))
        if file.scene is None:
            raise ValueError("no scene")
        polygons: Outlines = []
        lost: Counter[str] = Counter()
        for geometry in file.scene.objects("geometry"):
            name = str(geometry.original.name or geometry.original.id)
            place[0] = repr(name)
            for part in geometry.primitives():
                if not hasattr(part, "polygons") and not hasattr(part, "triangles"):
                    lost[type(part).__name__.removeprefix("Bound")] += 1
                    continue
                own = part.material
                of = getattr(own, "name", None) or getattr(own, "id", "")
                of = own if isinstance(own, str) else of
                shapes = part.polygons() if hasattr(part, "polygons") else part.triangles()
                polygons += [(shape.vertices, (name, "", str(of or ""))) for shape in shapes]
    except collada.DaeError as error:
        raise ValueError(f"{type(error).__name__}: {error}") from error
    asset = file.assetInfo
    return outline(polygons, unit_m=asset.unitmeter or 1.0, up=asset.upaxis, ignored=lost)
