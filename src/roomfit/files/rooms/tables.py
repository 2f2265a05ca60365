"""A room from tables of corners and planes, as spreadsheets with headings and notes have them."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from roomfit.base.arguments import check_known
from roomfit.base.findings import About, Code, Finding
from roomfit.base.polygon import Face, Surface, area_vector_m2
from roomfit.files.schema import PolygonSpec
from roomfit.files.tables import lacking, read_sheet
from roomfit.formats.model import METRES_PER_UNIT, RoomModel, finite, malformed

_NUMBER = r"number|n[or]\.?|plane( no\.?)?|corner no\."
_CORNER = r"(?!corner no\.)corner.*|c ?[0-9]+"
_AREA_DISAGREES = 0.02
_SHOWN = 5

Corners = dict[str, tuple[float, float, float]]


class Plane(NamedTuple):
    """One polygon of a plane table."""

    number: str  # as written, without a decimal part
    corners: tuple[str, ...]  # numbers of its corners, in order
    material: str | None
    description: str | None
    stated_area_m2: float | None  # area that the table gives, for a comparison
    where: str  # file and line


class _Line(NamedTuple):
    """One row below a heading."""

    where: str  # file and line
    heading: list[str]  # in small letters
    cells: list[str]  # as many as the heading has, or more

    def cell(self, pattern: str) -> str:
        """Return the cell of the first column whose name has a pattern; "" where there is none."""
        names = zip(self.heading, self.cells, strict=False)
        return next((cell for name, cell in names if re.fullmatch(pattern, name)), "")


def _numbered(path: Path, kind: str, columns: tuple[str, ...]) -> dict[str, _Line]:
    """Return the rows below a heading that have a number of their own, by it; others are notes."""
    found: dict[str, _Line] = {}
    heading: list[str] = []
    names, what = (_NUMBER, *columns), f"table of {kind}s"
    rows = read_sheet(path, what, ",").rows
    for row in rows:
        words = [" ".join(cell.casefold().split()) for cell in row.cells]
        if all(any(re.fullmatch(name, word) for word in words) for name in names):
            heading = words
        if words == heading or not heading or row.is_remark:
            continue
        line = _Line(row.where, heading, row.cells + [""] * (len(heading) - len(row.cells)))
        number = _as_number(line.cell(_NUMBER))
        if kind == "plane":
            is_one = len(_corners_of(line)) >= 3
        else:
            is_one = all(_is_finite(line.cell(axis)) for axis in "xyz")
        if number in found or (number is None and is_one):
            wrong = f"a {kind} without a number of its own"
            hint = f"number the rows, each once; a {kind} is replaced by a later table alone"
            given = ", ".join(line.cells)[:60]
            raise malformed(wrong, line.where, given, "each number once", hint)
        if number is not None:
            found[number] = line
    if not found:
        what = f"a {what} without {'values' if heading else 'a heading'}"
        raise lacking(path, what, rows, names)
    return found


def read_corners(path: Path) -> Corners:
    """Return the corners of one table by their number, in the table's unit.

    The columns are found by the heading with the words number, x, y and z. Rows without a number
    are headings or notes and are ignored. Refused are a table without corners, a corner that
    stands twice, and coordinates that are none.
    """
    corners: Corners = {}
    for number, line in _numbered(path, "corner", ("x", "y", "z")).items():
        x, y, z = (finite(line.cell(axis), line.where) for axis in "xyz")
        corners[number] = (x, y, z)
    return corners


def read_planes(path: Path) -> dict[str, Plane]:
    """Return the planes of one table by their number.

    The columns are found by the heading with the words number and corner (or c1, c2); "material",
    "area" and "name" or "description" are used where they exist. The corners of a plane end at the
    first cell that is no number, so that notes behind them do no harm. Numbers may be written as
    616.0.
    Refused are a table without planes, a plane that stands twice, and one with fewer than three
    corners.
    """
    planes: dict[str, Plane] = {}
    for number, line in _numbered(path, "plane", (_CORNER,)).items():
        corners = _corners_of(line)
        if len(corners) < 3:
            needed = "at least three corner numbers without a gap between them"
            hint = "name its corners in their order, or leave the row out"
            what, found = "a plane has fewer than three corners", f"plane {number}: {len(corners)}"
            raise malformed(what, line.where, found, needed, hint)
        area = line.cell("area.*")
        planes[number] = Plane(
            number,
            corners,
            line.cell("material.*") or None,
            line.cell("(name|description).*") or None,
            float(area) if _is_finite(area) else None,
            line.where,
        )
    return planes


def _corners_of(line: _Line) -> tuple[str, ...]:
    """Return the run of numbers from the first corner column up to the next other column."""
    corners: list[str] = []
    first = next(i for i, word in enumerate(line.heading) if re.fullmatch(_CORNER, word))
    for column in range(first, len(line.cells)):
        word = line.heading[column] if column < len(line.heading) else ""
        number = _as_number(line.cells[column])
        if number is None or word.startswith(("material", "area", "name", "sides")):
            break
        corners.append(number)
    return tuple(corners)


def _as_number(cell: str) -> str | None:
    """Return a whole number without leading zeros or a decimal part, or None."""
    match = re.fullmatch(r"0*([0-9]{1,18})(\.0*)?", cell)
    return match.group(1) if match else None


def _is_finite(cell: str) -> bool:
    return bool(re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", cell, re.IGNORECASE))


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
        surface = Surface(plane.number, plane.description, plane.material)
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
        if twice := [number for number in own if number in planes]:
            text = f"{len(twice)} planes of {path.name} replace earlier ones: {_some(twice)}."
            findings.append(Finding(Code.PLANES_REPLACED, About(), text, {"planes": twice}))
        planes.update(own)
    dropped = [str(number) for number in tables.drop]
    chosen: dict[str, Iterable[str]] = {"drop": dropped, "replace": tables.replace}
    for key, numbers in chosen.items():
        for number in numbers:
            what, where = "no plane has this number", f"polygons, {key}"
            check_known(what, number, planes, where=where, else_try="write it as it is there")
    for number in (*dropped, *tables.replace):
        planes.pop(number, None)
    for path in tables.replace.values():
        for plane in read_planes(path).values():
            if plane.number in planes:
                what, hint = "a plane is there already", "number it differently, or drop the other"
                raise malformed(what, plane.where, plane.number, "each plane once", hint)
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


def plan_model(plan: Sequence[tuple[float, float]], height: float | Sequence[float]) -> RoomModel:
    """Return upright walls over a floor plan at z = 0 and their ceiling, or a gabled roof.

    Surfaces, each its own material: "wall 1", from the first corner to the second, to "wall n", of
    the group "walls"; "floor"; "ceiling", or "ceiling 1" and "ceiling 2" beside a ridge between the
    two highest corners.
    """
    n, heights = len(plan), [height] if isinstance(height, int | float) else list(height)
    if len(heights) not in (1, n) or not all(h > 0.0 for h in heights):
        what, hint = "the heights do not go with the plan", "give one, or one for each corner"
        found, needed = f"{heights[:9]} over {n} corners", "1 or as many, all above 0"
        raise malformed(what, "[room] height", found, needed, hint)
    top = np.array(heights * n)[:n]
    low = np.column_stack([plan, np.zeros(n)])
    level, ring = np.column_stack([plan, np.ones(n)]), tuple(range(n, 2 * n))
    off = np.abs(level @ np.linalg.lstsq(level, top)[0] - top).max()
    a, *others = np.flatnonzero(top == top.max()).tolist()
    roof = [ring]
    if off > 1e-3:
        b = others[0] if len(others) == 1 else a
        roof = [ring[a : b + 1], (*ring[b:], *ring[: a + 1])]
        if min(map(len, roof)) < 3:
            what, where = "the heights carry no roof", "[room] height"
            found = f"{top.max():g} m above {len(others) + 1} of {n} corners, and no plane"
            needed = "a plane, or a ridge between two highest corners that are no neighbours"
            hint = "give a ridge corners of the plan at both its ends, or draw the room"
            raise malformed(what, where, found, needed, hint)
    shapes: dict[str, tuple[int, ...]] = {
        f"wall {i + 1}": (i, (i + 1) % n, n + (i + 1) % n, n + i) for i in range(n)
    }
    shapes["floor"] = tuple(range(n))[::-1]
    names = ["ceiling"] if len(roof) == 1 else ["ceiling 1", "ceiling 2"]
    shapes |= dict(zip(names, roof, strict=True))
    faces = tuple(
        Face(own, Surface(name, {"w": "walls", "f": "floor"}.get(name[0], "ceiling"), name))
        for name, own in shapes.items()
    )
    vertices = np.vstack([low, low + np.outer(top, (0, 0, 1))])
    return RoomModel(vertices, faces, (), "m", "z")
