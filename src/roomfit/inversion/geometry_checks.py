"""Whether arrival times agree with the specified positions, speed of sound and latencies.

Positions, delays and the like that the settings fix are fitted for comparison, and a doubt is
raised where the data are far likelier then. Where positions as a whole had to move farther than
their specified standard deviations allow, these are inflated and the fit is repeated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from roomfit.findings import About, Code, Finding
from roomfit.inversion.sequential import CoherentBand, CoherentBandFit
from roomfit.objective.coherent import FittedGeometry
from roomfit.scene import Point, Scene
from roomfit.typing import FloatArray

# In prior standard deviations: beyond it, of some thirty unknowns one moves by chance once in 70.
_LARGEST_SHIFT_SD = 3.5
# Log-likelihood that a delay for each wall must gain: far above what a handful of unknowns that
# explain nothing would, half a unit each.
_DELAY_GAIN = 15.0
# Log-likelihood a window that free positions must gain. In boxes with errors of 1 mm and 3 us,
# correctly specified, it was .01 to .05, and answers changed by a tenth of their interval; with
# 1 cm .4 to .9, and by a half.
_POSITION_GAIN_PER_WINDOW = 0.1

# Positions whose standard deviations are right move farther once in a thousand campaigns.
_LEVEL = 0.999
_LARGEST_SCALE = 5.0
_FEWEST_COORDINATES = 6


def delay_findings(gain: float) -> tuple[Finding, ...]:
    """Return a finding where reflections are delayed by walls and the settings exclude it.

    Parameters
    ----------
    gain : float
        Of the log-likelihood, over all bands, if each material has a delay.
    """
    if gain <= _DELAY_GAIN:
        return ()
    return (
        Finding(
            Code.REFLECTION_DELAY_DETECTED,
            About(),
            "Delays of reflections, which were excluded (wall_delays = false), raise the "
            f"log-likelihood by {gain:.0f}: without them intervals are too narrow, and no material "
            "is called identifiable. Use wall_delays = true.",
            {"log_likelihood_gain": gain},
        ),
    )


def position_consistency_findings(
    gain: float, n_unknowns: int, n_windows: int
) -> tuple[Finding, ...]:
    """Return a finding where positions were fixed that arrival times contradict.

    Parameters
    ----------
    gain : float
        Of the log-likelihood, over all bands, if positions, speed of sound and latencies may move
        within their specified standard deviations.
    n_unknowns : int
        Number of these; each that explains nothing gains half a unit on average.
    n_windows : int
        Of all bands.
    """
    if gain <= max(n_unknowns + _DELAY_GAIN, _POSITION_GAIN_PER_WINDOW * n_windows):
        return ()
    return (
        Finding(
            Code.POSITION_INCONSISTENT,
            About(),
            "Positions, speed of sound and latencies, which were fixed "
            f'(positions = "fixed"), raise the log-likelihood by {gain:.0f} if they move within '
            "their specified standard deviations: intervals are too narrow, and no material is "
            'called identifiable. Use positions = "fit".',
            {"log_likelihood_gain": gain, "n_unknowns": n_unknowns, "n_windows": n_windows},
        ),
    )


def geometry_findings(geometry: FittedGeometry | None) -> tuple[Finding, ...]:
    """Return a finding where the fit moved something implausibly far from its prior."""
    if geometry is None:
        return ()
    prior_sd = np.where(geometry.prior_sd > 0.0, geometry.prior_sd, np.inf)
    far = np.flatnonzero(np.abs(geometry.change) / prior_sd > _LARGEST_SHIFT_SD)
    if not far.size:
        return ()
    names = [geometry.labels[i] for i in far]
    return (
        Finding(
            Code.GEOMETRY_SHIFT_IMPLAUSIBLE,
            About(),
            f"To explain the arrival times, the fit moved {', '.join(names)} by more than "
            f"{_LARGEST_SHIFT_SD:g} prior standard deviations: it may be specified wrongly, or "
            "compensate for an error of the model. Check it.",
            {
                "labels": names,
                "change": geometry.change[far].tolist(),
                "told_sd": geometry.prior_sd[far].tolist(),
            },
        ),
    )


def estimate_position_sd_scale(
    scene: Scene,
    prepared: Sequence[CoherentBand | None],
    fits: Sequence[CoherentBandFit | None],
) -> float:
    """Return by how much position standard deviations are too small; 1 where they may be right.

    The mean square of the shifts of all coordinates, in prior standard deviations and with the
    posterior variance of each, against chi-square with as many degrees of freedom, n. At most 5.

    Parameters
    ----------
    prepared, fits : sequences, one a band
        Low to high; the last fit includes the information of all before it on the geometry.
    """
    band = next((b for b in prepared if b is not None), None)
    found = [f.found for f in fits if f is not None and f.found is not None]
    if band is None or not found:
        return 1.0
    geometry, last = band.coherent.geometry, found[-1]
    moving = np.flatnonzero(geometry.fitted & (geometry.sd > 0.0))
    is_position = moving < _n_position_coordinates(scene)
    n = int(np.count_nonzero(is_position))
    if n < _FEWEST_COORDINATES:
        return 1.0
    variance = np.diag(np.linalg.inv(last.information))
    mean = float(np.mean((last.mean**2 + variance)[is_position]))
    return 1.0 if mean <= chdtri(n, 1.0 - _LEVEL) / n else min(float(np.sqrt(mean)), _LARGEST_SCALE)


def inflate_position_sds(
    scene: Scene, origin: FloatArray | None, position_sd_scale: float
) -> tuple[Scene, FloatArray | None]:
    """Return a scene with larger standard deviations of positions, and the origin in their units.

    Points without a specified standard deviation keep the one that is then assumed.

    Parameters
    ----------
    origin : float array or None
        Free numbers of the geometry at which paths were traced, in standard deviations.
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
    """Return a finding where the standard deviations of positions were inflated by a scale."""
    if scale <= 1.0:
        return ()
    return (
        Finding(
            Code.POSITION_UNCERTAINTY_INFLATED,
            About(),
            "Arrival times contradict the specified standard deviations of positions: all "
            f"together, positions are off {scale:.1f} times as far, and were fitted with standard "
            f"deviations {scale:.1f} times as large. Measure the positions again; the room's "
            "dimensions may be wrong, too.",
            {"stretch": scale},
        ),
    )


def _n_position_coordinates(scene: Scene) -> int:
    return 3 * (len(scene.sources) + len(scene.receivers))
