"""Wavefront OBJ: faces with their object, group and material, with or without the .mtl file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from roomfit.errors import InputError
from roomfit.files.rooms.model import RoomModel
from roomfit.files.rooms.text import finite, read_text, whole
from roomfit.geometry.build import Face
from roomfit.geometry.mesh import Surface


@dataclass(slots=True)
class _State:
    """What has been read so far, and the names that hold for the next face."""

    vertices: list[tuple[float, float, float]] = field(default_factory=list)
    faces: list[Face] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)  # where each face stands in the file
    object_name: str | None = None
    group: str | None = None
    material: str | None = None


def read_obj(path: Path) -> RoomModel:
    """Read the faces of an OBJ file [1]_.

    `usemtl` gives the material of a face, `o` its surface name (its group's or material's name
    where there is no `o`), `g` its group. The .mtl file holds only looks and is not opened, so it
    may be missing. Lines, points, curves, normals and texture coordinates are passed over.

    Raises
    ------
    InputError
        No faces, a face of less than three corners or with a corner that does not exist, or a
        coordinate that is not finite; the line is told.

    References
    ----------
    .. [1] Wavefront Technologies, "Advanced Visualizer Manual", appendix B1: Object files.
    """
    state = _State()
    for number, words, rest in _statements(read_text(path)):
        where = f"{path}, line {number}"
        match words[0]:
            case "v":
                state.vertices.append(_vertex(words, where))
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

    A backslash at its end continues a line. A name may hold a "#", as in "Material #25".
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


def _vertex(words: list[str], where: str) -> tuple[float, float, float]:
    if len(words) < 4:
        raise InputError("a vertex needs three coordinates", where=where, found=" ".join(words))
    return finite(words[1], where), finite(words[2], where), finite(words[3], where)


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
