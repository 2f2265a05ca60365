"""Doubts that the fitted geometry leaves."""

from __future__ import annotations

import numpy as np

from roomfit.findings import Finding
from roomfit.uncertainty.answer import FittedGeometry

# In told standard deviations: beyond it, of some thirty unknowns one moves by chance once in 70.
_FAR = 3.5
# Log-likelihood that a delay for each wall must gain: far above what a handful of unknowns that
# explain nothing would, half a unit each.
_DELAYS_TELL = 15.0


def delay_findings(gain: float) -> tuple[Finding, ...]:
    """Return a finding where walls were not allowed to delay, but do.

    Parameters
    ----------
    gain : float
        By how much the data are likelier, over all bands, if each material may delay.
    """
    if gain <= _DELAYS_TELL:
        return ()
    return (
        Finding(
            "walls-delay",
            "serious",
            "The measurements are far likelier if walls delay what they reflect, which was "
            "switched off (wall_delays = false): intervals are too narrow without, and nothing is "
            "called identifiable.",
            {"log_likelihood_gain": gain},
        ),
    )


def geometry_findings(geometry: FittedGeometry | None) -> tuple[Finding, ...]:
    """Return a finding where the fit had to move something farther than was told."""
    if geometry is None:
        return ()
    told = np.where(geometry.told_sd > 0.0, geometry.told_sd, np.inf)
    far = np.flatnonzero(np.abs(geometry.change) / told > _FAR)
    if not far.size:
        return ()
    names = ", ".join(geometry.labels[i] for i in far)
    return (
        Finding(
            "geometry-moved-far",
            "warning",
            f"To explain the arrival times, the fit moved {names} by more than three and a half "
            "times its stated spread: it may be told wrong, or make up for an error of the model.",
            {
                "labels": [geometry.labels[i] for i in far],
                "change": [float(geometry.change[i]) for i in far],
                "told_sd": [float(geometry.told_sd[i]) for i in far],
            },
        ),
    )
