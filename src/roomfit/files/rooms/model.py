"""Which room to read, and how to understand it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from roomfit.base.arguments import check_known
from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray
from roomfit.formats.model import METRES_PER_UNIT, RoomModel

OF_SEVERAL = (".ifc", ".json")  # files that may have several rooms


@dataclass(frozen=True, slots=True)
class PolygonSpec:
    """A room as tables of corners and planes."""

    # A corner or a plane in a later file replaces the one of the same number in an earlier
    corners: tuple[Path, ...]
    planes: tuple[Path, ...]
    # the planes of that table replace one plane
    replace: Mapping[str, Path] = field(default_factory=dict)
    drop: tuple[str | int, ...] = ()  # numbers of planes that are left out
    # 2 makes a plane a sheet in the air, 1 a wall, whatever its row says
    sides: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class RoomSpec:
    """Which room to read, and how to understand it. One of the first three is given."""

    # OBJ, PLY, STL, GLB, CATT-Acoustic's GEO, DXF, COLLADA, IFC, SketchUp's SKP, RoomPlan's JSON or
    # USDZ
    file: Path | None = None
    # Lengths along x, y and z of a box with one corner at the origin
    shoebox: tuple[float, float, float] | None = None
    polygons: PolygonSpec | None = None
    # m, mm, cm, ft or in. None: what the format prescribes (GLB, GEO, shoebox and polygons:
    # m) or the file says (DXF's $INSUNITS, COLLADA, IFC, USDZ, SketchUp).
    unit: str | None = None
    up: str | None = None  # None: what the format prescribes (GLB: y) or COLLADA says; others: z
    # From the name of a surface, a group or a file's material (in that precedence) to a
    # material. Surfaces that are not named keep the file's material name.
    materials: Mapping[str, str] = field(default_factory=dict)
    # Standard deviations of a box's lengths in m, which then are fitted
    lengths_sd: tuple[float, float, float] | None = None
    space: str | None = None  # of a building model (IFC) or a scan (JSON) that has several

    def __post_init__(self) -> None:
        given = [self.file is not None, self.shoebox is not None, self.polygons is not None]
        if sum(given) != 1:
            raise InputError(
                "a room has exactly one source",
                found=f"{sum(given)} of file, shoebox and polygons",
                needed="one of them",
                hint="leave the others out",
            )
        if self.space is not None and Path(self.file or "").suffix.lower() not in OF_SEVERAL:
            what = "only a building model and a scan have spaces"
            needed = f"a file of {' or '.join(OF_SEVERAL)}"
            raise InputError(what, found=self.space, needed=needed, hint="leave space out")


def in_metres(model: RoomModel, unit: str | None, up: str | None, where: str) -> FloatArray:
    """Return the vertices in metres with z up, shape (n_vertices, 3).

    ``up = "y"`` maps (x, y, z) to (x, -z, y), which is a rotation: nothing is mirrored. Refused
    is an unknown unit, or none where the format gives none either.
    """
    chosen = unit or model.unit
    known = ", ".join(METRES_PER_UNIT)
    if chosen is None:
        raise InputError(
            "the unit of the room file is not known",
            where=where,
            needed=f"one of {known}: this format carries none",
            hint='add unit = "m" (or --unit m) and compare the volume that is shown',
            found="no unit",
        )
    compare = "compare the volume that roomfit check shows"
    check_known("unknown unit", chosen, METRES_PER_UNIT, where=where, else_try=compare)
    axis = up or model.up
    if axis not in ("y", "z"):
        needed, hint = '"y" or "z"', "y where the height of the room stands second"
        raise InputError("unknown up axis", where=where, found=repr(axis), needed=needed, hint=hint)
    x, y, z = (model.vertices * METRES_PER_UNIT[chosen]).reshape(-1, 3).T
    return np.stack([x, -z, y] if axis == "y" else [x, y, z], axis=1)
