"""Places that are told more surely than arrival times can bear, taken for less sure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from roomfit.app.coherent.bands import CoherentBand
from roomfit.findings import Finding
from roomfit.identification.coherence_rounds import CoherentBandFit
from roomfit.scene.scene import Point, Scene
from roomfit.typing import FloatArray

# Places told as surely as they are known move farther once in a thousand campaigns.
_LEVEL = 0.999
_MOST = 5.0
_FEWEST = 6


def places_stretch(
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
    places = moving < _n_places(scene)
    n = int(np.count_nonzero(places))
    if n < _FEWEST:
        return 1.0
    variance = np.diag(np.linalg.inv(last.information))
    mean = float(np.mean((last.mean**2 + variance)[places]))
    return 1.0 if mean <= chi2.ppf(_LEVEL, n) / n else min(float(np.sqrt(mean)), _MOST)


def looser_places(
    scene: Scene, origin: FloatArray | None, stretch: float
) -> tuple[Scene, FloatArray | None]:
    """Return a scene whose places are told less surely, and where paths were traced in its units.

    Points of which nothing is told stay so, with the spread that is then assumed.

    Parameters
    ----------
    origin : float array or None
        Free numbers of the places at which paths were traced.
    """

    def looser(points: tuple[Point, ...]) -> tuple[Point, ...]:
        return tuple(
            p if p.position_sd_m is None else replace(p, position_sd_m=stretch * p.position_sd_m)
            for p in points
        )

    changed = replace(scene, sources=looser(scene.sources), receivers=looser(scene.receivers))
    if origin is None:
        return changed, None
    told = [p.position_sd_m is not None for p in (*scene.sources, *scene.receivers)]
    factor = np.ones(origin.size)
    factor[: _n_places(scene)] = np.where(np.repeat(told, 3), stretch, 1.0)
    return changed, origin / factor


def places_findings(stretch: float) -> tuple[Finding, ...]:
    """Return a finding where places were taken for less sure than told."""
    if stretch <= 1.0:
        return ()
    return (
        Finding(
            "places-less-sure",
            "warning",
            f"Arrival times contradict the stated spread of the positions: taken all together they "
            f"are off {stretch:.1f} times as far, and were fitted with {stretch:.1f} times that "
            "spread. Measure them again; the drawing of the room may be wrong, too.",
            {"stretch": stretch},
        ),
    )


def _n_places(scene: Scene) -> int:
    return 3 * (len(scene.sources) + len(scene.receivers))
