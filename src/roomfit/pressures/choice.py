"""Pressures of image sources, fitted where they explain the responses better than energies do."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any

import numpy as np

from roomfit.base.typing import BoolArray, FloatArray, Progress, part
from roomfit.fit.fits import BandFits
from roomfit.fit.measurements import Measurements, time_scales
from roomfit.fit.paths import TracedPaths, traced_paths, trim_memory
from roomfit.fit.trace_plan import has_every_order, images_until_s, traced_s
from roomfit.materials.priors import MaterialPrior
from roomfit.pressures.answers import coherent_answers
from roomfit.pressures.fit import contradicted_position_sd_scale, fit_coherent
from roomfit.pressures.initial import initialise, with_sources_examined
from roomfit.pressures.sequential import TELLING_HZ, UNDECIDED, forward_pass, log_evidences
from roomfit.pressures.state import retracing, unfitted
from roomfit.room.scene import select_pairs
from roomfit.settings import LEAST_SQUARES_METHODS, Settings
from roomfit.uncertainty.gaussian import Refine

_LOG = logging.getLogger("roomfit")


def fit_by_pressures(
    measured: Measurements,
    priors: tuple[MaterialPrior, ...],
    start: FloatArray,
    settings: Settings,
    refine: Refine,
    progress: Progress | None,
) -> tuple[TracedPaths, BandFits] | None:
    """Return the room traced and fitted by pressures, or None where energies are to be fitted.

    Each band has the model of larger evidence, unless the settings ask for pressures.

    `start` (n_bands,) is a uniform absorption to start from.
    """
    responses = any(m.measurement.use == "fit" for m in measured.responses)
    if settings.model == "energy" or not responses or settings.method not in LEAST_SQUARES_METHODS:
        return None
    asked = settings.model == "coherent"
    far_s = images_until_s(measured.scene, traced_s(*time_scales(measured)), settings)
    if not asked and (far_s == 0.0 or not is_promising(measured, priors, start, settings)):
        return None
    traced = traced_paths(measured, priors, settings, start, part(progress, 0.0, 0.45), far_s)
    _LOG.info("fitting pressures and energies")
    again = retracing(measured, traced)
    state = initialise(unfitted(measured, priors, traced, start, settings, again), traced)
    fit = fit_coherent(state, traced, part(progress, 0.45, 0.86))
    _LOG.info("finding confidence intervals")
    fits = coherent_answers(fit, settings, refine, part(progress, 0.86, 1.0))
    del state, fit  # with all bands, the most that is in memory
    trim_memory()
    return traced, fits


# The trial of pressures: how many responses at most, and how far apart its two bands are; rays a
# source and images a pair at most, the latter .14 s of 70 m3.
_TRIED_RESPONSES, _TRIED_OCTAVES = 8, 2.0
_TRIED_PATHS = {
    "n_rays": 10_000,
    "n_rays_beside_images": 10_000,
    "most_images": 6_000,
    "most_coherent_images": 6_000,
}


def is_promising(
    measured: Measurements,
    priors: tuple[MaterialPrior, ...],
    start: FloatArray,
    settings: Settings,
) -> bool:
    """Return False where a few responses contradict pressures, before the room is traced for them.

    Positions, speed of sound and delays that a band at 250 Hz determines are known to millimetres.
    Where they are the room's, pressures explain the octave of 1 kHz better than energies; where
    they have absorbed what the model of pressures lacks (loudspeakers, scattering, walls that are
    not specified), energies are likelier there by `log_evidences`, and what was fitted to the lower
    band is no geometry. Nor is there anything to gain where energies are likelier in both bands.
    Where positions contradict what is stated of them, all responses decide. Eight responses at most
    are compared, in the highest band up to 1 kHz and the one nearest to two octaves below.
    """
    centres_hz = measured.bands.centres_hz
    high = int(np.searchsorted(centres_hz, 1.01 * TELLING_HZ)) - 1
    if high < 1:
        return True
    octaves = np.log2(centres_hz[high] / centres_hz[:high])
    low = int(np.argmin(np.abs(octaves - _TRIED_OCTAVES)))
    few = _few(measured, np.isin(np.arange(centres_hz.size), (low, high)))
    most: dict[str, Any] = {
        name: min(n, getattr(settings, name) or n) for name, n in _TRIED_PATHS.items()
    }
    quick = replace(settings, quick=True, **most)
    priors = tuple(replace(k, fit_scattering=False) for k in priors)
    far_s = images_until_s(few.scene, traced_s(*time_scales(few)), quick)
    traced = traced_paths(few, priors, quick, start, None, far_s)
    if not has_every_order(traced.settings):
        return True
    state = initialise(unfitted(few, priors, traced, start, quick), traced)
    state = with_sources_examined(state, traced)
    fits = forward_pass(state.each, quick, None)
    gains = []
    for own, fit in ((state.each[b], fits[b]) for b in (low, high)):
        if own is None:
            return True
        if fit is None:
            return False
        energies, pressures = log_evidences(own, fit)
        gains.append(pressures - energies)
    if max(gains) > 0.0 and gains[1] <= -UNDECIDED:
        # positions that are known less well than stated explain it: a fit inflates that
        return contradicted_position_sd_scale(state, fits) > 1.0
    return max(gains) > 0.0


def _few(measured: Measurements, chosen: BoolArray) -> Measurements:
    """Return a few responses, as if nothing decayed in other bands than those chosen."""
    fitted = [m for m in measured.responses if m.measurement.use == "fit"]
    kept = fitted[:: -(-len(fitted) // _TRIED_RESPONSES)]
    pairs = np.unique([m.pair for m in kept])
    responses = []
    for m in kept:
        falling_s = np.where(chosen, m.noise.tail_time_constant_s, 0.0)
        noise = replace(m.noise, tail_time_constant_s=falling_s)
        responses.append(replace(m, pair=int(np.searchsorted(pairs, m.pair)), noise=noise))
    scene = select_pairs(measured.scene, pairs)
    return replace(measured, scene=scene, responses=tuple(responses), values=())
