"""What is exported: the absorption of every material in every band, read from a result."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.bands import OCTAVES_HZ, Bands
from roomfit.checks import bool_array, float_array, unique_names
from roomfit.errors import InputError, located
from roomfit.typing import BoolArray, FloatArray

_COLUMNS = ("material", "band_hz", "absorption", "lower95", "upper95", "identifiable")


@dataclass(frozen=True, slots=True, eq=False)
class MaterialTable:
    """Materials of a result.

    Attributes
    ----------
    names : tuple of str
    bands : Bands
    absorption, lower95, upper95 : float arrays, shape (n_materials, n_bands)
        0 to 1.
    identifiable : bool array, shape (n_materials, n_bands)
    scattering : float array, shape (n_materials, n_bands), or None
        None where the result tells none.
    """

    names: tuple[str, ...]
    bands: Bands
    absorption: FloatArray
    lower95: FloatArray
    upper95: FloatArray
    identifiable: BoolArray
    scattering: FloatArray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", unique_names("material", self.names))
        shape = (len(self.names), len(self.bands))
        for name in ("absorption", "lower95", "upper95", "scattering"):
            told = getattr(self, name)
            if told is not None:
                values = float_array(name, told, shape, low=0.0, high=1.0)
                object.__setattr__(self, name, values)
        flags = bool_array("identifiable", self.identifiable, shape)
        object.__setattr__(self, "identifiable", flags)


def read_material_table(path: Path) -> MaterialTable:
    """Read the materials of a ``result.json`` or an ``absorption.csv``.

    Raises
    ------
    InputError
        There is no such file, it is neither of the two, or its numbers are out of range.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            "the result cannot be read",
            where=str(path),
            found=str(error),
            needed="a result.json or an absorption.csv written by roomfit",
        ) from error
    with located(str(path)):
        if path.suffix.lower() == ".csv":
            return _from_csv(text)
        return _from_json(text)


def _from_json(text: str) -> MaterialTable:
    try:
        content = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(
            "the result is not JSON", found=str(error), needed="a result.json or an absorption.csv"
        ) from error
    if not isinstance(content, dict) or content.get("format") != "roomfit-result":
        raise InputError(
            "this is no result of roomfit", needed='"format": "roomfit-result" in the file'
        )
    if content.get("format_version") != 1:
        raise InputError(
            "this version of roomfit cannot read that result",
            found=f"format_version {content.get('format_version')}",
            needed="format_version 1",
        )
    try:
        materials: dict[str, Any] = content["materials"]
        told = list(materials.values())
        scattering = [m.get("scattering") for m in told]
        return MaterialTable(
            tuple(materials),
            _bands(content["bands_hz"]),
            np.array([m["absorption"] for m in told]),
            np.array([m["lower95"] for m in told]),
            np.array([m["upper95"] for m in told]),
            np.array([m["identifiable"] for m in told]),
            None if None in scattering or not told else np.array(scattering),
        )
    except (KeyError, AttributeError, TypeError, ValueError) as error:
        raise InputError(
            "the result is incomplete",
            found=f"{type(error).__name__}: {error}",
            needed="bands_hz, and for each material absorption, lower95, upper95, identifiable",
        ) from error


def _from_csv(text: str) -> MaterialTable:
    rows = list(csv.DictReader(text.splitlines()))
    header = tuple(rows[0]) if rows else ()
    if not set(_COLUMNS) <= set(header):
        raise InputError(
            "the table of absorption lacks columns or rows",
            found=", ".join(str(c) for c in header) or "nothing",
            needed=", ".join(_COLUMNS),
        )
    try:
        names = tuple(dict.fromkeys(row["material"] for row in rows))
        centres = sorted({float(row["band_hz"]) for row in rows})
        place = {(row["material"], float(row["band_hz"])): row for row in rows}
        if len(place) != len(rows) or len(rows) != len(names) * len(centres):
            raise InputError(
                "the table of absorption is not complete",
                found=f"{len(rows)} rows, {len(names)} materials, {len(centres)} bands",
                needed="each material in each band once",
            )
        absorption, lower, upper = (
            np.array([[float(place[m, f][column]) for f in centres] for m in names])
            for column in ("absorption", "lower95", "upper95")
        )
        sure = [[place[m, f]["identifiable"].lower() == "true" for f in centres] for m in names]
    except (ValueError, AttributeError) as error:
        raise InputError("the table of absorption holds what is no number") from error
    return MaterialTable(names, _bands(centres), absorption, lower, upper, np.array(sure))


def _bands(centres: list[float]) -> Bands:
    octaves = set(centres) <= set(OCTAVES_HZ)
    return Bands("octave" if octaves else "third-octave", np.array(centres, dtype=np.float64))
