"""A room from tables of corners and planes, as spreadsheets with headings and notes have them."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from roomfit.base.arguments import did_you_mean
from roomfit.base.door import csv_rows, read_text
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.polygon import Face, Surface, area_vector_m2
from roomfit.files.rooms.model import PolygonSpec
from roomfit.formats.model import METRES_PER_UNIT, RoomModel, finite, malformed

_NUMBER_WORDS = ("number", "no", "no.", "nr", "nr.", "plane no.", "plane no", "plane", "corner no.")
_AREA_DISAGREES = 0.02
_SHOWN = 5

Corners = dict[str, tuple[float, float, float]]


class Plane(NamedTuple):
    """One polygon of a plane table."""

    number: str  # as written, without a decimal part
    corners: tuple[str, ...]  # numbers of its corners, in order
    material: str | None
    description: str | None
    double_sided: bool  # the row says "double sided", or has 2 in a column "sides"
    stated_area_m2: float | None  # area that the table gives, for a comparison
    where: str  # file and line


def read_corners(path: Path) -> Corners:
    """Return the corners of one table by their number, in the table's unit.

    The columns are found by the heading with the words number, x, y and z. Rows without a number
    are headings or notes and are ignored. Refused are a table without corners, a corner that
    stands twice, and coordinates that are none.
    """
    corners: Corners = {}
    for where, row, heading in _rows(path, ("x", "y", "z")):
        cells = [row[heading.index(axis)] for axis in "xyz"]
        number = _numbered(row, heading, where, corners, "corner", all(map(_is_finite, cells)))
        if number is not None:
            x, y, z = (finite(cell, where) for cell in cells)
            corners[number] = (x, y, z)
    if not corners:
        raise _without("corners", path, "rows of number, x, y, z")
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
        corners = _corners_of(row, heading)
        number = _numbered(row, heading, where, planes, "plane", len(corners) >= 3)
        if number is None:
            continue
        if len(corners) < 3:
            needed = "at least three corner numbers without a gap between them"
            hint = "name its corners in their order, or leave the row out"
            what, found = "a plane has fewer than three corners", f"plane {number}: {len(corners)}"
            raise malformed(what, where, found, needed, hint)
        sides = _cell(row, heading, ("sides",))
        if sides is not None and _as_number(sides) not in ("1", "2"):
            hint = "2 where sound strikes both, as of a screen"
            raise malformed("a plane has one side or two", where, sides, "1 or 2", hint)
        is_sheet = _as_number(sides or "") == "2" or any("double" in cell.lower() for cell in row)
        area = _cell(row, heading, ("area",))
        material, name = (_cell(row, heading, w) for w in (("material",), ("name", "description")))
        stated = float(area) if area and _is_finite(area) else None
        planes[number] = Plane(number, corners, material, name, is_sheet, stated, where)
    if not planes:
        raise _without("planes", path, "rows of a number and three corners or more")
    return planes


def _without(kind: str, path: Path, needed: str) -> InputError:
    hint = f"export the sheet of {kind}, with its rows"
    return malformed(f"the table holds no {kind}", str(path), "a heading alone", needed, hint)


def _numbered(
    row: list[str], heading: list[str], where: str, known: Collection[str], kind: str, is_one: bool
) -> str | None:
    """Return the number of a row; None where it has none and is no corner or plane either."""
    number = _as_number(row[_number_column(heading)])
    if number is None and is_one:
        what, needed = f"a {kind} without a number", "a number of its own in the column of numbers"
        hint = "number the rows, each once"
        raise malformed(what, where, ", ".join(row)[:60], needed, hint)
    if number in known:
        hint = f"number one of the two anew; a {kind} is replaced by a later table alone"
        raise malformed(
            f"a {kind} is given twice in one table", where, str(number), "each number once", hint
        )
    return number


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
        what, hint = "the table has no heading that names its columns", "write them above"
        wanted = f"a row with the words number, {', '.join(needed)}"
        raise malformed(what, str(path), "no such row", wanted, hint)


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


def read_polygons(
    tables: PolygonSpec, unit: str | None = None, renamed: Collection[str] = ()
) -> RoomModel:
    """Read a room from tables; areas that they state are compared with those of the corners.

    The name of a surface is its plane's number, its group the plane's description. No finding says
    of materials that are `renamed` that they are spelt alike.
    """
    corners, findings = _merged_corners(tables.corners)
    planes = _chosen_planes(tables, findings)
    index = {number: i for i, number in enumerate(corners)}
    vertices = np.array(list(corners.values()))
    scale = METRES_PER_UNIT.get(unit or "m", 1.0)
    faces: list[Face] = []
    wrong: dict[str, tuple[float, float]] = {}
    for plane in planes.values():
        if missing := [c for c in plane.corners if c not in index]:
            what, needed = "a plane names a corner that does not exist", "one of the corner tables"
            found = f"corner {missing[0]} in plane {plane.number}"
            raise malformed(what, plane.where, found, needed, "add the corner table that holds it")
        sides = tables.sides.get(plane.number, 2 if plane.double_sided else 1)
        surface = Surface(plane.number, plane.description, plane.material, sides == 2)
        faces.append(Face(tuple(index[c] for c in plane.corners), surface))
        stated = plane.stated_area_m2
        own_m = (vertices * scale)[list(faces[-1].corners)]
        area = float(np.linalg.norm(area_vector_m2(own_m)))
        # stated with two decimals
        if stated is not None and abs(stated - area) > max(_AREA_DISAGREES * area, 0.02):
            wrong[plane.number] = stated, area
    if wrong:
        each = [f"plane {n}: {said:g} m2 stated, {own:.2f} m2" for n, (said, own) in wrong.items()]
        text = (
            f"{len(wrong)} stated areas disagree with the corners, which are used: {_some(each)}."
        )
        findings.append(Finding(Code.STATED_AREA_MISMATCH, About(), text, {"planes": wrong}))
    findings += _alike(planes, renamed)
    return RoomModel(vertices, tuple(faces), tuple(findings), "m", "z")


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


def _chosen_planes(tables: PolygonSpec, findings: list[Finding]) -> dict[str, Plane]:
    """Return the planes of all tables, some dropped or replaced; what replaces which is found."""
    planes: dict[str, Plane] = {}
    for path in tables.planes:
        own = read_planes(path)
        twice = [number for number in own if number in planes]
        if twice:
            text = f"{len(twice)} planes of {path.name} replace earlier ones: {_some(twice)}."
            findings.append(Finding(Code.PLANES_REPLACED, About(), text, {"planes": twice}))
        planes.update(own)
    chosen: dict[str, Iterable[str]] = {"drop": [str(number) for number in tables.drop]}
    for key, numbers in {**chosen, "replace": tables.replace, "sides": tables.sides}.items():
        for number in numbers:
            if number not in planes:
                needed = "a number from the first column of the plane tables"
                hint = did_you_mean(number, planes) or "write it as it is there"
                where = f"polygons, {key}"
                raise malformed("no plane has this number", where, number, needed, hint)
    for number in (*chosen["drop"], *tables.replace):
        planes.pop(number, None)
    for path in tables.replace.values():
        for plane in read_planes(path).values():
            if plane.number in planes:
                hint, found = (
                    "number it differently, or drop the other one",
                    f"plane {plane.number}",
                )
                what = "a plane is there already"
                raise malformed(what, plane.where, found, "each plane once", hint)
            planes[plane.number] = plane
    return planes


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
