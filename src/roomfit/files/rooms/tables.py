"""Corner and plane tables as spreadsheets hold them, with headings and notes between the rows."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from roomfit.errors import InputError
from roomfit.files.rooms.text import finite, read_text

_NUMBER_WORDS = ("number", "no", "no.", "nr", "nr.", "plane no.", "plane no", "plane", "corner no.")


@dataclass(frozen=True, slots=True)
class Plane:
    """One polygon of a plane table.

    Attributes
    ----------
    number : str
        As written, without a decimal part.
    corners : tuple of str
        Numbers of its corners, in order.
    material, description : str or None
    double_sided : bool
        The row says "double sided", or has 2 in a column "sides".
    stated_area_m2 : float or None
        Area that the table gives, for a comparison.
    where : str
        File and line.
    """

    number: str
    corners: tuple[str, ...]
    material: str | None
    description: str | None
    double_sided: bool
    stated_area_m2: float | None
    where: str


def read_corners(path: Path) -> dict[str, tuple[float, float, float]]:
    """Return the corners of one table by their number, in the table's unit.

    The columns are found by the heading that holds the words number, x, y and z. Rows without a
    number are headings or notes and are passed over.

    Raises
    ------
    InputError
        No such heading, no corners, a corner twice in one table, or a coordinate that is none.
    """
    corners: dict[str, tuple[float, float, float]] = {}
    for where, row, heading in _rows(path, ("x", "y", "z")):
        number = _as_number(row[_number_column(heading)])
        cells = [row[heading.index(axis)] for axis in "xyz"]
        if number is None:
            if all(_is_finite(cell) for cell in cells):
                raise InputError(
                    "a corner without a number", where=where, found=", ".join(row)[:60]
                )
            continue
        if number in corners:
            raise InputError("a corner is given twice in one table", where=where, found=number)
        x, y, z = (finite(cell, where) for cell in cells)
        corners[number] = (x, y, z)
    if not corners:
        raise InputError("the table holds no corners", where=str(path))
    return corners


def read_planes(path: Path) -> dict[str, Plane]:
    """Return the planes of one table by their number.

    The columns are found by the heading that holds the words number and corner; "material", "area"
    and "name" or "description" are used where they stand. The corners of a plane end at the first
    cell that is no number, so that notes behind them do no harm. Numbers may be written as 616.0.
    A column "sides" may hold 1 or 2.

    Raises
    ------
    InputError
        No such heading, no planes, a plane twice in one table, or with fewer than three corners.
    """
    planes: dict[str, Plane] = {}
    for where, row, heading in _rows(path, ("corner",)):
        number = _as_number(row[_number_column(heading)])
        corners = _corners_of(row, heading)
        if number is None and len(corners) < 3:
            continue
        if number is None:
            raise InputError("a plane without a number", where=where, found=", ".join(row)[:60])
        if number in planes:
            raise InputError("a plane is given twice in one table", where=where, found=number)
        if len(corners) < 3:
            raise InputError(
                "a plane has fewer than three corners",
                where=where,
                found=f"plane {number} with {len(corners)}",
                needed="at least three corner numbers without a gap between them",
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
        raise InputError("the table holds no planes", where=str(path))
    return planes


def _rows(path: Path, needed: tuple[str, ...]) -> Iterator[tuple[str, list[str], list[str]]]:
    """Yield place, cells and heading of each row below a heading; a later heading takes over."""
    heading: list[str] | None = None
    reader = csv.reader(read_text(path).split("\n"))
    try:
        for row in reader:
            cells = [cell.strip() for cell in row]
            words = [" ".join(cell.lower().split()) for cell in cells]
            if any(w in _NUMBER_WORDS for w in words) and all(
                any(w.startswith(n) if len(n) > 1 else w == n for w in words) for n in needed
            ):
                heading = words
            elif heading is not None and any(cells):
                padded = cells + [""] * (len(heading) - len(cells))
                yield f"{path}, line {reader.line_num}", padded, heading
    except csv.Error as error:
        raise InputError("the table cannot be read", where=str(path), found=str(error)) from error
    if heading is None:
        raise InputError(
            "the table has no heading that names its columns",
            where=str(path),
            needed=f"a row with the words number, {', '.join(needed)}",
        )


def _number_column(heading: list[str]) -> int:
    return next(i for i, word in enumerate(heading) if word in _NUMBER_WORDS)


def _corners_of(row: list[str], heading: list[str]) -> tuple[str, ...]:
    """Return the run of numbers from the first corner column up to the next other column."""
    number_column = _number_column(heading)
    first = next(i for i, w in enumerate(heading) if w.startswith("corner") and i != number_column)
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
        raise InputError("a plane has one side or two", where=where, found=sides, needed="1 or 2")
    return _as_number(sides or "") == "2" or any("double" in cell.lower() for cell in row)


def _cell(row: list[str], heading: list[str], starts: tuple[str, ...]) -> str | None:
    column = next((i for i, word in enumerate(heading) if word.startswith(starts)), None)
    return (row[column] or None) if column is not None else None


def _as_number(cell: str) -> str | None:
    """Return a whole number as it is meant, or None.

    Examples
    --------
    >>> _as_number("616.0"), _as_number("007"), _as_number("K26")
    ('616', '7', None)
    """
    match = re.fullmatch(r"0*([0-9]{1,18})(\.0*)?", cell)
    return match.group(1) if match else None


def _is_finite(cell: str) -> bool:
    try:
        return abs(float(cell)) < float("inf")
    except ValueError:
        return False
