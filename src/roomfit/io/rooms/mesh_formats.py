"""Readers of polygon meshes: AC3D (.ac), Wavefront OBJ, and Stanford PLY in text or binary.

Read here and not by trimesh, which cuts concave polygons into a fan (an L-shaped floor of 7 m2 came
out with 16 m2) and loses names of groups and materials.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from roomfit.errors import InputError
from roomfit.findings import Code, Finding
from roomfit.geometry.build import Face
from roomfit.geometry.mesh import Surface
from roomfit.io.rooms.model import RoomModel, finite, read_bytes, read_text, whole
from roomfit.typing import FloatArray

_WORD = re.compile(r'"[^"]*"|\S+')
_POLYGON, _TYPE_BITS, _TWO_SIDED = 0, 0x0F, 0x20
_LARGEST_COUNT = 10**7


@dataclass(frozen=True, slots=True)
class _Surf:
    corners: tuple[int, ...]
    material: int
    two_sided: bool


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
        self._lines = read_text(path).split("\n")
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
            raise InputError(
                "the room file ends early", where=str(self.path), hint="export it again"
            )
        if len(words) < least or (first is not None and words[0] != first):
            needed = f"{first!r} and {least - 1} values" if first else f"{least} values"
            raise InputError(
                "an AC3D line is not as it must be",
                where=self.where,
                found=" ".join(words)[:60],
                needed=needed,
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
    if not "".join(lines.words()[:1]).startswith("AC3D"):
        raise InputError(
            "this is no AC3D file", where=str(path), needed='"AC3D" at the start of the first line'
        )
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
        raise InputError(
            "an AC3D surface without refs", where=lines.where, found=" ".join(words)[:60]
        )
    rows = range(_count(words, lines))
    corners = tuple(whole(lines.needed(None, 1)[0], lines.where) for _ in rows)
    if flags & _TYPE_BITS != _POLYGON:
        corners = ()
    return _Surf(corners, material, bool(flags & _TWO_SIDED))


def _floats(words: list[str], n: int, lines: _Lines) -> list[float]:
    if len(words) < n + 1:
        raise InputError(
            "numbers are missing", where=lines.where, found=f"{len(words) - 1}", needed=f"{n}"
        )
    return [finite(word, lines.where) for word in words[1 : n + 1]]


def _count(words: list[str], lines: _Lines) -> int:
    count = whole(words[1] if len(words) > 1 else "", lines.where)
    if not 0 <= count <= _LARGEST_COUNT:
        raise InputError("a count is out of range", where=lines.where, found=str(count))
    return count


def _collect(path: Path, materials: list[str], objects: list[_Object]) -> RoomModel:
    surfs = [s for this in objects for s in this.surfs if s.corners]
    if not surfs:
        raise InputError(
            "the room file has no faces", where=str(path), hint="the file may be cut short"
        )
    n_sheets = sum(s.two_sided for s in surfs)
    sheets_meant = 0 < n_sheets < len(surfs)
    vertices: list[FloatArray] = []
    faces: list[Face] = []
    first = 0
    for this in objects:
        own = np.array(this.vertices, dtype=np.float64).reshape(-1, 3)
        with np.errstate(over="ignore", invalid="ignore"):
            vertices.append(own @ this.turn.T + this.shift)
        for surf in (s for s in this.surfs if s.corners):
            _check_indices(path, this, surf, len(materials))
            material = materials[surf.material] if surf.material >= 0 else None
            surface = Surface(
                this.name or material or "unnamed", None, material, sheets_meant and surf.two_sided
            )
            faces.append(Face(tuple(c + first for c in surf.corners), surface))
        first += len(own)
    findings = (_sheets(n_sheets, len(surfs)),) if sheets_meant else ()
    return RoomModel(np.concatenate(vertices), tuple(faces), findings)


def _sheets(n_sheets: int, n: int) -> Finding:
    text = (
        f"{n_sheets} of {n} surfaces are marked as two-sided and taken as sheets in the air, such "
        "as curtains. If they belong to the walls, unmark them."
    )
    return Finding(Code.TWO_SIDED_TAKEN_AS_SHEETS, text, {"sheets": n_sheets, "of": n})


def _check_indices(path: Path, this: _Object, surf: _Surf, n_materials: int) -> None:
    n = len(this.vertices)
    for corner in surf.corners:
        if not 0 <= corner < n:
            raise InputError(
                "a face names a corner that does not exist",
                where=f"{path}, object {this.name!r}",
                found=f"corner {corner}",
                needed=f"0 to {n - 1}",
            )
    if not -1 <= surf.material < n_materials:
        raise InputError(
            "a face names a material that does not exist",
            where=f"{path}, object {this.name!r}",
            found=f"material {surf.material}",
            needed=f"0 to {n_materials - 1}",
        )


@dataclass(slots=True)
class _State:
    """What has been read so far, and the names that apply to the next face."""

    vertices: list[tuple[float, float, float]] = field(default_factory=list)
    faces: list[Face] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)  # of each face in the file
    object_name: str | None = None
    group: str | None = None
    material: str | None = None


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
    state = _State()
    for number, words, rest in _statements(read_text(path)):
        where = f"{path}, line {number}"
        match words[0]:
            case "v":
                if len(words) < 4:
                    raise InputError(
                        "a vertex needs three coordinates", where=where, found=" ".join(words)
                    )
                x, y, z = (finite(word, where) for word in words[1:4])
                state.vertices.append((x, y, z))
            case "f" | "fo":
                state.faces.append(_face(words, state, where))
                state.lines.append(number)
            case "usemtl":
                state.material = rest or None
            case "g":
                state.group = rest or None
            case "o":
                state.object_name = rest or None
    if not state.faces:
        raise InputError(
            "the room file has no faces",
            where=str(path),
            found=f"{len(state.vertices)} vertices",
            needed='lines that start with "f"',
            hint="export again with faces, or check that this is an OBJ file",
        )
    _check_corners(path, state)
    return RoomModel(np.array(state.vertices).reshape(-1, 3), tuple(state.faces))


def _statements(text: str) -> Iterator[tuple[int, list[str], str]]:
    """Yield line number, words without comment, and all that follows the first word.

    A backslash at its end continues a line. A name may contain a "#", as in "Material #25".
    """
    pending, first = "", 0
    for number, line in enumerate(text.split("\n"), start=1):
        first = first or number
        pending += line
        if pending.endswith("\\"):
            pending = pending[:-1] + " "
            continue
        words = pending.split("#", 1)[0].split()
        if words:
            yield first, words, pending.strip()[len(words[0]) :].strip()
        pending, first = "", 0


def _face(words: list[str], state: _State, where: str) -> Face:
    if len(words) < 4:
        raise InputError(
            "a face has fewer than three corners",
            where=where,
            found=" ".join(words),
            needed="at least three",
            hint="the file may be cut short: export it again",
        )
    corners = []
    for word in words[1:]:
        index = whole(word.split("/", 1)[0], where)
        # 1 is the first vertex, -1 the latest; 0 is nothing and is refused with the others
        corners.append(index - 1 if index > 0 else len(state.vertices) + index if index else -1)
    name = state.object_name or state.group or state.material or "unnamed"
    return Face(tuple(corners), Surface(name, state.group, state.material))


def _check_corners(path: Path, state: _State) -> None:
    n = len(state.vertices)
    for face, line in zip(state.faces, state.lines, strict=True):
        for corner in face.corners:
            if not 0 <= corner < n:
                raise InputError(
                    "a face names a corner that does not exist",
                    where=f"{path}, line {line}",
                    found=f"corner {corner + 1}",
                    needed=f"1 to {n}, or -1 to -{n} counted back",
                    hint="the file may be cut short: export it again",
                )


_CODES = {
    "char": "b",
    "uchar": "B",
    "short": "h",
    "ushort": "H",
    "int": "i",
    "uint": "I",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "float": "f",
    "double": "d",
    "float32": "f",
    "float64": "d",
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_CORNERS = ("vertex_indices", "vertex_index")
_HEADER_END = b"end_header"


@dataclass(frozen=True, slots=True)
class _Property:
    name: str
    code: str  # of `struct`
    count_code: str  # of a list's length; empty where there is one value


@dataclass(frozen=True, slots=True)
class _Element:
    name: str
    count: int
    properties: list[_Property]


def read_ply(path: Path) -> RoomModel:
    """Read vertices and polygons of a PLY file [1]_; everything else in it is passed over.

    The format carries no names: there is one surface, named as the file, without a material.

    Raises
    ------
    InputError
        Not a PLY file, cut short, without faces, or with coordinates that are not finite.

    References
    ----------
    .. [1] G. Turk, "The PLY polygon file format" (1994).
    """
    order, elements, body = _header(path, read_bytes(path))
    numbers = _TextNumbers(path, body) if order == "" else _BinaryNumbers(path, body, order)
    surface = Surface(path.stem or "unnamed")
    points: list[list[float]] = []
    faces: list[Face] = []
    for element in elements:
        for number in range(element.count if element.properties else 0):
            where = f"{path}, {element.name} {number}"
            row = {p.name: _value(p, numbers) for p in element.properties}
            if element.name == "vertex":
                points.append([_coordinate(row, a, where) for a in "xyz"])
            elif element.name == "face":
                corners = next((row[name] for name in _CORNERS if name in row), [])
                faces.append(Face(tuple(int(c) for c in corners), surface))
    if not faces or not points:
        raise InputError(
            "the room file has no faces",
            where=str(path),
            found=f"{len(points)} vertices and {len(faces)} faces",
        )
    return RoomModel(np.array(points), tuple(faces))


def _coordinate(row: dict[str, list[float]], axis: str, where: str) -> float:
    if not row.get(axis):
        raise InputError("a vertex needs three coordinates", where=where, needed="x, y and z")
    return finite(str(row[axis][0]), where)


def _header(path: Path, content: bytes) -> tuple[str, list[_Element], bytes]:
    """Return byte order ("" for text), the elements, and what follows the header."""
    head, found, rest = content.partition(_HEADER_END)
    lines = head.decode("latin-1").splitlines()
    if not found or not lines or lines[0].strip() != "ply":
        raise InputError(
            "this is no PLY file", where=str(path), needed='"ply" first and "end_header" later'
        )
    order, elements = None, list[_Element]()
    for number, line in enumerate(lines, start=1):
        where = f"{path}, line {number}"
        match line.split():
            case ["format", name, _] if name in _ORDERS:
                order = _ORDERS[name]
            case ["element", name, count]:
                elements.append(_Element(name, whole(count, where), []))
            case ["property", "list", count, kind, name] if elements:
                code, count_code = _code(kind, where), _code(count, where)
                if count_code in "fd" or (name in _CORNERS and code in "fd"):
                    raise InputError("a PLY list needs whole numbers", where=where, found=line)
                elements[-1].properties.append(_Property(name, code, count_code))
            case ["property", kind, name] if elements:
                elements[-1].properties.append(_Property(name, _code(kind, where), ""))
    if order is None:
        raise InputError(
            "a PLY file of unknown format", where=str(path), needed=f"one of {', '.join(_ORDERS)}"
        )
    return order, elements, rest[rest.find(b"\n") + 1 :]


def _code(kind: str, where: str) -> str:
    if kind not in _CODES:
        raise InputError("unknown PLY type", where=where, found=repr(kind))
    return _CODES[kind]


class _TextNumbers:
    """The numbers of a PLY file in text, one after the other."""

    def __init__(self, path: Path, body: bytes) -> None:
        self._path = path
        self._words: Iterator[str] = iter(body.decode("latin-1").split())

    def take(self, code: str, n: int) -> list[float]:
        """Return the next n numbers of one type."""
        values = []
        for _ in range(n):
            word = next(self._words, None)
            if word is None:
                raise _cut_short(self._path)
            where = str(self._path)
            values.append(finite(word, where) if code in "fd" else whole(word, where))
        return values


class _BinaryNumbers:
    """The numbers of a PLY file in binary, one after the other."""

    def __init__(self, path: Path, body: bytes, order: str) -> None:
        self._path, self._body, self._order, self._next = path, body, order, 0

    def take(self, code: str, n: int) -> list[float]:
        """Return the next n numbers of one type."""
        layout = f"{self._order}{n}{code}"
        if self._next + n * struct.calcsize(code) > len(self._body):
            raise _cut_short(self._path)
        values = struct.unpack_from(layout, self._body, self._next)
        self._next += struct.calcsize(layout)
        return list(values)


def _value(p: _Property, numbers: _TextNumbers | _BinaryNumbers) -> list[float]:
    n = int(numbers.take(p.count_code, 1)[0]) if p.count_code else 1
    return numbers.take(p.code, max(n, 0))


def _cut_short(path: Path) -> InputError:
    return InputError(
        "the room file ends early",
        where=str(path),
        needed="as many numbers as its header declares",
        hint="the file is cut short: export or copy it again",
    )
