"""The reader of CATT-Acoustic's .geo files: corners, planes and their parts, materials.

`catt_language` reads statements and evaluates expressions; here they become a room. A plane is cut
into its parts: what an earlier part covers is removed from the later ones.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from roomfit.base.door import check_limit
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.polygon import WELD_TOLERANCE_M, Face, Surface, area_vector_m2, triangulate
from roomfit.base.typing import FloatArray
from roomfit.formats.catt_language import (
    CornerSource,
    GeoFile,
    Line,
    Shared,
    corner_of,
    read_files,
    value_of,
)
from roomfit.formats.model import Polygon, RoomModel, joined, malformed, whole

_MOST_STEPS = 10_000


def define_names(files: list[GeoFile]) -> None:
    """Enter constants, directives and corners of every file where its expressions find them."""
    shared = files[0].shared
    for file in files:
        for kind, line in file.constants:
            name, expression = _definition(line)
            known = shared.constants if kind == "global" else file.local
            if name in known:
                raise line.error("a constant is given twice", found=name)
            if kind == "global":
                shared.constants[name] = (file, expression)
            else:
                file.local[name] = expression
    for file in files:
        _obey_directives(file)
    for file in files:
        for line in file.corners:
            _add_corners(file, line)
    _check_images(shared)


def _check_images(shared: Shared) -> None:
    """Two corners must not share a number, one of them as a mirror image."""
    images: dict[int, CornerSource] = {}
    for number, source in shared.corners.items():
        if source.file.mirror is None:
            continue
        image = number + source.file.mirror[0]
        other = shared.corners.get(image) or images.get(image)
        if other is not None:
            raise malformed(
                "a corner and the mirror image of another have the same number",
                other.where,
                f"{image}, the image of corner {number}",
                f"another number than {image}",
                "let MIRROR add a larger number",
            )
        images[image] = source


def _definition(line: Line) -> tuple[str, Line]:
    match = re.fullmatch(r"\w+\s+([A-Za-z_]\w*)\s*=\s*([^=\"]+)", line.text, re.ASCII)
    if match is None:
        raise line.error(
            "a constant of the .geo file is not understood",
            needed="GLOBAL or LOCAL, a name, = and a number or an expression",
        )
    return match.group(1).lower(), Line(match.group(2), line.where)


def _obey_directives(file: GeoFile) -> None:
    def numbers(word: str, count: int) -> list[float] | None:
        line = file.directives.get(word)
        if line is None:
            return None
        words = line.text.split()[1:]
        if len(words) != count:
            raise line.error(f"{word.upper()} needs {count} number{'s' if count > 1 else ''}")
        return [value_of(text, file, line.where) for text in words]

    offset = numbers("offsetco", 1)
    mirror = numbers("mirror", 2)
    shift = numbers("translate", 3)
    if offset:
        file.offset = _integer(offset[0], file, "offsetco")
    if mirror:
        file.mirror = (_integer(mirror[0], file, "mirror"), _integer(mirror[1], file, "mirror"))
        file.shared.mirrors.add(file.mirror[0])
    if shift:
        if "object" not in file.directives:
            raise malformed(
                "TRANSLATE without OBJECT",
                file.directives["translate"].where,
                "no line OBJECT in the file",
                "a line OBJECT",
                "add the line OBJECT, or remove TRANSLATE: it moves objects alone",
            )
        file.shift = (shift[0], shift[1], shift[2])


def _integer(value: float, file: GeoFile, word: str) -> int:
    if value != int(value) or value < 0:
        where = file.directives[word].where
        needed = f"a whole number of 0 or more after {word.upper()}"
        raise malformed("a whole number was expected", where, f"{value:g}", needed)
    return int(value)


def _add_corners(file: GeoFile, line: Line) -> None:
    if not line.text[0].isdigit():
        _add_loop(file, line)
        return
    words = split_words(line.text)
    if len(words) != 4:
        raise line.error(
            "a corner needs a number and three coordinates",
            hint="write an expression without blanks, as in 2*w-1",
        )
    source = CornerSource(file, (words[1], words[2], words[3]), line.where)
    _add(file.shared, whole(words[0], line.where) + file.offset, source)


def _add(shared: Shared, number: int, source: CornerSource) -> None:
    if number in shared.corners:
        needed = f"a number of its own: {shared.corners[number].where} has it"
        hint = "OFFSETCO keeps the corners of included files apart"
        raise malformed("a corner number is given twice", source.where, str(number), needed, hint)
    shared.corners[number] = source
    check_limit("corners", len(shared.corners), source.where)


def _add_loop(file: GeoFile, line: Line) -> None:
    """Read ``loop(first, i, start, stop, step, x, y, z)``: one corner for each value of i."""
    match = re.fullmatch(r"loop\s*\((.*)\)", line.text, re.ASCII | re.IGNORECASE)
    arguments = split_words(match.group(1), ",") if match else []
    if len(arguments) != 8 or not re.fullmatch(r"[A-Za-z_]\w*", arguments[1], re.ASCII):
        raise line.error(
            "a loop of the .geo file is not understood",
            needed="loop(first number, name, start, stop, step, x, y, z)",
        )
    number, start, stop, step = (value_of(arguments[k], file, line.where) for k in (0, 2, 3, 4))
    steps = (stop - start) / step if step else -1.0
    if number != int(number) or number < 0 or not 0.0 <= steps + 1e-9 <= _MOST_STEPS:
        raise malformed(
            "a loop that does not end, or has no step",
            line.where,
            f"corners from {number:g}, {start:g} to {stop:g} by {step:g}",
            f"a whole number first, and at most {_MOST_STEPS} steps from start to stop",
            "let step lead from start to stop, as in loop(1,a,0,90,10,...)",
        )
    for k in range(int(steps + 1e-9) + 1):
        running = (arguments[1].lower(), start + k * step)
        expressions = (arguments[5], arguments[6], arguments[7])
        source = CornerSource(file, expressions, line.where, running)
        _add(file.shared, int(number) + k + file.offset, source)


def split_words(text: str, mark: str = " ") -> list[str]:
    """Split at a mark (or at white space) outside brackets."""
    words, depth = [""], 0
    for letter in text:
        depth += (letter == "(") - (letter == ")")
        if depth <= 0 and (letter == mark or (mark == " " and letter.isspace())):
            words.append("")
        else:
            words[-1] += letter
    words = [word.strip() for word in words]
    return [word for word in words if word] if mark == " " else words


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
            if any(_overlap(piece, hole) for piece in _convex(pieces)):
                pieces = [rest for piece in _convex(pieces) for rest in _without(piece, hole)]
        left.append(pieces)
        taken.extend(_triangles(part))
    return left


def area_m2(polygons: list[FloatArray]) -> float:
    """Return the sum of the areas of some polygons."""
    return float(sum(np.linalg.norm(area_vector_m2(polygon)) for polygon in polygons))


def _triangles(polygon: FloatArray) -> list[FloatArray]:
    return [polygon[corners] for corners in triangulate(polygon).triangles]


def _convex(pieces: list[FloatArray]) -> list[FloatArray]:
    return [t for piece in pieces for t in (_triangles(piece) if len(piece) > 3 else [piece])]


def _overlap(piece: FloatArray, hole: FloatArray) -> bool:
    inside = piece
    for edge in range(3):
        inside = _half(inside, *_line(hole, edge), keep_inside=True)
    return not _thin(inside)


def _without(piece: FloatArray, hole: FloatArray) -> list[FloatArray]:
    """Return the convex pieces of a convex polygon outside a triangle of the same plane."""
    if not _overlap(piece, hole):
        return [piece]
    outside: list[FloatArray] = []
    rest = piece
    for edge in range(3):
        line = _line(hole, edge)
        beyond = _half(rest, *line, keep_inside=False)
        if not _thin(beyond):
            outside.append(beyond)
        rest = _half(rest, *line, keep_inside=True)
    return outside


def _line(hole: FloatArray, edge: int) -> tuple[FloatArray, FloatArray]:
    """Return a point of one edge and the unit vector that leads away from the hole."""
    a, b = hole[edge], hole[(edge + 1) % 3]
    outwards = np.cross(b - a, area_vector_m2(hole))
    return a, outwards / np.linalg.norm(outwards)


def _half(
    polygon: FloatArray, point: FloatArray, outwards: FloatArray, *, keep_inside: bool
) -> FloatArray:
    """Clip a convex polygon at a line (Sutherland and Hodgman 1974)."""
    if not len(polygon):
        return polygon
    height = (polygon - point) @ outwards * (-1.0 if keep_inside else 1.0)
    height[np.abs(height) < 0.1 * WELD_TOLERANCE_M] = 0.0
    corners: list[FloatArray] = []
    for k in range(len(polygon)):
        n = (k + 1) % len(polygon)
        if height[k] >= 0.0:
            corners.append(polygon[k])
        if height[k] * height[n] < 0.0:
            share = height[k] / (height[k] - height[n])
            corners.append(polygon[k] + share * (polygon[n] - polygon[k]))
    return np.array(corners).reshape(-1, 3)


def _thin(polygon: FloatArray) -> bool:
    if len(polygon) < 3:
        return True
    edges = np.linalg.norm(np.roll(polygon, -1, axis=0) - polygon, axis=1)
    return bool(2.0 * area_m2([polygon]) <= WELD_TOLERANCE_M * float(edges.sum()))


_MOST_CORNERS = 2000
_MOST_PLANES = 20_000


@dataclass(frozen=True, slots=True)
class Part:
    """One piece of a plane, such as the door in a wall."""

    name: str
    corners: tuple[int, ...]  # numbers as the file writes them
    material: str


@dataclass(frozen=True, slots=True)
class GeoPlane:
    """One plane of a .geo file."""

    number: int
    outline: Part  # its material is empty where the plane has parts
    parts: tuple[Part, ...]  # in order: an earlier part hides what a later one covers as well
    where: str  # file and line


def parse_planes(line: Line) -> list[GeoPlane]:
    """Return the plane that a text between brackets describes, or the planes of a plane loop.

    ``30 wall / 5 6 56 55 / brick`` ; with ``\\`` for ``/`` the other side reflects ; corners 5 to
    8 may be written 5-8 ; ``(door / 1 2 3 4 / wood)`` for parts ; ``*5 1 panel // 1 2 8 7 /
    wood`` for five planes, each with numbers one higher (or as the list between the two slashes
    says). A ``*`` behind a name or a material asks CATT-Acoustic for scattering at edges and an s
    behind a corner hides an edge: neither changes the room.
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
        raise line.error("a plane has fewer than three corners", found=text.strip()[:60] or "none")
    return corners[::-1] if turned else corners


def _corners(text: str, line: Line) -> tuple[int, ...]:
    corners: list[int] = []
    for token in re.sub(r" ?- ?", "-", " ".join(text.split())).split():
        match = re.fullmatch(r"(\d{1,9})s?(?:-(\d{1,9})s?)?", token, re.ASCII | re.IGNORECASE)
        if match is None:
            raise line.error(
                "a corner number was expected",
                found=repr(token[:40]),
                needed="corner numbers such as 5 or 5-8",
            )
        first = whole(match.group(1), line.where)
        last = whole(match.group(2) or match.group(1), line.where)
        if abs(last - first) + len(corners) >= _MOST_CORNERS:
            raise line.error("a plane has too many corners", found=token)
        step = 1 if last >= first else -1
        corners.extend(range(first, last + step, step))
    return tuple(corners)


def _parts(text: str, turned: bool, line: Line) -> tuple[Part, ...]:
    text = text.strip()
    if not text.startswith("("):
        return ()
    between = (group.partition(")")[2] for group in text.split("(")[:-1])
    if not text.endswith(")") or any(words.strip() for words in between):
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

    def copy(k: int) -> GeoPlane:
        return _renumbered(
            plane, k, lambda corners: (c + k * s for c, s in zip(corners, each, strict=True))
        )

    return [copy(k) for k in range(times)]


def _renumbered(
    plane: GeoPlane, add: int, corners: Callable[[tuple[int, ...]], Iterable[int]]
) -> GeoPlane:
    """Return a plane with a number so much higher and other corners, those of its parts as well."""

    def part(old: Part) -> Part:
        return replace(old, corners=tuple(corners(old.corners)))

    parts = tuple(part(old) for old in plane.parts)
    return replace(plane, number=plane.number + add, outline=part(plane.outline), parts=parts)


def _malformed(line: Line) -> InputError:
    return line.error(
        "a plane of the .geo file is not understood",
        found=f"[{line.text.strip()[:80]}]",
        needed="[number name / corners / material], or (name / corners / material) for its parts",
    )


_UNCOVERED = 1e-4  # share of a plane that its parts may leave open


def read_catt(path: Path) -> RoomModel:
    """Read a room from a .geo file of CATT-Acoustic and the files that it includes.

    Metres, z up. The name of a surface is its plane's number (OFFSETPL and MIRROR added), its
    group the name of the plane or of its part, its material the one of the plane; where
    ``ABS a = b`` says that a is b, it is b. Upper and lower case are the same; the spelling of the
    ABS statement, or else the first one met, is kept. Absorption and scattering of ABS statements
    are not used: they are what roomfit is to find.

    OFFSETCO, OFFSETPL, MIRROR, OBJECT with TRANSLATE and LOCAL apply to their own file.
    MIRROR adds the image at x = 0 of every corner, and of every plane that names no image itself
    and is not its own image. Two planes on the same corners with opposite reflecting sides and
    one material become one sheet that reflects on both sides.
    """
    files = read_files(path)
    define_names(files)
    materials, findings = _materials(files)
    polygons: list[Polygon] = []
    used: dict[int, str] = {}
    n_pairs = 0
    for file in files:
        for plane in _planes(file, used):
            n_pairs += len(plane.parts) ** 2
            check_limit("part_pairs", n_pairs, plane.where)
            polygons += _polygons(plane, file.shared, materials)
    if not polygons:
        what = "the room file has no planes"
        needed = "PLANES, and below it [number name / corners / material]"
        hint = "the file may be cut short: export it again"
        raise malformed(what, str(path), "no line below PLANES", needed, hint)
    vertices, faces = joined(_sheets(polygons))
    # CATT-Acoustic's normals point into the air, roomfit's out of it
    turned = tuple(Face(face.corners[::-1], face.surface) for face in faces)
    return RoomModel(vertices, turned, findings, "m", "z")


def _planes(file: GeoFile, used: dict[int, str]) -> list[GeoPlane]:
    """Return the planes of one file with final numbers of planes and corners, images included."""
    line = file.directives.get("offsetpl")
    words = line.text.split()[1:] if line else ["0"]
    if line and not (len(words) == 1 and re.fullmatch(r"\d{1,9}", words[0], re.ASCII)):
        raise line.error("OFFSETPL needs a whole number")
    planes = []
    for text in file.planes:
        for plane in parse_planes(text):
            final = _renumbered(
                plane, int(words[0]), lambda corners: (c + file.offset for c in corners)
            )
            planes.append(final)
            check_limit("faces", len(used) + len(planes), plane.where)
            image = _image(final, file)
            if image is not None:
                planes.append(image)
    for plane in planes:
        if plane.number in used:
            what = "a plane number is given twice"
            needed = f"a number of its own: {used[plane.number]} has it"
            hint = "OFFSETPL keeps the planes of included files apart"
            raise malformed(what, plane.where, str(plane.number), needed, hint)
        used[plane.number] = plane.where
    return planes


def _image(plane: GeoPlane, file: GeoFile) -> GeoPlane | None:
    """Return the plane's image at x = 0, or None where it has none of its own."""
    if file.mirror is None:
        return None
    add_corner, add_plane = file.mirror
    known = file.shared.corners
    corners = plane.outline.corners
    if any(c not in known for c in corners):
        return None  # it names images itself
    points = [corner_of(file.shared, c, plane.where) for c in corners]
    rounded = {tuple(round(v, 6) + 0.0 for v in p) for p in points}
    if rounded == {(0.0 - x, y, z) for x, y, z in rounded}:
        return None  # it is its own image
    return _renumbered(plane, add_plane, lambda corners: (c + add_corner for c in corners[::-1]))


def _polygons(plane: GeoPlane, shared: Shared, materials: dict[str, str]) -> list[Polygon]:
    outline = _points(plane.outline, shared, plane.where)
    if not plane.parts:
        return [(outline, _surface(plane, plane.outline, materials))]
    polygons: list[Polygon] = []
    shapes = [_points(part, shared, plane.where) for part in plane.parts]
    left = cut_parts(shapes)
    for part, pieces in zip(plane.parts, left, strict=True):
        if not pieces:
            raise malformed(
                "a part of a plane is hidden by the parts before it",
                plane.where,
                f"{part.name!r} of plane {plane.number}",
                "parts of which each shows",
                "put the smaller part first",
            )
        surface = _surface(plane, part, materials)
        polygons += [(piece, surface) for piece in pieces]
    whole = area_m2([outline])
    covered = area_m2([piece for pieces in left for piece in pieces])
    if not abs(covered - whole) <= _UNCOVERED * whole:
        raise malformed(
            "the parts of a plane do not make up the plane",
            plane.where,
            f"{covered:.4g} m2 of parts in plane {plane.number} of {whole:.4g} m2",
            "parts that cover the plane",
            "give the rest a part of its own, as in (wall / 1 2 3 4 / brick)",
        )
    return polygons


def _points(part: Part, shared: Shared, where: str) -> FloatArray:
    return np.array([corner_of(shared, number, where) for number in part.corners])


def _surface(plane: GeoPlane, part: Part, materials: dict[str, str]) -> Surface:
    key = part.material.lower()
    return Surface(str(plane.number), part.name or None, materials.setdefault(key, part.material))


def _materials(files: list[GeoFile]) -> tuple[dict[str, str], tuple[Finding, ...]]:
    """Return the name to use for each material in lower case, with "a is b" followed to its end."""
    spelling: dict[str, str] = {}
    stands_for: dict[str, str] = {}
    for file in files:
        for line in file.materials:
            name, rest = _absorption(line)
            if name.lower() in spelling:
                raise line.error("a material is given twice", found=name)
            spelling[name.lower()] = name
            if not rest.startswith("<"):
                stands_for[name.lower()] = rest.strip('"').strip()
    followed: dict[str, str] = {}
    for name in stands_for:
        visited, end = {name}, stands_for[name]
        while end.lower() in stands_for:
            if end.lower() in visited:
                raise InputError(
                    "materials that replace each other",
                    found=f"{name}, {end}",
                    needed="each name led to a material of its own",
                    hint=f"give coefficients in a line ABS {name} = <...>",
                )
            visited.add(end.lower())
            end = stands_for[end.lower()]
        followed[name] = spelling.get(end.lower(), end)
    if not followed:
        return spelling, ()
    listed = ", ".join(f"{spelling[name]} is {end}" for name, end in followed.items())
    text = f"The file replaces one material by another: {listed}."
    evidence = {spelling[name]: end for name, end in followed.items()}
    about = About(materials=list(dict.fromkeys(followed.values())))
    return spelling | followed, (Finding(Code.MATERIALS_JOINED, about, text, evidence),)


def _absorption(line: Line) -> tuple[str, str]:
    """Return the name of an ABS statement and what it is: <numbers>, or another name."""
    match = re.fullmatch(r"(?i:abs)\s+([^\s=<]+)\s*(?:=\s*|(?=<))(<[^<>]+>.*|[^<>{}=]+)", line.text)
    if match is None:
        raise line.error(
            "an ABS statement is not understood",
            needed="ABS name = <10 10 10 10 10 10>, or ABS name = other name",
        )
    return match.group(1).strip('"'), match.group(2).strip()


def _sheets(polygons: list[Polygon]) -> list[Polygon]:
    """Join planes on the same points, turned against each other, with one material."""
    first: dict[tuple[object, ...], int] = {}
    kept: list[Polygon] = []
    for points, surface in polygons:
        ring = [tuple(np.round(p, 6) + 0.0) for p in points]
        partner = first.pop((surface.file_material, *_from_smallest(ring[::-1])), None)
        if partner is None:
            first[(surface.file_material, *_from_smallest(ring))] = len(kept)
            kept.append((points, surface))
        else:
            front_m, front = kept[partner]
            kept[partner] = (front_m, replace(front, double_sided=True))
    return kept


def _from_smallest(ring: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
    start = ring.index(min(ring))
    return ring[start:] + ring[:start]
