"""Constants and corners of all files of a room, worked out when they are asked for."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import partial

from roomfit.errors import InputError
from roomfit.files.rooms.catt.expressions import Names, Point, lock_on_plane, value_of
from roomfit.files.rooms.catt.statements import GeoFile, Line

_DEEPEST = 100


@dataclass(slots=True)
class CornerSource:
    """Where a corner comes from: three expressions in the words of one file."""

    names: FileNames
    expressions: tuple[str, str, str]
    where: str
    loop: tuple[str, float] | None = None  # name and value of the running number
    point: Point | None = None


@dataclass(slots=True)
class Shared:
    """What all files see: global constants, and corners by their final number."""

    constants: dict[str, tuple[FileNames, Line]] = field(default_factory=dict)
    corners: dict[int, CornerSource] = field(default_factory=dict)
    under_way: list[str] = field(default_factory=list)
    mirrors: set[int] = field(default_factory=set)  # what any file's MIRROR adds to corners


@dataclass(slots=True)
class FileNames:
    """The names that the expressions of one file know.

    Attributes
    ----------
    shared : Shared
    file : GeoFile
    local : dict
        Constants of this file alone.
    offset : int
        What OFFSETCO adds to its corner numbers.
    mirror : tuple of two ints or None
        What MIRROR adds to numbers of mirrored corners and planes.
    shift : tuple of three floats
        TRANSLATE.
    """

    shared: Shared
    file: GeoFile
    local: dict[str, Line] = field(default_factory=dict)
    offset: int = 0
    mirror: tuple[int, int] | None = None
    shift: Point = (0.0, 0.0, 0.0)

    def constant(self, name: str, where: str) -> float:
        """Return the value of a constant: this file's, or everybody's."""
        owner, line = self, self.local.get(name)
        if line is None:
            if name not in self.shared.constants:
                raise InputError("a constant is not defined", where=where, found=name)
            owner, line = self.shared.constants[name]
        with _Step(self.shared, f"constant {name} of {owner.file.path.name}", where):
            return value_of(line.text, owner, line.where)

    def corner(self, number: int, where: str) -> Point:
        """Return a corner by the number that this file writes for it, before TRANSLATE."""
        x, y, z = corner_of(self.shared, number + self.offset, where)
        if not any(self.shift):
            return x, y, z
        source = self.shared.corners.get(number + self.offset)
        if source is None or source.names is not self:
            raise InputError(
                "an object that TRANSLATE moves refers to a corner outside it",
                where=where,
                found=f"corner {number}",
                needed="corners of its own file, and not their mirror images",
            )
        return x - self.shift[0], y - self.shift[1], z - self.shift[2]


@dataclass(frozen=True, slots=True)
class _InLoop:
    """The names of a file and the running number of a loop."""

    names: FileNames
    running: str
    value: float

    def constant(self, name: str, where: str) -> float:
        return self.value if name == self.running else self.names.constant(name, where)

    def corner(self, number: int, where: str) -> Point:
        return self.names.corner(number, where)


@dataclass(slots=True)
class _Step:
    """One step of working something out: refuses circles and endless chains."""

    shared: Shared
    what: str
    where: str

    def __enter__(self) -> None:
        way = self.shared.under_way
        if self.what in way or len(way) > _DEEPEST:
            raise InputError(
                "numbers of the .geo file go in a circle, or refer to each other too often",
                where=self.where,
                found=" -> ".join([*way[-4:], self.what]),
            )
        way.append(self.what)

    def __exit__(self, *error: object) -> None:
        self.shared.under_way.pop()


def corner_of(shared: Shared, number: int, where: str) -> Point:
    """Return a corner in metres by its final number.

    Raises
    ------
    InputError
        There is none, or it cannot be worked out.
    """
    source = shared.corners.get(number)
    if source is None:
        original = _original(shared, number)
        if original is None:
            raise InputError("no corner has this number", where=where, found=str(number))
        x, y, z = corner_of(shared, original, where)
        return -x, y, z
    if source.point is None:
        with _Step(shared, f"corner {number}", where):
            source.point = _worked_out(source)
    return source.point


def _original(shared: Shared, number: int) -> int | None:
    """Return the number of the corner whose mirror image this number means."""
    for offset in sorted(shared.mirrors):
        source = shared.corners.get(number - offset)
        if source and source.names.mirror and source.names.mirror[0] == offset:
            return number - offset
    return None


def _worked_out(source: CornerSource) -> Point:
    names: Names = source.names
    if source.loop:
        names = _InLoop(source.names, *source.loop)
    point = [0.0, 0.0, 0.0]
    locked = [k for k in range(3) if re.search(r"(?i)\block\s*\(", source.expressions[k])]
    if len(locked) > 1:
        raise InputError("a corner has more than one lock()", where=source.where)
    for axis in (0, 1, 2):
        if axis not in locked:
            point[axis] = value_of(source.expressions[axis], names, source.where)
    for axis in locked:
        place = partial(lock_on_plane, axis, point, where=source.where)
        point[axis] = value_of(source.expressions[axis], names, source.where, place)
    x, y, z = (p + s for p, s in zip(point, source.names.shift, strict=True))
    return x, y, z
