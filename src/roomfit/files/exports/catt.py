"""CATT-Acoustic, and I-Simpa, which reads the same lines without the first word."""

from __future__ import annotations

import colorsys

import numpy as np

from roomfit.bands import Bands
from roomfit.typing import FloatArray

CATT_BANDS = Bands("octave", np.array([125.0, 250.0, 500.0, 1e3, 2e3, 4e3, 8e3, 16e3]))
ISIMPA_BANDS = Bands("octave", np.array([125.0, 250.0, 500.0, 1e3, 2e3, 4e3]))
LONGEST_NAME = 15


def catt_text(
    names: dict[str, str], absorption: FloatArray, scattering: FloatArray, remarks: list[str]
) -> str:
    """Return ``ABS`` lines for a .geo file: octaves 125 Hz to 4 kHz, a colon, 8 and 16 kHz.

    Percent without decimals, 1 to 99: what every version reads. The exact values follow behind a
    semicolon, where a .geo file's comments begin.

    Parameters
    ----------
    names : dict
        Own name to short name, in the order of the rows.
    absorption, scattering : float arrays, shape (n_materials, 8)
    remarks : list of str
        Written as comments at the top.
    """
    lines = [f"; {remark}" for remark in remarks]
    for i, (name, short) in enumerate(names.items()):
        a, s = absorption[i], scattering[i]
        r, g, b = _colour(i, len(names))
        exact = " ".join(f"{v:.4f}" for v in a)
        lines.append(
            f"ABS {short} = <{_eight(a, 1)}> L <{_eight(s, 0)}> {{{r} {g} {b}}} ; "
            f"{_one_line(name)}: {exact}"
        )
    return "\r\n".join(lines) + "\r\n"


def isimpa_text(names: dict[str, str], absorption: FloatArray, scattering: FloatArray) -> str:
    """Return the material lines that I-Simpa imports as "CATT-Acoustic" (.txt).

    Six octaves from 125 Hz in percent without decimals, as in the example of its manual [1]_;
    I-Simpa itself gives each value to three third octaves and holds the outer ones. The lines have
    no comments: its manual shows none.

    References
    ----------
    .. [1] I-Simpa documentation, "Project database", materials, import from a file.
    """
    lines = [
        f"{short} = < {_percent(absorption[i], 1)} > L < {_percent(scattering[i], 0)} >"
        for i, short in enumerate(names.values())
    ]
    return "\n".join(lines) + "\n"


def _eight(values: FloatArray, least: int) -> str:
    return f"{_percent(values[:6], least)} : {_percent(values[6:], least)}"


def _percent(values: FloatArray, least: int) -> str:
    return " ".join(str(int(np.clip(round(100.0 * v), least, 99))) for v in values)


def _colour(number: int, count: int) -> tuple[int, int, int]:
    """Colours far apart on the circle of hues."""
    red, green, blue = colorsys.hsv_to_rgb(number / max(count, 1), 0.55, 0.85)
    return round(255 * red), round(255 * green), round(255 * blue)


def _one_line(name: str) -> str:
    return " ".join(name.split())
