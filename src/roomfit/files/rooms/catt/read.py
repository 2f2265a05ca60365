"""The reader of CATT-Acoustic's .geo files."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from roomfit.errors import InputError
from roomfit.files.rooms.catt.corners import names_of
from roomfit.files.rooms.catt.numbers import FileNames, Shared, corner_of
from roomfit.files.rooms.catt.parts import area_m2, cut_parts
from roomfit.files.rooms.catt.planes import GeoPlane, Part, parse_planes
from roomfit.files.rooms.catt.statements import Line, read_files
from roomfit.files.rooms.model import RoomModel
from roomfit.findings import Finding
from roomfit.geometry.build import Face
from roomfit.geometry.mesh import Surface
from roomfit.typing import FloatArray

_UNCOVERED = 1e-4  # share of a plane that its parts may leave open


@dataclass(slots=True)
class _Faces:
    """Corners and faces as they come in."""

    points: list[FloatArray]
    faces: list[Face]
    count: int = 0

    def add(self, points: FloatArray, surface: Surface) -> None:
        """Add one polygon; CATT-Acoustic's normals point into the air, roomfit's out of it."""
        corners = tuple(reversed(range(self.count, self.count + len(points))))
        self.points.append(points)
        self.faces.append(Face(corners, surface))
        self.count += len(points)


def read_catt(path: Path) -> RoomModel:
    """Read a room from a .geo file of CATT-Acoustic and the files that it includes.

    Metres, z up. The name of a surface is its plane's number (OFFSETPL and MIRROR added), its
    group the name of the plane or of its part, its material the one of the plane; where
    ``ABS a = b`` says that a is b, it is b. Upper and lower case are the same; the spelling of the
    ABS statement, or else the first one met, is kept. Absorption and scattering of ABS statements
    are not used: they are what roomfit is to find.

    OFFSETCO, OFFSETPL, MIRROR, OBJECT with TRANSLATE and LOCAL hold for the file they stand in.
    MIRROR adds the image at x = 0 of every corner, and of every plane that names no image itself
    and is not its own image. Two planes on the same corners with opposite reflecting sides and
    one material become one sheet that reflects on both sides.

    Raises
    ------
    InputError
        A file cannot be read, or holds a statement that is not supported (IF, ROTATE, COPY, cut()
        and others): it is told with its line. Nothing that may shape the room is passed over.
    """
    files = read_files(path)
    shared, owners = names_of(files)
    materials, findings = _materials(owners)
    faces = _Faces([], [])
    used: dict[int, str] = {}
    for owner in owners:
        for plane in _planes(owner, used):
            _add_plane(plane, shared, materials, faces)
    if not faces.faces:
        raise InputError(
            "the room file has no planes",
            where=str(path),
            needed="PLANES, and below it [number name / corners / material]",
            hint="the file may be cut short: export it again",
        )
    return RoomModel(np.concatenate(faces.points), _sheets(faces), findings, "m", "z")


def _planes(owner: FileNames, used: dict[int, str]) -> list[GeoPlane]:
    """Return the planes of one file with final numbers of planes and corners, images included."""
    line = owner.file.directives.get("offsetpl")
    words = line.text.split()[1:] if line else ["0"]
    if line and not (len(words) == 1 and re.fullmatch(r"\d{1,9}", words[0], re.ASCII)):
        raise InputError("OFFSETPL needs a whole number", where=line.where, found=line.text[:80])
    planes = []
    for text in owner.file.planes:
        for plane in parse_planes(text):
            final = _renumbered(plane, int(words[0]), owner.offset)
            planes.append(final)
            image = _image(final, owner)
            if image is not None:
                planes.append(image)
    for plane in planes:
        if plane.number in used:
            raise InputError(
                "a plane number is given twice",
                where=plane.where,
                found=str(plane.number),
                hint=f"the first one: {used[plane.number]}; OFFSETPL keeps included files apart",
            )
        used[plane.number] = plane.where
    return planes


def _renumbered(plane: GeoPlane, add_plane: int, add_corner: int) -> GeoPlane:
    def moved(part: Part) -> Part:
        return replace(part, corners=tuple(c + add_corner for c in part.corners))

    parts = tuple(moved(part) for part in plane.parts)
    return replace(
        plane, number=plane.number + add_plane, outline=moved(plane.outline), parts=parts
    )


def _image(plane: GeoPlane, owner: FileNames) -> GeoPlane | None:
    """Return the plane's image at x = 0, or None where it has none of its own."""
    if owner.mirror is None:
        return None
    add_corner, add_plane = owner.mirror
    known = owner.shared.corners
    corners = plane.outline.corners
    if any(c not in known for c in corners):
        return None  # it names images itself
    points = [corner_of(owner.shared, c, plane.where) for c in corners]
    rounded = {tuple(round(v, 6) + 0.0 for v in p) for p in points}
    if rounded == {(0.0 - x, y, z) for x, y, z in rounded}:
        return None  # it is its own image

    def mirrored(part: Part) -> Part:
        return replace(part, corners=tuple(c + add_corner for c in part.corners[::-1]))

    parts = tuple(mirrored(part) for part in plane.parts)
    return replace(
        plane, number=plane.number + add_plane, outline=mirrored(plane.outline), parts=parts
    )


def _add_plane(plane: GeoPlane, shared: Shared, materials: dict[str, str], faces: _Faces) -> None:
    outline = _points(plane.outline, shared, plane.where)
    if not plane.parts:
        faces.add(outline, _surface(plane, plane.outline, materials))
        return
    shapes = [_points(part, shared, plane.where) for part in plane.parts]
    left = cut_parts(shapes)
    for part, pieces in zip(plane.parts, left, strict=True):
        if not pieces:
            raise InputError(
                "a part of a plane is hidden by the parts before it",
                where=plane.where,
                found=f"{part.name!r} of plane {plane.number}",
                hint="put the smaller part first",
            )
        for piece in pieces:
            faces.add(piece, _surface(plane, part, materials))
    whole = area_m2([outline])
    covered = area_m2([piece for pieces in left for piece in pieces])
    if not abs(covered - whole) <= _UNCOVERED * whole:
        raise InputError(
            "the parts of a plane do not make up the plane",
            where=plane.where,
            found=f"{covered:.4g} m2 of parts in plane {plane.number} of {whole:.4g} m2",
            hint="give the rest a part of its own, as in (wall / 1 2 3 4 / brick)",
        )


def _points(part: Part, shared: Shared, where: str) -> FloatArray:
    return np.array([corner_of(shared, number, where) for number in part.corners])


def _surface(plane: GeoPlane, part: Part, materials: dict[str, str]) -> Surface:
    key = part.material.lower()
    return Surface(str(plane.number), part.name or None, materials.setdefault(key, part.material))


def _materials(owners: list[FileNames]) -> tuple[dict[str, str], tuple[Finding, ...]]:
    """Return the name to use for each material in lower case, with "a is b" followed to its end."""
    spelling: dict[str, str] = {}
    stands_for: dict[str, str] = {}
    for owner in owners:
        for line in owner.file.materials:
            name, rest = _absorption(line)
            if name.lower() in spelling:
                raise InputError("a material is given twice", where=line.where, found=name)
            spelling[name.lower()] = name
            if not rest.startswith("<"):
                stands_for[name.lower()] = rest.strip('"').strip()
    followed: dict[str, str] = {}
    for name in stands_for:
        seen, end = {name}, stands_for[name]
        while end.lower() in stands_for:
            if end.lower() in seen:
                raise InputError("materials that stand for each other", found=f"{name}, {end}")
            seen.add(end.lower())
            end = stands_for[end.lower()]
        followed[name] = spelling.get(end.lower(), end)
    if not followed:
        return spelling, ()
    told = ", ".join(f"{spelling[name]} is {end}" for name, end in followed.items())
    text = f"The file says that one material stands for another: {told}."
    evidence = {spelling[name]: end for name, end in followed.items()}
    return spelling | followed, (Finding("materials-joined", "info", text, evidence),)


def _absorption(line: Line) -> tuple[str, str]:
    """Return the name of an ABS statement and what stands behind it: <numbers>, or a name."""
    match = re.fullmatch(r"(?i:abs)\s+([^\s=<]+)\s*(?:=\s*|(?=<))(<[^<>]+>.*|[^<>{}=]+)", line.text)
    if match is None:
        raise InputError(
            "an ABS statement is not understood",
            where=line.where,
            found=line.text[:80],
            needed="ABS name = <10 10 10 10 10 10>, or ABS name = other name",
        )
    return match.group(1).strip('"'), match.group(2).strip()


def _sheets(faces: _Faces) -> tuple[Face, ...]:
    """Join planes on the same points, turned against each other, with one material."""
    first: dict[tuple[object, ...], int] = {}
    kept: list[Face | None] = []
    for face, points in zip(faces.faces, faces.points, strict=True):
        ring = [tuple(np.round(p, 6) + 0.0) for p in points]
        back = (face.surface.file_material, *_from_smallest(ring[::-1]))
        partner = first.pop(back, None)
        if partner is None:
            first[(face.surface.file_material, *_from_smallest(ring))] = len(kept)
            kept.append(face)
            continue
        front = kept[partner]
        if front is not None:
            kept[partner] = Face(front.corners, replace(front.surface, double_sided=True))
    return tuple(face for face in kept if face is not None)


def _from_smallest(ring: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
    start = ring.index(min(ring))
    return ring[start:] + ring[:start]
