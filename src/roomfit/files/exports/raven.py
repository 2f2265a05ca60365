"""RAVEN: one text file (.mat) a material, 31 third octaves from 20 Hz to 20 kHz."""

from __future__ import annotations

import numpy as np

from roomfit.bands import Bands
from roomfit.typing import BoolArray, FloatArray

RAVEN_BANDS = Bands(
    "third-octave",
    np.array(
        [
            *(20.0, 25.0, 31.5, 40.0, 50.0, 63.0, 80.0, 100.0, 125.0, 160.0, 200.0, 250.0),
            *(315.0, 400.0, 500.0, 630.0, 800.0, 1000.0, 1250.0, 1600.0, 2000.0, 2500.0),
            *(3150.0, 4000.0, 5000.0, 6300.0, 8000.0, 10000.0, 12500.0, 16000.0, 20000.0),
        ]
    ),
)


def raven_text(
    name: str, notes: str, absorption: FloatArray, scattering: FloatArray, told: BoolArray
) -> str:
    """Return the text of one material file.

    Layout and line ends are those that the ITA Toolbox writes [1]_; `told` are the bands whose
    value was fitted: they get a 0 in ``interpol``, all others a 1.

    Parameters
    ----------
    name : str
        Also the name of the file, without its ending.
    notes : str
        One line.
    absorption, scattering : float arrays, shape (31,)
    told : bool array, shape (31,)

    References
    ----------
    .. [1] ITA Toolbox, RWTH Aachen, ``itaRavenProject.m``, ``setMaterial``.
    """
    rows = [
        "[Material]",
        f"name={name}",
        f"notes={' '.join(notes.split())}",
        f"absorp={_row(absorption)}",
        f"scatter={_row(scattering)}",
        f"interpol={','.join('0' if t else '1' for t in told)}",
    ]
    return "\r\n".join(rows) + "\r\n"


def _row(values: FloatArray) -> str:
    return ", ".join(f"{v:.4f}" for v in values)
