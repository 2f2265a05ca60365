"""Places that are told more surely than arrival times can bear, taken for less sure.

Doubts that the fitted geometry leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from roomfit.findings import Code, Finding
from roomfit.inversion.sequential import CoherentBand, CoherentBandFit
from roomfit.objective.coherent import FittedGeometry
from roomfit.scene import Point, Scene
from roomfit.typing import FloatArray

# In told standard deviations: beyond it, of some thirty unknowns one moves by chance once in 70.
_FAR = 3.5
# Log-likelihood that a delay for each wall must gain: far above what a handful of unknowns that
# explain nothing would, half a unit each.
_DELAY_GAIN = 15.0
# Log-likelihood a window that free places must gain. In boxes with 1 mm and 3 us told and right it
# was .01 to .05, and answers changed by a tenth of their interval; with 1 cm .4 to .9, and a half.
_POSITION_GAIN_PER_WINDOW = 0.1


def delay_findings(gain: float) -> tuple[Finding, ...]:
    """Return a finding where walls were not allowed to delay, but do.

    Parameters
    ----------
    gain : float
        By how much the data are likelier, over all bands, if each material may delay.
    """
    if gain <= _DELAY_GAIN:
        return ()
    return (
        Finding(
            Code.REFLECTION_DELAY_DETECTED,
            "The measurements are far likelier if walls delay what they reflect, which was "
            "switched off (wall_delays = false): intervals are too narrow without, and nothing is "
            "called identifiable.",
            {"log_likelihood_gain": gain},
        ),
    )


def position_consistency_findings(
    gain: float, n_unknowns: int, n_windows: int
) -> tuple[Finding, ...]:
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
    if gain <= max(n_unknowns + _DELAY_GAIN, _POSITION_GAIN_PER_WINDOW * n_windows):
        return ()
    return (
        Finding(
            Code.POSITION_INCONSISTENT,
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
    prior_sd = np.where(geometry.prior_sd > 0.0, geometry.prior_sd, np.inf)
    far = np.flatnonzero(np.abs(geometry.change) / prior_sd > _FAR)
    if not far.size:
        return ()
    names = ", ".join(geometry.labels[i] for i in far)
    return (
        Finding(
            Code.GEOMETRY_SHIFT_IMPLAUSIBLE,
            f"To explain the arrival times, the fit moved {names} by more than three and a half "
            "times its stated spread: it may be told wrong, or make up for an error of the model.",
            {
                "labels": [geometry.labels[i] for i in far],
                "change": [float(geometry.change[i]) for i in far],
                "told_sd": [float(geometry.prior_sd[i]) for i in far],
            },
        ),
    )


# Places told as surely as they are known move farther once in a thousand campaigns.
_LEVEL = 0.999
_MOST = 5.0
_FEWEST = 6


def estimate_position_sd_scale(
    scene: Scene,
    prepared: Sequence[CoherentBand | None],
    fits: Sequence[CoherentBandFit | None],
) -> float:
    """Return by how much the told spread of all places is too small; 1 where it may be right.

    The mean square of what the places moved, in told standard deviations and with what is left open
    of each, against chi-square with as many degrees of freedom as there are coordinates.

    Parameters
    ----------
    prepared, fits : sequences, one a band
        Low to high; the last fit knows what all before it say of the geometry.
    """
    band = next((b for b in prepared if b is not None), None)
    found = [f.found for f in fits if f is not None and f.found is not None]
    if band is None or not found:
        return 1.0
    geometry, last = band.problem.geometry, found[-1]
    moving = np.flatnonzero(geometry.fitted & (geometry.sd > 0.0))
    is_position = moving < _n_position_coordinates(scene)
    n = int(np.count_nonzero(is_position))
    if n < _FEWEST:
        return 1.0
    variance = np.diag(np.linalg.inv(last.information))
    mean = float(np.mean((last.mean**2 + variance)[is_position]))
    return 1.0 if mean <= chi2.ppf(_LEVEL, n) / n else min(float(np.sqrt(mean)), _MOST)


def inflate_position_sds(
    scene: Scene, origin: FloatArray | None, position_sd_scale: float
) -> tuple[Scene, FloatArray | None]:
    """Return a scene whose places are told less surely, and where paths were traced in its units.

    Points of which nothing is told stay so, with the spread that is then assumed.

    Parameters
    ----------
    origin : float array or None
        Free numbers of the places at which paths were traced.
    """

    def inflated(points: tuple[Point, ...]) -> tuple[Point, ...]:
        return tuple(
            p
            if p.position_sd_m is None
            else replace(p, position_sd_m=position_sd_scale * p.position_sd_m)
            for p in points
        )

    changed = replace(scene, sources=inflated(scene.sources), receivers=inflated(scene.receivers))
    if origin is None:
        return changed, None
    specified = [p.position_sd_m is not None for p in (*scene.sources, *scene.receivers)]
    factor = np.ones(origin.size)
    factor[: _n_position_coordinates(scene)] = np.where(
        np.repeat(specified, 3), position_sd_scale, 1.0
    )
    return changed, origin / factor


def position_uncertainty_findings(scale: float) -> tuple[Finding, ...]:
    """Return a finding where places were taken for less sure than told."""
    if scale <= 1.0:
        return ()
    return (
        Finding(
            Code.POSITION_UNCERTAINTY_INFLATED,
            f"Arrival times contradict the stated spread of the positions: taken all together they "
            f"are off {scale:.1f} times as far, and were fitted with {scale:.1f} times that "
            "spread. Measure them again; the drawing of the room may be wrong, too.",
            {"stretch": scale},
        ),
    )


def _n_position_coordinates(scene: Scene) -> int:
    return 3 * (len(scene.sources) + len(scene.receivers))
