"""The exact wave fields of the data folder as measurements."""

from __future__ import annotations

import numpy as np

from roomfit.impedance.data import Observed


def exact(data, name="exact_M3"):
    """Six pairs of `simulated_rooms.impedance_box`; the noise is specified to be none."""
    file = np.load(data / "impedance_exact" / f"{name}.npz")
    p = file["p"].T
    return Observed(file["f"], float(file["tau"]), p, np.zeros(p.shape))
