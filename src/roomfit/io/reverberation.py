"""Decay times without positions: a campaign with ``[reverberation]``, read."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import TypedDict

import numpy as np

from roomfit.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.bands import OCTAVES_HZ, Bands
from roomfit.errors import InputError
from roomfit.geometry.mesh import area_vectors_m2, is_double_sided, triangle_areas_m2, volume_m3
from roomfit.io.campaign import read_campaign, refuse_objects
from roomfit.io.door import csv_rows, read_text
from roomfit.io.inputs import campaign_room, material_priors
from roomfit.materials.priors import MaterialPrior, unknown_material
from roomfit.scene import Room, triangle_material
from roomfit.typing import FloatArray


class DiffuseArguments(TypedDict):
    """What `roomfit.inversion.diffuse.diffuse_absorption` takes."""

    decay_s: FloatArray
    bands: Bands
    priors: tuple[MaterialPrior, ...]
    areas_m2: FloatArray
    volume_m3: float
    speed_of_sound_m_s: float
    attenuation_per_m: FloatArray


def reverberation_arguments(path: Path) -> DiffuseArguments:
    """Return a campaign with decay times as arguments of `diffuse_absorption`.

    Raises
    ------
    InputError
        The campaign or its table cannot be read; or neither a room nor volume and surface are
        given.
    """
    campaign = read_campaign(path, to_fit=False, decay_times=True)
    own = campaign.reverberation
    if own is None:
        raise InputError(
            "a campaign without decay times", where=str(path), needed="a table [reverberation]"
        )
    refuse_objects(campaign, "roomfit reverberation")
    decay_s, bands = read_decay_times(path.parent / own.file)
    volume = own.volume_m3
    if campaign.has_room:
        room = campaign_room(campaign)
        priors = material_priors(replace(campaign, bands=bands), room.materials)
        areas_m2, volume = areas_by_axis_m2(room), volume or volume_m3(room.mesh)
    else:
        if volume is None or own.surface_m2 is None:
            raise InputError(
                "decay times of a room of unknown size",
                where=f"{path}, reverberation",
                needed="volume_m3 and surface_m2, or a table [room]",
            )
        priors = (unknown_material("room", len(bands)),)
        areas_m2 = np.full((3, 1), own.surface_m2 / 3.0)
    return {
        "decay_s": decay_s,
        "bands": bands,
        "priors": priors,
        "areas_m2": areas_m2,
        "volume_m3": volume,
        "speed_of_sound_m_s": speed_of_sound_m_s(campaign.air),
        "attenuation_per_m": attenuation_per_m(campaign.air, bands),
    }


def areas_by_axis_m2(room: Room) -> FloatArray:
    """Return the area of each material across x, y and z, shape (3, n_materials).

    A wall that is oblique counts by the squares of the components of its normal.
    """
    areas = triangle_areas_m2(room.mesh) * np.where(is_double_sided(room.mesh), 2.0, 1.0)
    squares = area_vectors_m2(room.mesh) ** 2
    shares = squares / squares.sum(axis=1, keepdims=True)
    owner, n = triangle_material(room), len(room.materials)
    return np.stack([np.bincount(owner, areas * share, n) for share in shares.T])


def read_decay_times(path: Path) -> tuple[FloatArray, Bands]:
    """Return decay times in s, shape (n_positions, n_bands), and their bands.

    The first line has nominal centres in Hz from the second column on, every further one a name
    and a time for each band; empty cells are unknown. Commas, or semicolons with decimal commas.

    Raises
    ------
    InputError
        The table cannot be read, or a cell is no time of a room.
    """
    text = read_text(path, "table of decay times")
    delimiter = ";" if ";" in text else ","
    rows = [(n, [c.strip() for c in cells]) for n, cells in csv_rows(text, str(path), delimiter)]
    rows = [(n, cells) for n, cells in rows if any(cells) and not cells[0].startswith("#")]
    if len(rows) < 2:
        raise InputError(
            "a table of decay times without values",
            where=str(path),
            needed="a line of centres in Hz, and a line for each position",
        )
    numbers = [[_number(c, f"{path}, line {n}") for c in cells[1:]] for n, cells in rows]
    centres = [c for c in numbers[0] if np.isfinite(c)]
    table = np.full((len(rows) - 1, len(centres)), np.nan)
    for i, values in enumerate(numbers[1:]):
        if len(values) > len(centres) and np.any(np.isfinite(values[len(centres) :])):
            raise InputError("more decay times than bands", where=f"{path}, line {rows[i + 1][0]}")
        kept = values[: len(centres)]
        table[i, : len(kept)] = kept
    known = np.isfinite(table).any(axis=0)
    wrong = table[(table <= 0.0) | (table > 60.0)]
    if wrong.size or not known.any():
        raise InputError(
            "a decay time that no room has",
            where=str(path),
            found=f"{wrong[0]:g} s" if wrong.size else "empty cells alone",
            needed="above 0 and up to 60 s",
        )
    octaves = set(centres) <= set(OCTAVES_HZ)
    bands = Bands("octave" if octaves else "third-octave", np.array(centres)[known])
    return table[:, known], bands


def _number(cell: str, where: str) -> float:
    """Return a time or a frequency, which may be written as 500 Hz or 1 kHz."""
    if not cell:
        return float("nan")
    number = re.sub(r"(hz|s)$", "", cell.lower()).rstrip()
    kilo = number.endswith("k")
    try:
        return float(number.removesuffix("k").replace(",", ".")) * (1000.0 if kilo else 1.0)
    except ValueError:
        raise InputError("not a number", where=where, found=repr(cell[:40])) from None
