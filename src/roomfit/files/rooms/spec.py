"""Where a room comes from, as a campaign or a command line says it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from roomfit.errors import InputError


@dataclass(frozen=True, slots=True)
class PolygonSpec:
    """A room as tables of corners and planes.

    Attributes
    ----------
    corners, planes : tuple of Path
        A corner or a plane in a later file replaces the one of the same number in an earlier.
    replace : mapping from plane to Path
        The planes of that table stand in for one plane.
    drop : tuple
        Numbers of planes that are left out.
    sides : mapping from plane to 1 or 2
        2 makes a plane a sheet in the air, 1 a wall, whatever its row says.
    """

    corners: tuple[Path, ...]
    planes: tuple[Path, ...]
    replace: Mapping[str, Path] = field(default_factory=dict)
    drop: tuple[str | int, ...] = ()
    sides: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class RoomSpec:
    """Which room to read, and how to understand it. One of the first three is given.

    Attributes
    ----------
    file : Path or None
        OBJ, AC3D, PLY, STL, GLB, CATT-Acoustic's GEO, or DXF, by the end of its name.
    shoebox : tuple of three floats or None
        Lengths along x, y and z of a box with one corner at the origin.
    polygons : PolygonSpec or None
    unit : str or None
        m, mm, cm, ft or in. None: what the format prescribes (GLB, GEO, shoebox and polygons: m)
        or the file says (DXF's $INSUNITS).
    up : {"z", "y"} or None
        None: what the format prescribes (GLB: y, all others: z).
    materials : mapping from str to str
        From the name of a surface, a group or a file's material (in that precedence) to a
        material. Surfaces that are not named keep the file's material name.
    """

    file: Path | None = None
    shoebox: tuple[float, float, float] | None = None
    polygons: PolygonSpec | None = None
    unit: str | None = None
    up: str | None = None
    materials: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        given = [self.file is not None, self.shoebox is not None, self.polygons is not None]
        if sum(given) != 1:
            raise InputError(
                "a room comes from exactly one place",
                found=f"{sum(given)} of file, shoebox and polygons",
                needed="one of them",
            )
