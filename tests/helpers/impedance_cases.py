"""The exact wave fields of the data folder as measurements, and curves drawn through walls."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from roomfit.impedance.data import Observed


def exact(data, name="exact_M3"):
    """Six pairs of `simulated_rooms.impedance_box`; the noise is specified to be none."""
    file = np.load(data / "impedance_exact" / f"{name}.npz")
    p = file["p"].T
    return Observed(file["f"], float(file["tau"]), p, np.zeros(p.shape))


def nearest(curve, r0, weak=1e-4):
    """Return the numbers of a curve that come nearest to some R0, smooth where it does not say."""
    n = len(curve.start())
    rough = weak * np.vstack([curve.roughness, np.eye(n)])

    def rows(x):
        off = curve.values(x)[0] - r0
        return np.concatenate([off.real, off.imag, rough @ (x - curve.start())])

    def slopes(x):
        by = curve.values(x)[1]
        return np.vstack([by.real, by.imag, rough])

    return least_squares(rows, curve.start(), slopes, max_nfev=60).x
