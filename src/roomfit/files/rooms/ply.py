"""Stanford PLY, text or binary, polygons kept whole.

Read here and not by trimesh, which cuts concave polygons into a fan: an L-shaped floor of 7 m2 came
out with 16 m2.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roomfit.errors import InputError
from roomfit.files.rooms.model import RoomModel
from roomfit.files.rooms.text import finite, read_bytes, whole
from roomfit.geometry.build import Face
from roomfit.geometry.mesh import Surface

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
        needed="as many numbers as its header promises",
        hint="the file is cut short: export or copy it again",
    )
