"""A small measured campaign: a box, one source, two receivers, two octaves; and how to run it."""

from __future__ import annotations

import re
import sys
from functools import cache
from pathlib import Path

import numpy as np
import soundfile

from roomfit.base.air import Air, attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import bands_between
from roomfit.demo.boxes import SyntheticBox, add_noise, pressure_response

RATE_HZ = 8000
LENGTHS_M = (3.9, 3.1, 2.5)
SOURCE_M = (1.0, 1.2, 1.1)
RECEIVERS_M = {"MP1": (2.9, 2.2, 1.3), "MP2": (3.1, 0.9, 1.6)}
ABSORPTION = {"walls": 0.15, "carpet": 0.4, "tiles": 0.3}
# What `roomfit identify` says on stderr.
STAGE_OR_FIRST_ANSWER = re.compile(
    r"\d+:\d\d  ([a-z ]+|so far, absorption .+|[ \d.]+ Hz.*|\S.* \(\d+-\d+\))$"
)

MATERIALS = """[room.materials]
walls = "walls"
floor = "carpet"
ceiling = "tiles"
"""
SMALL = f"""
[room]
shoebox = [3.9, 3.1, 2.5]
{MATERIALS}[materials.walls]
scattering = 0.0
[materials.carpet]
scattering = 0.0
[materials.tiles]
scattering = 0.0
[sources.LS1]
position = [1.0, 1.2, 1.1]
[receivers.MP1]
position = [2.9, 2.2, 1.3]
[receivers.MP2]
position = [3.1, 0.9, 1.6]
[[measurements]]
source = "LS1"
receiver = "MP1"
file = "LS1_MP1.wav"
[[measurements]]
source = "LS1"
receiver = "MP2"
file = "LS1_MP2.wav"
[identify]
from_hz = 500
to_hz = 1000
"""

_CORNERS = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
_QUADS = (
    ("west", "walls", (1, 2, 4, 3)),
    ("east", "walls", (5, 7, 8, 6)),
    ("south", "walls", (1, 5, 6, 2)),
    ("north", "walls", (3, 4, 8, 7)),
    ("floor", "carpet", (1, 3, 7, 5)),
    ("ceiling", "tiles", (2, 6, 8, 4)),
)


@cache
def small_responses() -> dict[str, np.ndarray]:
    """Return the pressure at each receiver: image sources with phase, and noise at -60 dB."""
    bands = bands_between("octave", 250, 2000)
    air = Air()
    owners = ("walls", "walls", "walls", "walls", "carpet", "tiles")
    absorption = np.array([[ABSORPTION[name]] * len(bands) for name in owners])
    truth = SyntheticBox(
        LENGTHS_M,
        bands.centres_hz,
        absorption,
        attenuation_per_m(air, bands),
        speed_of_sound_m_s(air),
    )
    rng = np.random.default_rng(7)
    flat = np.zeros(len(bands))
    return {
        name: add_noise(
            pressure_response(truth, np.array(SOURCE_M), np.array(at), 0.5, RATE_HZ, flat), -60, rng
        )
        for name, at in RECEIVERS_M.items()
    }


def write_wav(path: Path, pressure: np.ndarray, rate_hz: int = RATE_HZ) -> None:
    """Write samples in floating point; columns are channels."""
    soundfile.write(path, np.asarray(pressure, dtype=np.float32), rate_hz, subtype="FLOAT")


def write_campaign(folder: Path, *changes: tuple[str, str]) -> Path:
    """Write the campaign with its two files, the text changed as specified, and return its path.

    Each change replaces every occurrence of a text that must stand there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, pressure in small_responses().items():
        write_wav(folder / f"LS1_{name}.wav", pressure)
    text = SMALL
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    path = folder / "campaign.toml"
    path.write_text(text, encoding="utf-8")
    return path


def box_obj(*, without: str = "", more: str = "") -> str:
    """Return the box as an OBJ file in metres that names the campaign's materials itself."""
    vertices = (np.array(_CORNERS) * LENGTHS_M).tolist()
    lines = [f"v {x} {y} {z}" for x, y, z in vertices]
    for name, material, quad in _QUADS:
        if name != without:
            lines += [f"g {name}", f"usemtl {material}", f"f {' '.join(map(str, quad))}"]
    return "\n".join([*lines, more]) + "\n"


def run_command(monkeypatch, *arguments: object) -> int:
    """Run the command line in this process and return its exit code."""
    from roomfit.cli import main

    monkeypatch.setattr(sys, "argv", ["roomfit", *map(str, arguments)])
    try:
        main()
    except SystemExit as end:
        return int(end.code or 0)
    return 0
