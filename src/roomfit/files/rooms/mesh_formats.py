"""Readers of meshes: polygons of AC3D, Wavefront OBJ and Stanford PLY, triangles of 3DS, STL, GLB.

The first three are read here and not by trimesh, which cuts concave polygons into a fan (an
L-shaped floor of 7 m2 came out with 16 m2) and loses names of groups and materials; 3DS it does not
read.
"""

from __future__ import annotations

import io
import json
import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.base.door import check_limit, decoded, json_content, quiet, read_bytes, read_text
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import FloatArray
from roomfit.files.rooms.model import (
    PARSER_ERRORS,
    RoomModel,
    check_corners,
    damaged,
    finite,
    malformed,
    no_faces,
    whole,
)
from roomfit.room.build import Face
from roomfit.room.mesh import Surface

_WORD = re.compile(r'"[^"]*"|\S+')
_POLYGON, _TYPE_BITS, _TWO_SIDED = 0, 0x0F, 0x20
_LARGEST_COUNT = 10**7


_Surf = tuple[tuple[int, ...], int, bool]  # corners, number of the material, two-sided


@dataclass(slots=True)
class _Object:
    """One object of the tree while it is read; `turn` and `shift` are those of the whole room."""

    turn: FloatArray
    shift: FloatArray
    kids_left: int = 0
    name: str = ""
    vertices: list[list[float]] = field(default_factory=list)
    surfs: list[_Surf] = field(default_factory=list)


class _Lines:
    """The lines of a file, read from front to back."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lines = read_text(path, "room file").split("\n")
        self._next = 0

    @property
    def where(self) -> str:
        return f"{self.path}, line {self._next}"

    def words(self) -> list[str]:
        """Return the words of the next line that has any; an empty list at the end."""
        while self._next < len(self._lines):
            words = _WORD.findall(self._lines[self._next])
            self._next += 1
            if words:
                return [w[1:-1] if w[:1] == '"' == w[-1:] and len(w) > 1 else w for w in words]
        return []

    def needed(self, first: str | None, least: int) -> list[str]:
        """Return the next line, which must start with a word and have so many words in all."""
        words = self.words()
        if not words:
            raise _cut_short(self.path)
        if len(words) < least or (first is not None and words[0] != first):
            needed = f"{first!r} and {least - 1} values" if first else f"{least} values"
            raise malformed(
                "an AC3D line is not as it must be", self.where, " ".join(words)[:60], needed
            )
        return words

    def skip_text(self, n_characters: int) -> None:
        """Pass over the lines of a text of known length."""
        passed = 0
        while passed < n_characters and self._next < len(self._lines):
            passed += len(self._lines[self._next]) + 1
            self._next += 1


def read_ac3d(path: Path) -> RoomModel:
    """Read the surfaces of an AC3D file [1]_, transformed by `rot` and `loc` of their objects.

    The name of a surface is its object's, its material that of the MATERIAL line it points to.
    Lines are passed over. "Two-sided" is often set for all surfaces, only for the sake of drawing;
    where a file sets it for some and not for others, those are taken as sheets in the air, with a
    finding.

    Raises
    ------
    InputError
        Not an AC3D file, cut short, an index out of range, or a coordinate that is not finite.

    References
    ----------
    .. [1] A. Colebourne, "The AC3D file format" (2003), www.inivis.com.
    """
    lines = _Lines(path)
    first = lines.words()
    if not "".join(first[:1]).startswith("AC3D"):
        needed = '"AC3D" at the start of the first line'
        hint = "export the room as AC3D, or rename the file after its own format"
        raise malformed("this is no AC3D file", str(path), repr(" ".join(first)[:40]), needed, hint)
    materials: list[str] = []
    done: list[_Object] = []
    while words := lines.words():
        if words[0] == "MATERIAL" and len(words) > 1:
            materials.append(words[1] or f"material {len(materials)}")
        elif words[0] == "OBJECT":
            _read_tree(lines, done)
    return _collect(path, materials, done)


def _read_tree(lines: _Lines, done: list[_Object]) -> None:
    """Read one object and all below it. A stack, not recursion: files may nest without limit."""
    stack = [_Object(np.eye(3), np.zeros(3))]
    while stack:
        kids = _read_object(lines, stack[-1])
        done.append(stack[-1])
        stack[-1].kids_left = kids
        while stack and stack[-1].kids_left == 0:
            stack.pop()
        if stack:
            stack[-1].kids_left -= 1
            lines.needed("OBJECT", 1)
            stack.append(_Object(stack[-1].turn, stack[-1].shift))


def _read_object(lines: _Lines, this: _Object) -> int:
    """Read the lines of an object up to its `kids` line and return how many kids follow."""
    loc, rot = np.zeros(3), np.eye(3)
    while True:
        words = lines.needed(None, 1)
        match words[0]:
            case "name" if len(words) > 1:
                this.name = words[1]
            case "data" if len(words) > 1:
                lines.skip_text(whole(words[1], lines.where))
            case "loc":
                loc = np.array(_floats(words, 3, lines))
            case "rot":
                rot = np.array(_floats(words, 9, lines)).reshape(3, 3)
            case "numvert":
                rows = range(_count(words, lines))
                this.vertices = [_floats(["", *lines.needed(None, 3)], 3, lines) for _ in rows]
            case "numsurf":
                this.surfs = [_read_surf(lines) for _ in range(_count(words, lines))]
            case "kids":
                # nested nonsense may overflow; the mesh refuses what is not finite
                with np.errstate(over="ignore", invalid="ignore"):
                    this.shift = this.turn @ loc + this.shift
                    this.turn = this.turn @ rot
                return _count(words, lines)


def _read_surf(lines: _Lines) -> _Surf:
    words = lines.needed("SURF", 2)
    try:
        flags = int(words[1], 0)
    except ValueError:
        flags = whole(words[1], lines.where)
    words = lines.needed(None, 2)
    material = -1
    if words[0] == "mat":
        material = whole(words[1], lines.where)
        words = lines.needed("refs", 2)
    elif words[0] != "refs":
        needed = '"refs" and the number of its corners'
        raise malformed("an AC3D surface without refs", lines.where, " ".join(words)[:60], needed)
    rows = range(_count(words, lines))
    corners = tuple(whole(lines.needed(None, 1)[0], lines.where) for _ in rows)
    if flags & _TYPE_BITS != _POLYGON:
        corners = ()
    return corners, material, bool(flags & _TWO_SIDED)


def _floats(words: list[str], n: int, lines: _Lines) -> list[float]:
    if len(words) < n + 1:
        raise malformed(
            "numbers are missing", lines.where, f"{len(words) - 1} of them", f"{n} numbers"
        )
    return [finite(word, lines.where) for word in words[1 : n + 1]]


def _count(words: list[str], lines: _Lines) -> int:
    count = whole(words[1] if len(words) > 1 else "", lines.where)
    if not 0 <= count <= _LARGEST_COUNT:
        raise malformed(
            "a count is out of range", lines.where, str(count), f"0 to {_LARGEST_COUNT}"
        )
    return count


def _collect(path: Path, materials: list[str], objects: list[_Object]) -> RoomModel:
    flags = [two_sided for this in objects for corners, _, two_sided in this.surfs if corners]
    if not flags:
        raise no_faces(path, hint="the file may be cut short")
    sheets_meant = 0 < sum(flags) < len(flags)
    vertices: list[FloatArray] = []
    faces: list[Face] = []
    first = 0
    for this in objects:
        own = np.array(this.vertices, dtype=np.float64).reshape(-1, 3)
        with np.errstate(over="ignore", invalid="ignore"):
            vertices.append(own @ this.turn.T + this.shift)
        for corners, number, two_sided in this.surfs:
            if not corners:
                continue
            where = f"{path}, object {this.name!r}"
            check_corners(corners, len(own), where)
            if not -1 <= number < len(materials):
                what = "a face names a material that does not exist"
                raise malformed(what, where, f"material {number}", f"0 to {len(materials) - 1}")
            material = materials[number] if number >= 0 else None
            name = this.name or material or "unnamed"
            surface = Surface(name, None, material, sheets_meant and two_sided)
            faces.append(Face(tuple(c + first for c in corners), surface))
        first += len(own)
    findings: tuple[Finding, ...] = ()
    if sheets_meant:
        text = (
            f"{sum(flags)} of {len(flags)} surfaces are marked as two-sided and taken as sheets in "
            "the air, such as curtains. If they belong to the walls, unmark them."
        )
        evidence = {"sheets": sum(flags), "of": len(flags)}
        findings = (Finding(Code.TWO_SIDED_TAKEN_AS_SHEETS, About(), text, evidence),)
    return RoomModel(np.concatenate(vertices), tuple(faces), findings)


def read_obj(path: Path) -> RoomModel:
    """Read the faces of an OBJ file [1]_.

    `usemtl` gives the material of a face, `o` its surface name (its group's or material's name
    where there is no `o`), `g` its group. The .mtl file describes only looks and is not opened, so
    it may be missing. Lines, points, curves, normals and texture coordinates are passed over.

    Raises
    ------
    InputError
        No faces, a face of less than three corners or with a corner that does not exist, or a
        coordinate that is not finite; the message has the line.

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
                    raise malformed(
                        "a vertex needs three coordinates", where, " ".join(words), "v x y z"
                    )
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
        raise no_faces(
            path,
            found=f"{len(vertices)} vertices",
            needed='lines that start with "f"',
            hint="export again with faces, or check that this is an OBJ file",
        )
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
        raise malformed(
            "a face has fewer than three corners", where, " ".join(words), "at least three"
        )
    corners = []
    for word in words[1:]:
        index = whole(word.split("/", 1)[0], where)
        # 0 is nothing and is refused with the others
        corners.append(index - 1 if index > 0 else n_vertices + index if index else -1)
    return tuple(corners)


_TYPES = {
    "char": "int8",
    "uchar": "uint8",
    "short": "int16",
    "ushort": "uint16",
    "int": "int32",
    "uint": "uint32",
    "float": "float32",
    "double": "float64",
}
# of `struct`, by either name
_CODES = {name: np.dtype(own).char for old, own in _TYPES.items() for name in (old, own)}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_CORNERS = ("vertex_indices", "vertex_index")
_LAYER, _LAYER_NAME = "layer_id", "layer_name"
_HEADER_END = b"end_header"


@dataclass(frozen=True, slots=True)
class _Element:
    name: str
    count: int
    # name, code of `struct`, and that of a list's length: empty where there is one value
    properties: list[tuple[str, str, str]] = field(default_factory=list)


def read_ply(path: Path) -> RoomModel:
    """Read vertices and polygons of a PLY file [1]_; everything else in it is passed over.

    The format carries no names: there is one surface, named as the file, without a material. Where
    I-Simpa [2]_ wrote layers behind the faces, a layer is a surface and its material.

    Raises
    ------
    InputError
        Not a PLY file, cut short, without faces, with coordinates that are not finite, or with a
        face in a layer that is not there.

    References
    ----------
    .. [1] G. Turk, "The PLY polygon file format" (1994).
    .. [2] Université Gustave Eiffel, I-Simpa, ``rply_interface.cpp`` (2007-2014).
    """
    order, elements, body = _header(path, read_bytes(path, "room file", most="text_bytes"))
    take = _numbers(path, body, order)
    surface = Surface(path.stem or "unnamed")
    points: list[list[float]] = []
    faces: list[Face] = []
    layers: list[int] = []  # of the faces, -1 for none
    names: list[str] = []
    for element in elements:
        for number in range(element.count if element.properties else 0):
            where = f"{path}, {element.name} {number}"
            row = {}
            for name, code, count_code in element.properties:
                n = max(int(take(count_code, 1)[0]), 0) if count_code else 1
                row[name] = take(code, n)
            if element.name == "vertex":
                points.append([_coordinate(row, a, where) for a in "xyz"])
            elif element.name == "face":
                corners = next((row[name] for name in _CORNERS if name in row), [])
                faces.append(Face(tuple(int(c) for c in corners), surface))
                layers.append(int(row.get(_LAYER, [-1.0])[0]))
            elif element.name == "layer":
                letters = bytes(int(letter) & 0xFF for letter in row.get(_LAYER_NAME, []))
                names.append(decoded(letters) or f"layer {number}")
    if names:
        named = zip(faces, layers, strict=True)
        faces = [Face(f.corners, _layer(names, layer, path) or surface) for f, layer in named]
    if not faces or not points:
        raise no_faces(path, found=f"{len(points)} vertices and {len(faces)} faces")
    return RoomModel(np.array(points), tuple(faces))


def _layer(names: list[str], number: int, path: Path) -> Surface | None:
    """Return the surface of a layer, None for -1."""
    if not -1 <= number < len(names):
        what = "a face names a layer that does not exist"
        hint = "export it from I-Simpa again: its layers stand before its faces"
        raise malformed(what, str(path), f"layer {number}", f"0 to {len(names) - 1}", hint)
    return Surface(names[number], None, names[number]) if number >= 0 else None


def _coordinate(row: dict[str, list[float]], axis: str, where: str) -> float:
    if not row.get(axis):
        what = "a vertex needs three coordinates"
        needed, hint = "x, y and z", "export the vertices with the properties x, y and z"
        raise malformed(what, where, f"no {axis}, but {', '.join(row) or 'nothing'}", needed, hint)
    return finite(str(row[axis][0]), where)


def _header(path: Path, content: bytes) -> tuple[str, list[_Element], bytes]:
    """Return byte order ("" for text), the elements, and what follows the header."""
    head, found, rest = content.partition(_HEADER_END)
    check_limit("header_bytes", len(head) if found else 0, str(path))
    lines = head.decode("latin-1").splitlines()
    if not found or not lines or lines[0].strip() != "ply":
        raise malformed(
            "this is no PLY file",
            str(path),
            repr(lines[0][:40] if lines else ""),
            '"ply" first and "end_header" later',
            "export the room as PLY, or rename the file after its own format",
        )
    order, elements = None, list[_Element]()
    for number, line in enumerate(lines, start=1):
        where = f"{path}, line {number}"
        match line.split():
            case ["format", name, _] if name in _ORDERS:
                order = _ORDERS[name]
            case ["element", name, count]:
                elements.append(_Element(name, whole(count, where)))
            case ["property", "list", count, kind, name] if elements:
                code, count_code = _code(kind, where), _code(count, where)
                if count_code in "fd" or (name in (*_CORNERS, _LAYER_NAME) and code in "fd"):
                    wanted = ", ".join(k for k, c in _CODES.items() if c not in "fd")
                    what, needed = "a PLY list needs whole numbers", f"one of {wanted}"
                    hint = "export it as PLY with lists of uchar and int"
                    raise malformed(what, where, line, needed, hint)
                elements[-1].properties.append((name, code, count_code))
            case ["property", kind, name] if elements:
                elements[-1].properties.append((name, _code(kind, where), ""))
    if order is None:
        raise malformed(
            "a PLY file of unknown format",
            str(path),
            next((w for w in lines if w.startswith("format")), "no line format")[:60],
            f"one of {', '.join(_ORDERS)}",
            "export it as ASCII PLY, version 1.0",
        )
    return order, elements, rest[rest.find(b"\n") + 1 :]


def _code(kind: str, where: str) -> str:
    if kind not in _CODES:
        hint = "export it as ASCII PLY with coordinates of type float"
        raise malformed("unknown PLY type", where, repr(kind), f"one of {', '.join(_CODES)}", hint)
    return _CODES[kind]


def _numbers(path: Path, body: bytes, order: str) -> Callable[[str, int], list[float]]:
    """Return a function that gives the next n numbers of a type, in text or binary."""
    words, at = iter(() if order else body.decode("latin-1").split()), 0

    def text(code: str, n: int) -> list[float]:
        taken = list(islice(words, n))
        if len(taken) < n:
            raise _cut_short(path)
        return [finite(w, str(path)) if code in "fd" else whole(w, str(path)) for w in taken]

    def binary(code: str, n: int) -> list[float]:
        nonlocal at
        start, at = at, at + n * struct.calcsize(code)
        if at > len(body):
            raise _cut_short(path)
        return list(struct.unpack_from(f"{order}{n}{code}", body, start))

    return binary if order else text


def _cut_short(path: Path) -> InputError:
    return InputError(
        "the room file ends early",
        where=str(path),
        found="its end, where more is declared",
        needed="as many numbers and lines as it declares",
        hint="the file is cut short: export or copy it again",
    )


def read_3ds(path: Path) -> RoomModel:
    """Read the triangles of a 3D Studio file (.3ds) [1]_ where they stand: no unit, z up.

    The name of a surface is its object's, its material that of the faces. Keyframes are passed
    over. Where the axes of an object are left-handed its points
    were mirrored along the first of them when they were written, which is undone, as lib3ds does.

    Raises
    ------
    InputError
        Not a 3DS file, cut short, without faces, an index out of range, or a coordinate that is
        not finite.

    References
    ----------
    .. [1] M. Fercoq and others, "The 3DS file format" (1996); J. E. Hoffmann, lib3ds 1.3 (2007).
    """
    content = read_bytes(path, "room file", most="text_bytes")
    if len(content) < _CHUNK.size or content[:2] != b"MM":
        what = "this is no 3DS file"
        hint = "export the room as 3DS, or rename the file after its own format"
        raise malformed(what, str(path), repr(content[:2]), '"MM" at its beginning', hint)
    _, length = _CHUNK.unpack_from(content)
    if length > len(content):
        raise _cut_short(path)
    parts: list[FloatArray] = []
    faces: list[Face] = []
    first = 0
    for editor in _chunks(content[_CHUNK.size : length], path).get(_EDITOR, []):
        for thing in _chunks(editor, path).get(_OBJECT, []):
            name, _, body = thing.partition(b"\0")
            for mesh in _chunks(body, path).get(_MESH, []):
                points, triangles, materials = _mesh_3ds(mesh, f"{path}, {decoded(name)!r}", path)
                for triangle, material in zip(triangles, materials, strict=True):
                    surface = Surface(decoded(name) or material or "unnamed", None, material)
                    faces.append(Face(tuple(first + corner for corner in triangle), surface))
                first += len(points)
                parts.append(points)
                check_limit("corners", first, str(path))
                check_limit("faces", len(faces), str(path))
    if not faces:
        raise no_faces(
            path, hint="the file may hold lights, cameras or curves alone: export meshes"
        )
    return RoomModel(np.concatenate(parts), tuple(faces))


_CHUNK = struct.Struct("<HI")  # kind and length, itself included
_EDITOR, _OBJECT, _MESH = 0x3D3D, 0x4000, 0x4100
_POINTS, _TRIANGLES, _OF_MATERIAL, _AXES = 0x4110, 0x4120, 0x4130, 0x4160


def _chunks(data: bytes, path: Path) -> dict[int, list[bytes]]:
    """Return the contents of chunks that follow each other, by kind."""
    found: dict[int, list[bytes]] = {}
    at = 0
    while at < len(data):
        end = at + _CHUNK.size
        kind, length = _CHUNK.unpack_from(data, at) if end <= len(data) else (0, 0)
        if not _CHUNK.size <= length <= len(data) - at:
            raise _cut_short(path)
        found.setdefault(kind, []).append(data[end : at + length])
        at += length
    return found


def _mesh_3ds(
    mesh: bytes, where: str, path: Path
) -> tuple[FloatArray, list[list[int]], list[str | None]]:
    """Return points, shape (n, 3), corners of the triangles, and their materials."""

    def table(data: bytes, kind: str, width: int) -> tuple[FloatArray, bytes]:
        """Return rows of which the first two bytes say how many there are, and what follows."""
        n = int.from_bytes(data[:2], "little") * width
        end = 2 + n * np.dtype(kind).itemsize
        if end > len(data):
            raise _cut_short(path)
        return np.frombuffer(data, kind, n, 2).reshape(-1, width).astype(np.float64), data[end:]

    chunks = _chunks(mesh, path)
    if _POINTS not in chunks or _TRIANGLES not in chunks:
        return np.empty((0, 3)), [], []
    points, _ = table(chunks[_POINTS][0], "<f4", 3)
    for point in points[~(np.abs(points) < 1e9).all(axis=1)][:1]:
        finite(str(point[~(np.abs(point) < 1e9)][0]), where)
    rows, rest = table(chunks[_TRIANGLES][0], "<u2", 4)  # three corners, and which edges show
    triangles = rows[:, :3].astype(int).tolist()
    for triangle in triangles:
        check_corners(triangle, len(points), where)
    materials: list[str | None] = [None] * len(triangles)
    for piece in _chunks(rest, path).get(_OF_MATERIAL, []):
        name, _, body = piece.partition(b"\0")
        numbers = table(body, "<u2", 1)[0][:, 0].astype(int).tolist()
        check_corners(numbers, len(triangles), f"{where}, material {decoded(name)!r}")
        for number in numbers:
            materials[number] = decoded(name) or None
    if _AXES in chunks and len(chunks[_AXES][0]) >= 48:
        frame = np.frombuffer(chunks[_AXES][0], "<f4", 12).reshape(4, 3).astype(np.float64)
        *axes, origin = frame
        if (np.abs(frame) < 1e9).all() and np.linalg.det(axes) < -1e-12:
            own = np.linalg.solve(np.transpose(axes), (points - origin).T).T * (-1.0, 1.0, 1.0)
            points = own @ axes + origin
    return points, triangles, materials


def read_stl(path: Path) -> RoomModel:
    """Read an STL file: triangles without unit, names or materials.

    There is one surface, named as the file.

    Raises
    ------
    InputError
        Not an STL file, cut short, or a coordinate that is not finite.
    """
    surface = Surface(path.stem or "unnamed")
    return RoomModel(*_triangles(path, "stl", lambda _name, _material: surface))


def read_glb(path: Path) -> RoomModel:
    """Read a GLB file, the binary form of glTF 2.0 [1]_: metres, y up by its standard.

    The name of a surface is its node's, its material the one the file gives it.

    Raises
    ------
    InputError
        Not a GLB file, cut short, or a coordinate that is not finite.

    References
    ----------
    .. [1] ISO/IEC 12113:2022, "Runtime 3D asset delivery format (glTF 2.0)".
    """
    vertices, faces = _triangles(path, "glb", lambda name, material: Surface(name, None, material))
    return RoomModel(vertices, faces, (), "m", "y")


_GLB_HEAD, _GLB_CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")
# What shapes a room, and nothing that looks, moves or is compressed.
_GLB_NODE = ("name", "children", "mesh", "matrix", "translation", "rotation", "scale")
_GLB_LARGEST_NUMBER = 64  # bytes of an entry of an accessor: a matrix of 4 by 4


def _bare_glb(content: bytes, where: str) -> bytes:
    """Return the GLB file with its geometry and the names of its materials alone.

    Pictures may unpack to anything, and a table of points without bytes behind it may declare any
    number of them, all of which the library would make.
    """
    magic, version, _ = _GLB_HEAD.unpack_from(content)
    length, kind = _GLB_CHUNK.unpack_from(content, _GLB_HEAD.size)
    start = _GLB_HEAD.size + _GLB_CHUNK.size
    if magic != b"glTF" or version != 2 or kind != b"JSON" or start + length > len(content):
        raise ValueError("no header of a GLB file of version 2")
    check_limit("text_bytes", length, where)
    text = content[start : start + length].decode("utf-8")
    bare = _bare_tree(json_content(text, "head of the GLB file"), where)
    body = json.dumps(bare).encode()
    body += b" " * (-len(body) % 4)
    rest = content[start + length :]
    size = start + len(body) + len(rest)
    return _GLB_HEAD.pack(magic, version, size) + _GLB_CHUNK.pack(len(body), kind) + body + rest


def _bare_tree(tree: dict[str, Any], where: str) -> dict[str, Any]:
    if tree.get("extensionsRequired"):
        raise ValueError(f"it needs {', '.join(map(str, tree['extensionsRequired']))}")
    check_limit("inserts", len(tree.get("nodes", [])), where)
    views: list[Any] = []
    tables: dict[int, int] = {}  # from a number in the file to the one behind all that is left out
    accessors: list[dict[str, Any]] = []
    n_bytes = 0

    def table(index: int) -> int:
        nonlocal n_bytes
        if index not in tables:
            own = tree["accessors"][index]
            view = tree["bufferViews"][own["bufferView"]]
            if "sparse" in own or own["count"] < 1 or view["byteLength"] < 0:
                raise ValueError("points that are stored sparsely, or none at all")
            n_bytes += view["byteLength"] + _GLB_LARGEST_NUMBER * own["count"]
            check_limit("unpacked_bytes", n_bytes, where)
            tables[index] = len(accessors)
            accessors.append({**own, "bufferView": len(views)})
            views.append(view)
        return tables[index]

    def primitive(own: dict[str, Any]) -> dict[str, Any]:
        kept: dict[str, Any] = {key: own[key] for key in ("mode", "material") if key in own}
        if "indices" in own:
            kept["indices"] = table(own["indices"])
        return {**kept, "attributes": {"POSITION": table(own["attributes"]["POSITION"])}}

    bare: dict[str, Any] = {key: tree[key] for key in ("asset", "scene", "buffers") if key in tree}
    bare["scenes"] = [{"nodes": s.get("nodes", [])} for s in tree.get("scenes", [])]
    bare["nodes"] = [{k: n[k] for k in _GLB_NODE if k in n} for n in tree.get("nodes", [])]
    bare["meshes"] = [
        {"name": str(m.get("name", "GLTF")), "primitives": [primitive(p) for p in m["primitives"]]}
        for m in tree.get("meshes", [])
    ]
    bare["materials"] = [
        {"name": str(m["name"])} if "name" in m else {} for m in tree.get("materials", [])
    ]
    return {**bare, "accessors": accessors, "bufferViews": views}


def _triangles(
    path: Path, kind: str, surface_of: Callable[[str, str | None], Surface]
) -> tuple[FloatArray, tuple[Face, ...]]:
    """Return vertices and triangles of all parts, transformed as in the file."""
    import trimesh

    n_corners = n_faces = 0
    parts = []
    try:
        if kind == "glb":
            content = _bare_glb(read_bytes(path, "room file"), str(path))
        else:
            content = read_bytes(path, "room file", most="text_bytes")
        with quiet("trimesh"):
            scene = trimesh.load_scene(io.BytesIO(content), file_type=kind, process=False)
            for node in scene.graph.nodes_geometry:
                transform, key = scene.graph[node]
                mesh = scene.geometry[key]
                n_corners, n_faces = n_corners + len(mesh.vertices), n_faces + len(mesh.faces)
                check_limit("corners", n_corners, str(path))
                check_limit("faces", n_faces, str(path))
                points = trimesh.transform_points(mesh.vertices, transform)
                material = getattr(getattr(mesh.visual, "material", None), "name", None)
                surface = surface_of(str(node), material or None)
                parts.append((points, np.asarray(mesh.faces), surface))
    except PARSER_ERRORS as error:
        raise damaged(kind.upper(), path, f"{type(error).__name__}: {error}"[:200]) from error
    faces: list[Face] = []
    first = 0
    for points, triangles, surface in parts:
        bad = np.argwhere(~np.isfinite(points))
        if len(bad):
            vertex, axis = bad[0]
            finite(str(points[vertex, axis]), f"{path}, {surface.name!r}, vertex {vertex}")
        faces.extend(Face(tuple((t + first).tolist()), surface) for t in triangles)
        first += len(points)
    if not faces:
        raise no_faces(path, hint="the file may be damaged or cut short: export it again")
    return np.concatenate([points for points, _, _ in parts]), tuple(faces)
