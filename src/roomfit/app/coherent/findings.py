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
# Log-likelihood a window that free places must gain. In boxes with 1 mm and 3 us told and right it
# was .01 to .05, and answers changed by a tenth of their interval; with 1 cm .4 to .9, and a half.
_PLACES_TELL = 0.1


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


def place_findings(gain: float, n_unknowns: int, n_windows: int) -> tuple[Finding, ...]:
    """Return a finding where places were held that arrival times contradict.

    Parameters
    ----------
    gain : float
        By how much the data are likelier, over all bands, if places, speed of sound and latencies
        may move within their stated spread.
    n_unknowns : int
        How many unknowns that are; each that explains nothing gains half a unit on average.
    n_windows : int
        Of all bands.
    """
    if gain <= max(n_unknowns + _DELAYS_TELL, _PLACES_TELL * n_windows):
        return ()
    return (
        Finding(
            "places-move",
            "serious",
            "The measurements are far likelier if places, speed of sound and latencies move within "
            'their stated spread, which was switched off (positions = "fixed"): intervals are too '
            'narrow so, and nothing is called identifiable. Use positions = "fit".',
            {"log_likelihood_gain": gain, "n_unknowns": n_unknowns, "n_windows": n_windows},
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
