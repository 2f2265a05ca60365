"""What every reader of a room hands back, before units and axes are settled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.errors import InputError
from roomfit.findings import Finding
from roomfit.geometry.build import Face
from roomfit.typing import FloatArray

METRES_PER_UNIT = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "ft": 0.3048, "in": 0.0254}


@dataclass(frozen=True, slots=True, eq=False)
class RoomModel:
    """The polygons of a file.

    Attributes
    ----------
    vertices : float array, shape (n_vertices, 3)
        In the file's own unit and axes.
    faces : tuple of Face
    findings : tuple of Finding
        What the reader doubts.
    unit : str or None
        Unit that the format prescribes, None where it prescribes none.
    up : {"y", "z"}
        Axis that points up by the format's standard or habit, where the caller says nothing.
    """

    vertices: FloatArray
    faces: tuple[Face, ...]
    findings: tuple[Finding, ...] = ()
    unit: str | None = None
    up: str = "z"


def in_metres(model: RoomModel, unit: str | None, up: str | None, where: str) -> FloatArray:
    """Return the vertices in metres with z up, shape (n_vertices, 3).

    ``up = "y"`` maps (x, y, z) to (x, -z, y), which is a rotation: nothing is mirrored.

    Raises
    ------
    InputError
        The unit is unknown, or neither the caller nor the format gives one.
    """
    chosen = unit or model.unit
    known = ", ".join(METRES_PER_UNIT)
    if chosen is None:
        raise InputError(
            "the unit of the room file is not known",
            where=where,
            needed=f"one of {known}: this format carries none",
            hint='add unit = "m" (or --unit m) and compare the volume that is shown',
        )
    if chosen not in METRES_PER_UNIT:
        raise InputError("unknown unit", where=where, found=repr(chosen), needed=f"one of {known}")
    axis = up or model.up
    if axis not in ("y", "z"):
        raise InputError("unknown up axis", where=where, found=repr(axis), needed='"y" or "z"')
    x, y, z = (model.vertices * METRES_PER_UNIT[chosen]).reshape(-1, 3).T
    return np.stack([x, -z, y] if axis == "y" else [x, y, z], axis=1)
