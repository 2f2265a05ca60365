"""A room from tables of corners and planes, as spreadsheets with headings and notes have them."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roomfit.base.arguments import nearest
from roomfit.base.door import csv_rows, read_text
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.polygon import Face, Surface, area_vector_m2
from roomfit.files.rooms.model import PolygonSpec
from roomfit.formats.model import METRES_PER_UNIT, RoomModel, finite

_NUMBER_WORDS = ("number", "no", "no.", "nr", "nr.", "plane no.", "plane no", "plane", "corner no.")


@dataclass(frozen=True, slots=True)
class Plane:
    """One polygon of a plane table."""

    number: str  # as written, without a decimal part
    corners: tuple[str, ...]  # numbers of its corners, in order
    material: str | None
    description: str | None
    double_sided: bool  # the row says "double sided", or has 2 in a column "sides"
    stated_area_m2: float | None  # area that the table gives, for a comparison
    where: str  # file and line


def read_corners(path: Path) -> dict[str, tuple[float, float, float]]:
    """Return the corners of one table by their number, in the table's unit.

    The columns are found by the heading with the words number, x, y and z. Rows without a number
    are headings or notes and are ignored. Refused are a table without corners, a corner that
    stands twice, and coordinates that are none.
    """
    corners: dict[str, tuple[float, float, float]] = {}
    for where, row, heading in _rows(path, ("x", "y", "z")):
        number = _as_number(row[_number_column(heading)])
        cells = [row[heading.index(axis)] for axis in "xyz"]
        if number is None:
            if all(_is_finite(cell) for cell in cells):
                raise InputError(
                    "a corner without a number",
                    where=where,
                    found=", ".join(row)[:60],
                    needed="a number of its own in the column of numbers",
                    hint="number the rows, each once",
                )
            continue
        if number in corners:
            raise InputError(
                "a corner is given twice in one table",
                where=where,
                found=number,
                needed="each number once",
                hint="number one of the two anew; a corner is replaced by a later table alone",
            )
        x, y, z = (finite(cell, where) for cell in cells)
        corners[number] = (x, y, z)
    if not corners:
        raise InputError(
            "the table holds no corners",
            where=str(path),
            found="a heading alone",
            needed="rows of number, x, y, z",
            hint="export the sheet of corners, with its rows",
        )
    return corners


def read_planes(path: Path) -> dict[str, Plane]:
    """Return the planes of one table by their number.

    The columns are found by the heading with the words number and corner (or c1, c2); "material",
    "area" and "name" or "description" are used where they exist. The corners of a plane end at the
    first cell that is no number, so that notes behind them do no harm. Numbers may be written as
    616.0.
    A column "sides" may have 1 or 2. Refused are a table without planes, a plane that stands
    twice, and one with fewer than three corners.
    """
    planes: dict[str, Plane] = {}
    for where, row, heading in _rows(path, ("corner",)):
        number = _as_number(row[_number_column(heading)])
        corners = _corners_of(row, heading)
        if number is None and len(corners) < 3:
            continue
        if number is None:
            raise InputError(
                "a plane without a number",
                where=where,
                found=", ".join(row)[:60],
                needed="a number of its own in the column of numbers",
                hint="number the rows, each once",
            )
        if number in planes:
            raise InputError(
                "a plane is given twice in one table",
                where=where,
                found=number,
                needed="each number once",
                hint="number one of the two anew; a plane is replaced by a later table alone",
            )
        if len(corners) < 3:
            raise InputError(
                "a plane has fewer than three corners",
                where=where,
                found=f"plane {number} with {len(corners)}",
                needed="at least three corner numbers without a gap between them",
                hint="name its corners in their order, or leave the row out",
            )
        area = _cell(row, heading, ("area",))
        planes[number] = Plane(
            number,
            corners,
            _cell(row, heading, ("material",)),
            _cell(row, heading, ("name", "description")),
            _is_double_sided(row, heading, where),
            float(area) if area and _is_finite(area) else None,
            where,
        )
    if not planes:
        raise InputError(
            "the table holds no planes",
            where=str(path),
            found="a heading alone",
            needed="rows of a number and three corners or more",
            hint="export the sheet of planes, with its rows",
        )
    return planes


def _rows(path: Path, needed: tuple[str, ...]) -> Iterator[tuple[str, list[str], list[str]]]:
    """Yield place, cells and heading of each row below a heading; a later heading replaces it."""
    heading: list[str] | None = None
    for number, row in csv_rows(read_text(path, "room file"), str(path)):
        cells = [cell.strip() for cell in row]
        words = [" ".join(cell.lower().split()) for cell in cells]
        if any(w in _NUMBER_WORDS for w in words) and all(
            any(_is_corner(w) if n == "corner" else w == n for w in words) for n in needed
        ):
            heading = words
        elif heading is not None and any(cells):
            padded = cells + [""] * (len(heading) - len(cells))
            yield f"{path}, line {number}", padded, heading
    if heading is None:
        raise InputError(
            "the table has no heading that names its columns",
            where=str(path),
            found="no such row",
            needed=f"a row with the words number, {', '.join(needed)}",
            hint="write these words above the columns",
        )


def _is_corner(word: str) -> bool:
    """Whether a heading is that of corners: corner 1, corners, c1."""
    return word.startswith("corner") or re.fullmatch(r"c ?[0-9]+", word) is not None


def _number_column(heading: list[str]) -> int:
    return next(i for i, word in enumerate(heading) if word in _NUMBER_WORDS)


def _corners_of(row: list[str], heading: list[str]) -> tuple[str, ...]:
    """Return the run of numbers from the first corner column up to the next other column."""
    number_column = _number_column(heading)
    first = next(i for i, w in enumerate(heading) if _is_corner(w) and i != number_column)
    corners: list[str] = []
    for column in range(first, len(row)):
        word = heading[column] if column < len(heading) else ""
        number = _as_number(row[column])
        if number is None or word.startswith(("material", "area", "name", "sides")):
            break
        corners.append(number)
    return tuple(corners)


def _is_double_sided(row: list[str], heading: list[str], where: str) -> bool:
    sides = _cell(row, heading, ("sides",))
    if sides is not None and _as_number(sides) not in ("1", "2"):
        raise InputError(
            "a plane has one side or two",
            where=where,
            found=sides,
            needed="1 or 2",
            hint="2 where sound strikes both, as of a screen",
        )
    return _as_number(sides or "") == "2" or any("double" in cell.lower() for cell in row)


def _cell(row: list[str], heading: list[str], starts: tuple[str, ...]) -> str | None:
    column = next((i for i, word in enumerate(heading) if word.startswith(starts)), None)
    return (row[column] or None) if column is not None else None


def _as_number(cell: str) -> str | None:
    """Return a whole number without leading zeros or a decimal part, or None."""
    match = re.fullmatch(r"0*([0-9]{1,18})(\.0*)?", cell)
    return match.group(1) if match else None


def _is_finite(cell: str) -> bool:
    try:
        return abs(float(cell)) < float("inf")
    except ValueError:
        return False


_AREA_DISAGREES = 0.02
_SHOWN = 5

Corners = dict[str, tuple[float, float, float]]


def read_polygons(
    tables: PolygonSpec, unit: str | None = None, renamed: Collection[str] = ()
) -> RoomModel:
    """Read a room from tables; areas that they state are compared with those of the corners.

    The name of a surface is its plane's number, its group the plane's description. No finding says
    of materials that are `renamed` that they are spelt alike.
    """
    corners, moved = _merged_corners(tables.corners)
    planes, replaced = _chosen_planes(tables)
    index = {number: i for i, number in enumerate(corners)}
    vertices = np.array(list(corners.values()))
    faces = []
    for plane in planes.values():
        sides = tables.sides.get(plane.number, 2 if plane.double_sided else 1)
        surface = Surface(plane.number, plane.description, plane.material, sides == 2)
        faces.append(Face(_indices(plane, index), surface))
    scale = METRES_PER_UNIT.get(unit or "m", 1.0)
    areas = [
        float(np.linalg.norm(area_vector_m2((vertices * scale)[list(face.corners)])))
        for face in faces
    ]
    findings = (*moved, *replaced, *_area_findings(planes, areas), *_alike(planes, renamed))
    return RoomModel(vertices, tuple(faces), findings, "m", "z")


def _merged_corners(paths: tuple[Path, ...]) -> tuple[Corners, list[Finding]]:
    corners: Corners = {}
    moved: dict[str, float] = {}
    for path in paths:
        for number, point in read_corners(path).items():
            if point != corners.get(number, point):
                moved[number] = float(np.linalg.norm(np.subtract(point, corners[number])))
            corners[number] = point
    if not moved:
        return corners, []
    text = (
        f"{len(moved)} corners differ between the tables, by up to {max(moved.values()):.3g}; the "
        f"last table applies: {_some(list(moved))}."
    )
    return corners, [Finding(Code.CORNERS_DIFFER, About(), text, {"moved": moved})]


def _chosen_planes(tables: PolygonSpec) -> tuple[dict[str, Plane], list[Finding]]:
    planes: dict[str, Plane] = {}
    findings: list[Finding] = []
    for path in tables.planes:
        found = read_planes(path)
        twice = [number for number in found if number in planes]
        if twice:
            text = f"{len(twice)} planes of {path.name} replace earlier ones: {_some(twice)}."
            findings.append(Finding(Code.PLANES_REPLACED, About(), text, {"planes": twice}))
        planes.update(found)
    drop = [str(number) for number in tables.drop]
    _check_known("drop", drop, planes)
    _check_known("replace", tables.replace, planes)
    _check_known("sides", tables.sides, planes)
    for number in drop:
        planes.pop(number, None)
    for number, path in tables.replace.items():
        planes.pop(number, None)
        for plane in read_planes(path).values():
            if plane.number in planes:
                raise InputError(
                    "a plane is there already",
                    where=plane.where,
                    found=f"plane {plane.number}",
                    hint="number it differently, or drop the other one",
                    needed="each plane once",
                )
            planes[plane.number] = plane
    return planes, findings


def _check_known(key: str, numbers: Iterable[str], planes: Mapping[str, Plane]) -> None:
    for number in numbers:
        if number not in planes:
            like = nearest(number, planes)
            raise InputError(
                "no plane has this number",
                where=f"polygons, {key}",
                found=number,
                needed="a number from the first column of the plane tables",
                hint=f"did you mean {like}?" if like else None,
            )


def _indices(plane: Plane, index: Mapping[str, int]) -> tuple[int, ...]:
    for corner in plane.corners:
        if corner not in index:
            raise InputError(
                "a plane names a corner that does not exist",
                where=plane.where,
                found=f"corner {corner} in plane {plane.number}",
                needed="a corner of the corner tables",
                hint="add the corner table that holds it",
            )
    return tuple(index[corner] for corner in plane.corners)


def _area_findings(planes: Mapping[str, Plane], areas: list[float]) -> list[Finding]:
    """Compare with the stated areas, allowing for their two decimals."""
    wrong = {
        plane.number: (plane.stated_area_m2, area)
        for plane, area in zip(planes.values(), areas, strict=True)
        if plane.stated_area_m2 is not None
        and abs(plane.stated_area_m2 - area) > max(_AREA_DISAGREES * area, 0.02)
    }
    if not wrong:
        return []
    listed = [
        f"plane {n}: {stated:g} m2 stated, {area:.2f} m2" for n, (stated, area) in wrong.items()
    ]
    text = f"{len(wrong)} stated areas disagree with the corners, which are used: {_some(listed)}."
    return [Finding(Code.STATED_AREA_MISMATCH, About(), text, {"planes": wrong})]


def _alike(planes: Mapping[str, Plane], renamed: Collection[str]) -> list[Finding]:
    """Return findings of names of materials that differ in blanks, _, case or a plural s only."""
    families: dict[str, set[str]] = {}
    for plane in planes.values():
        if plane.material and plane.material not in renamed:
            plain = "".join(c for c in plane.material.lower() if c not in " _-").rstrip("s")
            families.setdefault(plain, set()).add(plane.material)
    alike = [sorted(names) for names in families.values() if len(names) > 1]
    return [
        Finding(
            Code.MATERIAL_NAMES_SIMILAR,
            About(materials=names),
            f"The materials {' and '.join(map(repr, names))} differ in spelling only and are kept "
            "apart; give them one name in [room.materials] if they are one.",
            {"materials": names},
        )
        for names in alike
    ]


def _some(items: list[str]) -> str:
    more = f" and {len(items) - _SHOWN} more" if len(items) > _SHOWN else ""
    return ", ".join(items[:_SHOWN]) + more
