"""What readers of rooms share: the specification, the model that they return, reading of files."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from roomfit.base.arguments import check_known
from roomfit.base.errors import InputError
from roomfit.base.findings import Finding
from roomfit.base.typing import FloatArray
from roomfit.room.build import Face
from roomfit.room.mesh import Surface

OF_SEVERAL = (".ifc", ".json")  # files that may have several rooms
METRES_PER_UNIT = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "ft": 0.3048, "in": 0.0254}


class Thing(NamedTuple):
    """What stands in a room and is no wall of it, as a bed."""

    kind: str
    outline_m: FloatArray  # (n_corners, 3): on the floor; none where that is not known
    height_m: float


@dataclass(frozen=True, slots=True, eq=False)
class RoomModel:
    """The polygons of a file."""

    vertices: FloatArray  # (n_vertices, 3); in the file's own unit and axes
    faces: tuple[Face, ...]
    findings: tuple[Finding, ...] = ()  # what the reader doubts
    unit: str | None = None  # unit that the format prescribes, None where it prescribes none
    # Axis that points up by the format's standard or habit, where the caller says nothing
    up: str = "z"
    things: tuple[Thing, ...] = ()  # in the axes of the vertices


Polygon = tuple[FloatArray, Surface]  # corners of shape (n_corners, 3), and whose they are


def joined(polygons: Sequence[Polygon]) -> tuple[FloatArray, tuple[Face, ...]]:
    """Return vertices, shape (n_vertices, 3), and faces of polygons with corners of their own."""
    ends = np.cumsum([len(points) for points, _ in polygons])
    faces = tuple(
        Face(tuple(range(end - len(points), end)), surface)
        for end, (points, surface) in zip(ends.tolist(), polygons, strict=True)
    )
    return np.concatenate([points for points, _ in polygons]), faces


def in_metres(model: RoomModel, unit: str | None, up: str | None, where: str) -> FloatArray:
    """Return the vertices in metres with z up, shape (n_vertices, 3).

    ``up = "y"`` maps (x, y, z) to (x, -z, y), which is a rotation: nothing is mirrored. Refused
    is an unknown unit, or none where the format gives none either.
    """
    chosen = unit or model.unit
    known = ", ".join(METRES_PER_UNIT)
    if chosen is None:
        raise InputError(
            "the unit of the room file is not known",
            where=where,
            needed=f"one of {known}: this format carries none",
            hint='add unit = "m" (or --unit m) and compare the volume that is shown',
            found="no unit",
        )
    compare = "compare the volume that roomfit check shows"
    check_known("unknown unit", chosen, METRES_PER_UNIT, where=where, else_try=compare)
    axis = up or model.up
    if axis not in ("y", "z"):
        needed, hint = '"y" or "z"', "y where the height of the room stands second"
        raise InputError("unknown up axis", where=where, found=repr(axis), needed=needed, hint=hint)
    x, y, z = (model.vertices * METRES_PER_UNIT[chosen]).reshape(-1, 3).T
    return np.stack([x, -z, y] if axis == "y" else [x, y, z], axis=1)


@dataclass(frozen=True, slots=True)
class PolygonSpec:
    """A room as tables of corners and planes."""

    # A corner or a plane in a later file replaces the one of the same number in an earlier
    corners: tuple[Path, ...]
    planes: tuple[Path, ...]
    # the planes of that table replace one plane
    replace: Mapping[str, Path] = field(default_factory=dict)
    drop: tuple[str | int, ...] = ()  # numbers of planes that are left out
    # 2 makes a plane a sheet in the air, 1 a wall, whatever its row says
    sides: Mapping[str, int] = field(default_factory=dict)


class UnchosenSpaceError(InputError):
    """A file has several rooms, and nobody says which of them is meant."""


def unknown_space(whole: str, names: Iterable[str], space: str | None, *, hint: str) -> InputError:
    """Return the error of a file with rooms of these names, where `space` is none of them."""
    listed = ", ".join(map(repr, names))[:300]
    if space is not None:
        what = f"{whole} has no such room"
        return InputError(what, found=repr(space), needed=listed, hint=hint)
    needed = 'space = "NAME" under [room], or --space'
    return UnchosenSpaceError(f"{whole} has several rooms", found=listed, needed=needed, hint=hint)


@dataclass(frozen=True, slots=True)
class RoomSpec:
    """Which room to read, and how to understand it. One of the first three is given."""

    # OBJ, AC3D, PLY, 3DS, STL, GLB, CATT-Acoustic's GEO, DXF, COLLADA, IFC, SketchUp's SKP,
    # RoomPlan's JSON or USDZ
    file: Path | None = None
    # Lengths along x, y and z of a box with one corner at the origin
    shoebox: tuple[float, float, float] | None = None
    polygons: PolygonSpec | None = None
    # m, mm, cm, ft or in. None: what the format prescribes (GLB, GEO, shoebox and polygons:
    # m) or the file says (DXF's $INSUNITS, COLLADA, IFC, USDZ, SketchUp).
    unit: str | None = None
    up: str | None = None  # None: what the format prescribes (GLB: y) or COLLADA says; others: z
    # From the name of a surface, a group or a file's material (in that precedence) to a
    # material. Surfaces that are not named keep the file's material name.
    materials: Mapping[str, str] = field(default_factory=dict)
    # Standard deviations of a box's lengths in m, which then are fitted
    lengths_sd: tuple[float, float, float] | None = None
    space: str | None = None  # of a building model (IFC) or a scan (JSON) that has several

    def __post_init__(self) -> None:
        given = [self.file is not None, self.shoebox is not None, self.polygons is not None]
        if sum(given) != 1:
            raise InputError(
                "a room has exactly one source",
                found=f"{sum(given)} of file, shoebox and polygons",
                needed="one of them",
                hint="leave the others out",
            )
        if self.space is not None and Path(self.file or "").suffix.lower() not in OF_SEVERAL:
            what = "only a building model and a scan have spaces"
            needed = f"a file of {' or '.join(OF_SEVERAL)}"
            raise InputError(what, found=self.space, needed=needed, hint="leave space out")


# Far above any room in any unit, far below where squares overflow.
_LARGEST = 1e9
_MOST_DIGITS = 18


def malformed(
    what: str,
    where: str,
    found: str,
    needed: str,
    hint: str = "export the room again, or mend this line",
) -> InputError:
    """Return the error of what stands in the file of a room, in the words of its format."""
    return InputError(what, where=where, found=found, needed=needed, hint=hint)


def finite(token: str, where: str) -> float:
    """Return a coordinate; refuse what is no number, not finite, or absurdly large."""
    try:
        value = float(token)
    except ValueError:
        value = math.nan
    if not abs(value) <= _LARGEST:
        what = "a coordinate is not a finite number"
        raise malformed(what, where, repr(token[:40]), f"a number of size up to {_LARGEST:g}")
    return value


def whole(token: str, where: str) -> int:
    """Return a whole number; refuse anything else."""
    try:
        if len(token) > _MOST_DIGITS:
            raise ValueError
        return int(token)
    except ValueError:
        needed = f"digits alone, {_MOST_DIGITS} at most"
        raise malformed("a whole number was expected", where, repr(token[:40]), needed) from None


def check_corners(corners: Iterable[int], n_vertices: int, where: str) -> None:
    """Refuse a face with a corner that is not there; corners count from 0."""
    for corner in corners:
        if not 0 <= corner < n_vertices:
            what = "a face names a corner that does not exist"
            hint = "export the room again; corners may be counted from 1"
            raise malformed(what, where, f"corner {corner}", f"0 to {n_vertices - 1}", hint)


def damaged(kind: str, path: Path, found: str) -> InputError:
    """Return the error of a file in which a library of others gets lost."""
    what = f"this {kind} file cannot be read"
    hint = "the file may be damaged or cut short: export it again"
    return InputError(what, where=str(path), found=found, needed=f"a whole {kind} file", hint=hint)


def no_faces(
    path: Path,
    found: str = "none",
    needed: str = "faces of three corners or more",
    hint: str | None = None,
) -> InputError:
    """Return the error of a file in which there is no face."""
    return InputError(
        "the room file has no faces", where=str(path), found=found, needed=needed, hint=hint
    )


def counted(kinds: Mapping[str, int]) -> str:
    """Return kinds of entities with their numbers in words, in the order of their names."""
    return ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))


# What a parser of others may raise on a damaged file; anything else is a fault of this program.
PARSER_ERRORS = (
    *(ArithmeticError, AssertionError, AttributeError, EOFError, LookupError, MemoryError),
    *(NotImplementedError, OSError, RecursionError, TypeError, ValueError, struct.error),
)
