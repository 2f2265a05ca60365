"""Planes of a .geo file: which corners in which order, which material, which parts."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from roomfit.errors import InputError
from roomfit.files.rooms.catt.statements import Line
from roomfit.files.rooms.text import whole

_MOST_CORNERS = 2000
_MOST_PLANES = 20_000


@dataclass(frozen=True, slots=True)
class Part:
    """One piece of a plane, such as the door in a wall.

    Attributes
    ----------
    name : str
    corners : tuple of int
        Numbers as the file writes them.
    material : str
    """

    name: str
    corners: tuple[int, ...]
    material: str


@dataclass(frozen=True, slots=True)
class GeoPlane:
    """One plane of a .geo file.

    Attributes
    ----------
    number : int
    outline : Part
        Its material is empty where the plane has parts.
    parts : tuple of Part
        In order: an earlier part hides what a later one covers as well.
    where : str
        File and line.
    """

    number: int
    outline: Part
    parts: tuple[Part, ...]
    where: str


def parse_planes(line: Line) -> list[GeoPlane]:
    """Return the plane that a text between brackets describes, or the planes of a plane loop.

    ``30 wall / 5 6 56 55 / brick`` ; with ``\\`` for ``/`` the other side reflects ; corners
    5 to 8 may be written 5-8 ; ``(door / 1 2 3 4 / wood)`` for parts ; ``*5 1 panel // 1 2 8 7 /
    wood`` for five planes, each with numbers one higher (or as the list between the two slashes
    says). A ``*`` behind a name or a material asks CATT-Acoustic for scattering at edges and an s
    behind a corner hides an edge: neither changes the room.

    Raises
    ------
    InputError
        It is not of this form.
    """
    head, fields, turned = _fields(line)
    times, number, name = _head(head, line)
    steps: tuple[int, ...] | None = None
    if times is not None:
        if len(fields) != 3:
            raise _malformed(line)
        steps = _corners(fields.pop(0), line) if fields[0].strip() else None
        if not fields[0].strip():
            fields.pop(0)
    if len(fields) != 2:
        raise _malformed(line)
    corners = _outline(fields[0], turned, line)
    parts = _parts(fields[1], turned, line)
    material = "" if parts else _material(fields[1], line)
    plane = GeoPlane(number, Part(name, corners, material), parts, line.where)
    if times is None:
        return [plane]
    return _loop(plane, times, steps, turned, line)


def _fields(line: Line) -> tuple[str, list[str], bool]:
    """Split at the slashes outside round brackets; backslashes turn the plane over."""
    pieces, depth, marks = [""], 0, set()
    for letter in line.text:
        depth += (letter == "(") - (letter == ")")
        if letter in "/\\" and depth == 0:
            pieces.append("")
            marks.add(letter)
        else:
            pieces[-1] += letter
    if depth != 0 or len(marks) != 1:
        raise _malformed(line)
    return pieces[0].strip(), pieces[1:], marks == {"\\"}


def _head(head: str, line: Line) -> tuple[int | None, int, str]:
    match = re.fullmatch(r"(?:\*\s*(\d{1,6})\s+)?(\d{1,9})\b\s*(.*)", head, re.ASCII)
    if match is None:
        raise _malformed(line)
    times = int(match.group(1)) if match.group(1) else None
    if times is not None and not 1 <= times <= _MOST_PLANES:
        raise _malformed(line)
    return times, int(match.group(2)), match.group(3).rstrip("* ")


def _outline(text: str, turned: bool, line: Line) -> tuple[int, ...]:
    corners = _corners(text, line)
    if len(corners) < 3:
        raise InputError(
            "a plane has fewer than three corners",
            where=line.where,
            found=text.strip()[:60] or "none",
        )
    return corners[::-1] if turned else corners


def _corners(text: str, line: Line) -> tuple[int, ...]:
    corners: list[int] = []
    for token in re.sub(r"\s*-\s*", "-", text).split():
        match = re.fullmatch(r"(\d{1,9})s?(?:-(\d{1,9})s?)?", token, re.ASCII | re.IGNORECASE)
        if match is None:
            raise InputError(
                "a corner number was expected",
                where=line.where,
                found=repr(token[:40]),
                needed="corner numbers such as 5 or 5-8",
            )
        first = whole(match.group(1), line.where)
        last = whole(match.group(2) or match.group(1), line.where)
        if abs(last - first) + len(corners) >= _MOST_CORNERS:
            raise InputError("a plane has too many corners", where=line.where, found=token)
        step = 1 if last >= first else -1
        corners.extend(range(first, last + step, step))
    return tuple(corners)


def _parts(text: str, turned: bool, line: Line) -> tuple[Part, ...]:
    text = text.strip()
    if not text.startswith("("):
        return ()
    if not text.endswith(")") or re.search(r"\)[^(]*[^(\s][^(]*\(", text):
        raise _malformed(line)
    parts = []
    for inner in text[1:-1].split("("):
        fields = re.split(r"[/\\]", inner.strip().removesuffix(")"))
        if len(fields) != 3:
            raise _malformed(line)
        name = fields[0].strip().rstrip("* ")
        parts.append(Part(name, _outline(fields[1], turned, line), _material(fields[2], line)))
    return tuple(parts)


def _material(text: str, line: Line) -> str:
    name = text.strip().rstrip("* ").strip('"').strip()
    if not name or any(mark in name for mark in "()[]<>{}"):
        raise _malformed(line)
    return name


def _loop(
    plane: GeoPlane, times: int, steps: tuple[int, ...] | None, turned: bool, line: Line
) -> list[GeoPlane]:
    outline = plane.outline
    each = steps or (1,) * len(outline.corners)
    if plane.parts or len(each) != len(outline.corners):
        raise _malformed(line)
    each = each[::-1] if turned else each
    return [
        replace(
            plane,
            number=plane.number + k,
            outline=replace(
                outline,
                corners=tuple(c + k * s for c, s in zip(outline.corners, each, strict=True)),
            ),
        )
        for k in range(times)
    ]


def _malformed(line: Line) -> InputError:
    return InputError(
        "a plane of the .geo file is not understood",
        where=line.where,
        found=f"[{line.text.strip()[:80]}]",
        needed="[number name / corners / material], or (name / corners / material) for its parts",
    )
