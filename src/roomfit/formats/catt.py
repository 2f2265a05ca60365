"""The reader of CATT-Acoustic's .geo files: corners, planes and their parts, materials.

`catt_language` reads statements and evaluates expressions; here they become a room. A plane is cut
into its parts: what an earlier part covers is removed from the later ones.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from roomfit.base.door import check_limit, read_text
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.polygon import Surface, area_m2, divide, triangulate
from roomfit.base.typing import FloatArray, IntArray
from roomfit.formats.catt_language import GeoFile, Line, corner_of, read_files, split_outside
from roomfit.formats.model import Polygon, RoomModel, joined, no_faces

_MOST_CORNERS = 2000
_MOST_PLANES = 20_000
# Other programs whose files end so: what stands in them, and what helps
_OTHERS = {
    "Gmsh": (
        r"(?im)^[ \t]*(setfactory|point|line|(plane|physical) surface|(line|curve) loop)[ \t]*\(",
        "save its surfaces as STL or PLY there, by File, Export",
    ),
    "ESP-r": (
        r"(?im)\A([ \t]*(#.*)?\n)*[ \t]*(\*geometry\b|gen[ \t]+\S+[ \t])",
        "write it as DXF with ESP-r's converter: ecnv -if esp -of dxf",
    ),
}
_UNCOVERED = 1e-4  # share of a plane that its parts may leave open


class _Part(NamedTuple):
    """One piece of a plane, such as the door in a wall."""

    name: str
    corners: tuple[int, ...]  # numbers as the file writes them
    material: str


class _Plane(NamedTuple):
    """One plane of a .geo file."""

    number: int
    corners: tuple[int, ...]
    parts: tuple[_Part, ...]  # in order: an earlier part hides what a later one covers as well
    line: Line

    def renumbered(self, number: int, corners: int | IntArray, sense: int = 1) -> _Plane:
        """Return a plane with so much added to its numbers, its corners turned for sense -1."""

        def new(old: tuple[int, ...]) -> tuple[int, ...]:
            return tuple((np.array(old)[::sense] + corners).tolist())

        parts = tuple(part._replace(corners=new(part.corners)) for part in self.parts)
        return self._replace(number=self.number + number, corners=new(self.corners), parts=parts)


def read_catt(path: Path) -> RoomModel:
    """Read a room from a .geo file of CATT-Acoustic and the files that it includes.

    Metres, z up. The name of a surface is its plane's number (OFFSETPL and MIRROR added), its
    group the name of the plane or of its part, its material the one of the plane; where
    ``ABS a = b`` says that a is b, it is b. Upper and lower case are the same; the spelling of the
    ABS statement, or else the first one met, is kept. Absorption and scattering of ABS statements
    are not used: they are what roomfit is to find.

    OFFSETCO, OFFSETPL, MIRROR, OBJECT with TRANSLATE and LOCAL apply to their own file.
    MIRROR adds the image at x = 0 of every corner, and of every plane that names no image itself
    and is not its own image.
    """
    text = read_text(path, "room file")
    for of, (sign, hint) in _OTHERS.items():
        if re.search(sign, text):
            what = f"this is a geometry of {of}"
            needed = "a .geo of CATT-Acoustic, or another format"
            raise InputError(what, where=str(path), found=of, needed=needed, hint=hint)
    files = read_files(path)
    materials, findings = _materials(files)
    polygons: list[Polygon] = []
    used: dict[int, str] = {}
    n_pairs = 0
    for file in files:
        for plane in _planes(file):
            if plane.number in used:
                needed = f"a number of its own: {used[plane.number]} has it"
                hint = "OFFSETPL keeps the planes of included files apart"
                what = "a plane number is given twice"
                raise plane.line.error(what, needed, str(plane.number), hint)
            used[plane.number] = plane.line.where
            check_limit("faces", len(used), plane.line.where)
            n_pairs += len(plane.parts) ** 2 - 1
            check_limit("part_pairs", n_pairs, plane.line.where)
            polygons += _polygons(plane, file, materials)
    if not polygons:
        needed = "PLANES, and below it [number name / corners / material]"
        raise no_faces(path, "no line below PLANES", needed)
    vertices, faces = joined(polygons)
    return RoomModel(vertices, faces, findings, "m", "z")


def _planes(file: GeoFile) -> Iterator[_Plane]:
    """Yield the planes of one file with final numbers of planes and corners, images behind each."""
    for line in file.lines["planes"]:
        for written in _written(line):
            plane = written.renumbered(file.added("offsetpl"), file.added("offsetco"))
            yield plane
            # one that names images itself has no other
            if file.lines["mirror"] and all(c in file.shared.corners for c in plane.corners):
                points = np.round([corner_of(file.shared, c, line) for c in plane.corners], 6) + 0.0
                ring = set(map(tuple, points.tolist()))
                if ring != {(0.0 - x, y, z) for x, y, z in ring}:
                    yield plane.renumbered(file.added("mirror", 1), file.added("mirror"), -1)


def _written(line: Line) -> list[_Plane]:
    """Return the plane that a text between brackets describes, or the planes of a plane loop.

    ``30 wall / 5 6 56 55 / brick`` ; with ``\\`` for ``/`` the other side reflects ; corners 5 to
    8 may be written 5-8 ; ``(door / 1 2 3 4 / wood)`` for parts ; ``*5 1 panel // 1 2 8 7 /
    wood`` for five planes, each with numbers one higher (or as the list between the two slashes
    says). A ``*`` behind a name or a material asks CATT-Acoustic for scattering at edges and an s
    behind a corner hides an edge: neither changes the room.
    """
    is_turned = len(split_outside(line.text, "\\")) > 1
    head, *fields = split_outside(line.text, "\\" if is_turned else "/")
    match = re.fullmatch(r"(?:\*\s*(\d{1,6})\s+)?(\d{1,9})\b\s*(.*)", head, re.ASCII)
    fields = fields if match and match[1] else ["", *fields]
    if match is None or len(fields) != 3 or (is_turned and len(split_outside(line.text, "/")) > 1):
        raise _malformed(line)
    number, times, name = int(match[2]), int(match[1] or 1), match[3].rstrip("* ")
    sense = -1 if is_turned else 1
    steps, corners = _corners(fields[0], line), _outline(fields[1], line)
    parts = tuple(_parts(fields[2], line))
    steps = steps or (1,) * len(corners)
    if not 1 <= times <= _MOST_PLANES or (match[1] and (parts or len(steps) != len(corners))):
        raise _malformed(line)
    parts = parts or (_Part(name, corners, _material(fields[2], line)),)
    plane, sense = _Plane(number, corners, parts, line), -1 if is_turned else 1
    loop = (plane.renumbered(k, k * np.array(steps), 1) for k in range(1, times))
    return [p.renumbered(0, 0, sense) for p in (plane, *loop)]


def _outline(text: str, line: Line) -> tuple[int, ...]:
    corners = _corners(text, line)
    if len(corners) < 3:
        found = text.strip()[:60] or "none"
        raise line.error("a plane has fewer than three corners", "three or more", found)
    return corners


def _corners(text: str, line: Line) -> tuple[int, ...]:
    corners: list[int] = []
    for token in re.sub(r" ?- ?", "-", " ".join(text.split())).split():
        match = re.fullmatch(r"(\d{1,9})s?(?:-(\d{1,9})s?)?", token, re.ASCII | re.IGNORECASE)
        if match is None:
            needed = "corner numbers such as 5 or 5-8"
            raise line.error("a corner number was expected", needed, repr(token[:40]))
        first, last = int(match[1]), int(match[2] or match[1])
        if abs(last - first) + len(corners) >= _MOST_CORNERS:
            raise line.error("a plane has too many corners", f"at most {_MOST_CORNERS}", token)
        step = 1 if last >= first else -1
        corners.extend(range(first, last + step, step))
    return tuple(corners)


def _parts(text: str, line: Line) -> list[_Part]:
    """Return the parts ``(name / corners / material)`` of a plane, none where it has none."""
    if not text.startswith("("):
        return []
    if re.sub(r"\([^()]*\)", "", text).strip():
        raise _malformed(line)
    parts = []
    for inner in re.findall(r"\(([^()]*)\)", text):
        fields = re.split(r"[/\\]", inner)
        if len(fields) != 3:
            raise _malformed(line)
        name = fields[0].strip().rstrip("* ")
        parts.append(_Part(name, _outline(fields[1], line), _material(fields[2], line)))
    return parts


def _material(text: str, line: Line) -> str:
    name = text.strip().rstrip("* ").strip('"').strip()
    if not name or any(mark in name for mark in "()[]<>{}"):
        raise _malformed(line)
    return name


def _malformed(line: Line) -> InputError:
    return line.error(
        "a plane of the .geo file is not understood",
        "[number name / corners / material], or (name / corners / material) for its parts",
        f"[{line.text.strip()[:80]}]",
    )


def _polygons(plane: _Plane, file: GeoFile, materials: dict[str, str]) -> list[Polygon]:
    """Return what shows of each part of a plane, which the parts must make up."""

    def points_m(corners: tuple[int, ...]) -> FloatArray:
        return np.array([corner_of(file.shared, number, plane.line) for number in corners])

    polygons: list[Polygon] = []
    for part, pieces in zip(
        plane.parts, cut_parts([points_m(p.corners) for p in plane.parts]), strict=True
    ):
        if not pieces:
            what, needed = "a part of a plane is hidden by the parts before it", "parts that show"
            found = f"{part.name!r} of plane {plane.number}"
            raise plane.line.error(what, needed, found, "put the smaller part first")
        material = materials.setdefault(part.material.lower(), part.material)
        surface = Surface(str(plane.number), part.name or None, material)
        polygons += [(piece, surface) for piece in pieces]
    whole_m2 = area_m2([points_m(plane.corners)])
    covered_m2 = area_m2([piece for piece, _ in polygons])
    if not abs(covered_m2 - whole_m2) <= _UNCOVERED * whole_m2:
        found = f"{covered_m2:.4g} m2 of parts in plane {plane.number} of {whole_m2:.4g} m2"
        hint = "give the rest a part of its own, as in (wall / 1 2 3 4 / brick)"
        what, needed = "the parts of a plane do not make up the plane", "parts that cover the plane"
        raise plane.line.error(what, needed, found, hint)
    return polygons


def cut_parts(parts: list[FloatArray]) -> list[list[FloatArray]]:
    """Return what the earlier parts leave of each part, polygons of shape (n_corners, 3).

    For each part come its polygons, oriented as the part. A part that no other covers comes back
    whole; else the pieces are convex and meet without gaps: both polygons are cut into triangles,
    and what a triangle leaves of a convex piece is, for each of its edges in turn, the share of
    the piece beyond that edge and within all edges before it. Pieces thinner than the tolerance
    at which corners are welded are left out.
    """
    left: list[list[FloatArray]] = []
    taken: list[FloatArray] = []
    for part in parts:
        pieces = [part]
        for hole in taken:
            convex = [t for p in pieces for t in (_triangles(p) if len(p) > 3 else [p])]
            divided = [divide(piece, hole) for piece in convex]
            if any(inner is not None for inner, _ in divided):
                pieces = [p for _, outside in divided for p in outside]
        left.append(pieces)
        taken.extend(_triangles(part))
    return left


def _triangles(polygon: FloatArray) -> list[FloatArray]:
    return [polygon[corners] for corners in triangulate(polygon).triangles]


def _materials(files: list[GeoFile]) -> tuple[dict[str, str], tuple[Finding, ...]]:
    """Return the name to use for each material in lower case, with "a is b" followed to its end."""
    spelling: dict[str, str] = {}
    stands_for: dict[str, str] = {}
    absorption = r"(?i:abs)\s+([^\s=<]+)\s*(?:=\s*|(?=<))(<[^<>]+>.*|[^<>{}=]+)"
    for line in (line for file in files for line in file.lines["abs"]):
        match = re.fullmatch(absorption, line.text)
        if match is None:
            needed = "ABS name = <10 10 10 10 10 10>, or ABS name = other name"
            raise line.error("an ABS statement is not understood", needed)
        name, rest = match[1].strip('"'), match[2].strip()
        if name.lower() in spelling:
            raise line.error("a material is given twice", "each name once", name)
        spelling[name.lower()] = name
        if not rest.startswith("<"):
            stands_for[name.lower()] = rest.strip('"').strip()
    followed: dict[str, str] = {}
    for name in stands_for:
        end, visited = name, set[str]()
        while end.lower() in stands_for:
            if end.lower() in visited:
                what, needed = "materials that replace each other", "each name led to a material"
                hint = f"give coefficients in a line ABS {name} = <...>"
                raise InputError(what, found=f"{name}, {end}", needed=needed, hint=hint)
            visited.add(end.lower())
            end = stands_for[end.lower()]
        followed[name] = spelling.get(end.lower(), end)
    if not followed:
        return spelling, ()
    evidence = {spelling[name]: end for name, end in followed.items()}
    listed = ", ".join(f"{name} is {end}" for name, end in evidence.items())
    text = f"The file replaces one material by another: {listed}."
    about = About(materials=list(dict.fromkeys(followed.values())))
    return spelling | followed, (Finding(Code.MATERIALS_JOINED, about, text, evidence),)
