"""Standard deviations of positions, inflated where arrival times contradict them.

Where positions as a whole had to move farther than their specified standard deviations allow, these
are inflated and the fit is repeated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from roomfit.base.typing import FloatArray
from roomfit.pressures.sequential import CoherentBand, CoherentBandFit
from roomfit.room.scene import Point, Scene

# Positions whose standard deviations are right move farther once in a thousand campaigns.
LEVEL = 0.999
_LARGEST_SCALE = 5.0
_FEWEST_COORDINATES = 6


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
    return 1.0 if mean <= chdtri(n, 1.0 - LEVEL) / n else min(float(np.sqrt(mean)), _LARGEST_SCALE)


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


def _n_position_coordinates(scene: Scene) -> int:
    return 3 * (len(scene.sources) + len(scene.receivers))
