"""Limits of standards, from a data file that names edition, clause and sources."""

from __future__ import annotations

import tomllib
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from roomfit.base.arguments import check_known
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.room.mesh import volume_m3
from roomfit.room.scene import Room
from roomfit.treat.question import Target

_SABINE_S_PER_M = 0.16  # T = 0.16 V / A, as DIN EN 12354-6 and the sources have it


@cache
def standards() -> dict[str, dict[str, Any]]:
    """Return every entry of the data file by its name."""
    text = files("roomfit.treat").joinpath("standards.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def standard_target(name: str, room: Room) -> tuple[Target, tuple[Finding, ...]]:
    """Return what a standard asks of a room: T30, mean over the pairs, in each of its bands.

    Limits hold of the room as it is measured; a standard that counts people in asks for less than
    an empty room then has.
    """
    known = standards()
    check_known("no standard of this name", name, known)
    entry, volume = known[name], volume_m3(room.mesh)
    least, most = entry.get("volume_m3", (0.0, np.inf))
    if not least <= volume <= most:
        raise InputError(
            "a standard is not for rooms of this volume",
            where=f'standard = "{name}"',
            found=f"{volume:.4g} m3",
            needed=f"{least:g} to {most:g} m3 ({entry['title']})",
            hint="another entry, or a target with at_most",
        )
    if "time" in entry:
        slope, constant = entry["time"]
        limit = slope * np.log10(volume) + constant
    else:
        height = float(np.ptp(room.mesh.vertices_m[:, 2]))
        constant, slope = entry["per_absorption"]
        limit = _SABINE_S_PER_M * (constant + slope * np.log10(max(height, 2.5)))
    low, high = entry.get("range", (-np.inf, 1.0))
    target = Target(
        "T30_s",
        low * limit if np.isfinite(low) else -np.inf,
        high * limit,
        tuple(float(f) for f in entry["bands_hz"]),
        entry.get("mean_of_bands", False),
        entry["title"],
    )
    sources = entry["sources"]
    doubts = [f"its number was found in one public source only ({sources[0]})"]
    doubts = [] if len(sources) > 1 else doubts
    if "unchecked" in entry:
        doubts.append(f"{entry['unchecked']} was found in no second source")
    if not doubts:
        return target, ()
    sentence = (
        f"{entry['title']}: {', and '.join(doubts)}. Look it up in the standard before you rely on "
        "it."
    )
    return target, (
        Finding(Code.STANDARD_NOT_CHECKED, About(), sentence, {"sources": list(sources)}),
    )
