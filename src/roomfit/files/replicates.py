"""Replicates of a calibration: one small JSON file each, so that a killed run loses one at most."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.errors import InputError, StoreError
from roomfit.files.store import write_json_atomically
from roomfit.typing import BoolArray, FloatArray
from roomfit.uncertainty.answer import Answer

FOLDER = "replicates"
_FORMAT, _VERSION = "roomfit-replicate", 1


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What an identification said of a made campaign.

    Attributes
    ----------
    absorption, lower95, upper95 : float arrays, shape (n_materials, n_bands)
    identifiable : bool array, shape (n_materials, n_bands)
    uniform : float array, shape (n_bands,)
        Eyring's absorption of the measured decay.
    phi : float array, shape (n_bands,)
    models : tuple of str, one a band
    findings : tuple of str
        Codes of all findings above "info", each once.
    """

    absorption: FloatArray
    lower95: FloatArray
    upper95: FloatArray
    identifiable: BoolArray
    uniform: FloatArray
    phi: FloatArray
    models: tuple[str, ...]
    findings: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Replicate:
    """One made campaign.

    Attributes
    ----------
    number : int
    digest : str
        Of the campaign and the settings that it belongs to.
    road : str
        How its responses were made.
    true : float array, shape (n_materials, n_bands)
    refused : str or None
        Why roomfit gave no answer.
    found : Found or None
        None where it gave none.
    seconds : float
    """

    number: int
    digest: str
    road: str
    true: FloatArray
    refused: str | None
    found: Found | None
    seconds: float

    @staticmethod
    def found_in(answer: Answer, uniform: FloatArray) -> Found:
        """Return what is kept of an answer."""
        codes = sorted({f.code for f in answer.findings if f.severity != "info"})
        return Found(
            answer.absorption,
            answer.lower95,
            answer.upper95,
            answer.identifiable,
            uniform,
            answer.phi,
            answer.models,
            tuple(codes),
        )


def replicate_path(out: Path, number: int) -> Path:
    """Return where a replicate lies within the output folder."""
    return Path(out) / FOLDER / f"{number:04d}.json"


def write_replicate(out: Path, replicate: Replicate) -> Path:
    """Write one replicate, aside first; its folder is made if needed.

    Raises
    ------
    StoreError
        The disk refuses.
    """
    path = replicate_path(out, replicate.number)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(
            "the folder of replicates cannot be made", where=str(path.parent), found=str(error)
        ) from error
    content: dict[str, Any] = {
        "format": _FORMAT,
        "format_version": _VERSION,
        "digest": replicate.digest,
        "number": replicate.number,
        "road": replicate.road,
        "true": replicate.true.tolist(),
        "refused": replicate.refused,
        "seconds": round(replicate.seconds, 2),
    }
    found = replicate.found
    if found is not None:
        for name in ("absorption", "lower95", "upper95", "identifiable", "uniform", "phi"):
            content[name] = getattr(found, name).tolist()
        content["models"], content["findings"] = list(found.models), list(found.findings)
    return write_json_atomically(path, content)


def read_replicate(out: Path, number: int, digest: str) -> Replicate | None:
    """Return a replicate of a calibration; None where there is none yet.

    Raises
    ------
    InputError
        The file is damaged, or belongs to another campaign, other settings or another version.
    """
    path = replicate_path(out, number)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise _damaged(path, str(error)) from error
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise _damaged(path, "another kind of file")
    if content.get("digest") != digest:
        raise InputError(
            "a replicate belongs to another calibration",
            where=str(path),
            found="another campaign, other measured files, --from, --snr-db or --seed, or another "
            "version of roomfit",
            needed="the same as it was made with",
            hint="choose another folder",
        )
    try:
        return _replicate(content)
    except (KeyError, TypeError, ValueError) as error:
        raise _damaged(path, f"{type(error).__name__}: {error}") from error


def _replicate(content: dict[str, Any]) -> Replicate:
    found = None
    if content["refused"] is None:
        absorption, lower95, upper95 = (
            np.array(content[name], dtype=np.float64)
            for name in ("absorption", "lower95", "upper95")
        )
        found = Found(
            absorption,
            lower95,
            upper95,
            np.array(content["identifiable"], dtype=np.bool_),
            np.array(content["uniform"], dtype=np.float64),
            np.array(content["phi"], dtype=np.float64),
            tuple(content["models"]),
            tuple(content["findings"]),
        )
    return Replicate(
        int(content["number"]),
        content["digest"],
        content["road"],
        np.array(content["true"], dtype=np.float64),
        content["refused"],
        found,
        float(content["seconds"]),
    )


def _damaged(path: Path, why: str) -> InputError:
    return InputError(
        "a replicate is damaged",
        where=str(path),
        found=why,
        hint="remove it; it will be made again",
    )
