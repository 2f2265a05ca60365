"""ODEON: rows of a material library (.Li8)."""

from __future__ import annotations

import numpy as np

from roomfit.bands import Bands
from roomfit.typing import FloatArray

ODEON_BANDS = Bands("octave", np.array([63.0, 125.0, 250.0, 500.0, 1e3, 2e3, 4e3, 8e3]))
FIRST_NUMBER = 50001


def odeon_text(names: tuple[str, ...], absorption: FloatArray) -> str:
    """Return two lines a material: number and name; then eight octaves from 63 Hz.

    The second line begins with a tabulator, and tabulators stand between its values: so does a
    program that reads ODEON's own library tell the two apart [1]_. The library has no scattering:
    ODEON wants it for each surface, in its list of materials.

    Parameters
    ----------
    names : tuple of str
    absorption : float array, shape (n_materials, 8)

    References
    ----------
    .. [1] R. Gueguen, Just4RIR (2018), ``physic.cpp``.
    """
    lines = []
    for i, name in enumerate(names):
        lines.append(f"{FIRST_NUMBER + i} {' '.join(name.split())}")
        lines.append("".join(f"\t{v:.5f}" for v in absorption[i]))
    return "\r\n".join(lines) + "\r\n"
