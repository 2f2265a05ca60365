"""AC3D (.ac): a tree of objects, each with its own vertices and surfaces."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from roomfit.errors import InputError
from roomfit.files.rooms.model import RoomModel
from roomfit.files.rooms.text import finite, read_text, whole
from roomfit.findings import Finding
from roomfit.geometry.build import Face
from roomfit.geometry.mesh import Surface
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
        """Return the next line, which must start with a word and hold so many words in all."""
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
    """Read the surfaces of an AC3D file [1]_, carried to the places where `rot` and `loc` put them.

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
    return Finding("two-sided-taken-as-sheets", "warning", text, {"sheets": n_sheets, "of": n})


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
