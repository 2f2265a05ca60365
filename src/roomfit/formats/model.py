"""What the file of a room says: polygons with names, in the file's unit and axes; its refusals."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from roomfit.base.door import check_limit, read_bytes
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding, Severity
from roomfit.base.isolated import isolated
from roomfit.base.polygon import Face, Surface
from roomfit.base.typing import FloatArray

METRES_PER_UNIT = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "ft": 0.3048, "in": 0.0254}
_LARGEST = 1e9  # far above any room in any unit, far below where squares overflow
_MOST_DIGITS = 18


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
    up: str = "z"  # axis that points up by the format, where the caller says nothing
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
    what = "the room file has no faces"
    return InputError(what, where=str(path), found=found, needed=needed, hint=hint)


def counted(kinds: Mapping[str, int]) -> str:
    """Return kinds of entities with their numbers in words, in the order of their names."""
    return ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))


def ignored(text: str, kinds: Mapping[str, int], graded: Severity = "info") -> tuple[Finding, ...]:
    """Return a finding of parts of a file that are no faces, none where there are none."""
    if not kinds:
        return ()
    text = f"{text}: {counted(kinds)}."
    return (Finding(Code.ENTITIES_IGNORED, About(), text, dict(kinds), graded=graded),)


def isolated_polygons(
    path: Path, read: str, library: str, kind: str, install: str, *, most: str = "text_bytes"
) -> tuple[Any, list[Polygon]]:
    """Return what a reader in a process of its own says of a file, and its polygons.

    `read` is "MODULE:FUNCTION" of `isolated`, which returns `outline`.
    """
    content = read_bytes(path, "room file", most=most)
    try:
        with isolated(read, content, library) as (head, array):
            corners, each = (array(shape) for shape in head["shapes"])
            surfaces = [
                Surface(str(name), str(group) or None, str(material) or None)
                for name, group, material in head["surfaces"]
            ]
            check_limit("faces", len(each), str(path))
            check_limit("corners", len(corners), str(path))
            return head, _cut(corners, each, surfaces)
    except ValueError as error:
        if "ModuleNotFoundError" in str(error):
            what = f"{path.suffix} files are read by {library}, which is not installed"
            found, needed = f"a {path.suffix} file, and no {library}", f"the package {library}"
            hint = f"pip install {install}"
            raise InputError(what, where=str(path), found=found, needed=needed, hint=hint) from None
        if "no faces" in str(error):
            raise no_faces(path, hint="the file may be cut short: export it again") from error
        raise damaged(kind, path, str(error)[:300]) from error


def _cut(corners: FloatArray, each: FloatArray, surfaces: Sequence[Surface]) -> list[Polygon]:
    """Return polygons from all corners, shape (n, 3), and each one's number of corners and surface.

    A ValueError says that they do not go together.
    """
    if corners.ndim != 2 or corners.shape[1:] != (3,) or each.ndim != 2 or each.shape[1:] != (2,):
        raise ValueError("arrays of another shape than it said")
    if not (np.isfinite(corners).all() and (np.abs(corners) < _LARGEST).all()):
        raise ValueError("a coordinate that is not a finite number")
    numbers = each[:, 0].astype(np.int64)
    if (numbers < 1).any() or numbers.sum() != len(corners):
        raise ValueError("polygons of another number of corners than it said")
    parts = np.split(corners, np.cumsum(numbers)[:-1])
    return [(part, surfaces[int(number)]) for part, number in zip(parts, each[:, 1], strict=True)]


Outlines = list[tuple[Any, tuple[str, str, str]]]  # corners (n, 3); name, group and material


def outline(polygons: Outlines, **more: Any) -> tuple[dict[str, Any], list[Any]]:
    """Return polygons as `isolated` passes them on: all corners, how many and whose each has."""
    if not polygons:
        raise ValueError("no faces")
    surfaces = list(dict.fromkeys(surface for _, surface in polygons))
    number = {surface: i for i, surface in enumerate(surfaces)}
    corners = np.concatenate([np.asarray(c, dtype=np.float64) for c, _ in polygons])
    each = np.array([(len(c), number[s]) for c, s in polygons], dtype=np.float64)
    return {"shapes": [corners.shape, each.shape], "surfaces": surfaces, **more}, [corners, each]
