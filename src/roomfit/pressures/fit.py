"""Every band fitted with partly coherent image sources, the geometry along with it.

Bands are fitted by pressures from low to high: a low band is coherent in spite of centimetres of
position error and determines positions well enough for the next one to be coherent, too. Last,
every band is fitted once more under what all the others determine of the geometry. What is fixed is
fitted as well, for comparison only.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from roomfit.base.typing import FloatArray, Progress, part
from roomfit.fit.directivity import SourceGain, contradicted_sources
from roomfit.fit.fits import CoherentTests, FittedGeometry, Freed
from roomfit.fit.outliers import LEAST_BY_PRESSURES, file_misfits, outlier_files
from roomfit.fit.paths import TracedPaths, trim_memory
from roomfit.model.observation import fitted_in_band
from roomfit.pressures.bands import rebuild, with_outliers
from roomfit.pressures.geometry import (
    LEVEL,
    fitted_geometry,
    inflate_position_sds,
    n_position_coordinates,
)
from roomfit.pressures.initial import source_scores, with_sources_examined
from roomfit.pressures.sequential import (
    UNDECIDED,
    CoherentBand,
    CoherentBandFit,
    agree,
    contradicts_geometry,
    forward_pass,
    increases_likelihood,
    leave_one_out_pass,
    log_evidences,
)
from roomfit.pressures.state import State, release, vectors
from roomfit.room.scene import Scene
from roomfit.settings import Settings
from roomfit.signals.measurement import MeasuredPair, Measurement
from roomfit.uncertainty.gaussian import absorption_intervals, fit_covariance

# Between INFO, which names a stage, and WARNING: lines that progress leaves standing.
_LOG, _NOTICE = logging.getLogger("roomfit"), 25
_LARGEST_SCALE, _FEWEST_COORDINATES = 5.0, 6


@dataclass(frozen=True, slots=True, eq=False)
class CoherentFit:
    """Every band fitted with partly coherent image sources, and what was found on the way."""

    state: State
    fits: tuple[CoherentBandFit | None, ...]  # None where too few windows rise above the noise
    # of the energy model and of the partly coherent one; NaN where not tried; (n_bands, 2)
    log_evidences: FloatArray
    geometry: FittedGeometry | None  # None where no band was coherent
    tests: CoherentTests
    # by band, what contradicts that sources are omnidirectional
    contradicted: tuple[SourceGain, ...] = ()  # of the sources taken for omnidirectional


def fit_coherent(
    state: State, traced: TracedPaths, progress: Progress | None = None
) -> CoherentFit:
    """Fit every band with image sources as coherent as their times are known.

    Which images a receiver sees depends on where it stands, except in a box: elsewhere the bands
    up to 1 kHz are fitted first, images are found anew at the positions they tell, and everything
    is fitted again from the specified prior.
    """
    state = state if state.settings.quick else with_sources_examined(state, traced)
    tested, settings = state.tested_sources, state.settings
    fits = forward_pass(state.each, settings, part(progress, 0.0, 0.8), state.first)
    if settings.quick:
        fits, _ = leave_one_out_pass(state.each, _uncontradicted(state, fits), settings)
        evidences, tests = _log_evidences(state, fits), CoherentTests(_outliers(state))
        return CoherentFit(state, tuple(fits), evidences, None, tests)
    _log_first_answer(state, fits)
    outliers = _outliers_by_pressures(state, fits)
    if outliers:
        first, fits = vectors(fits), []
        state = replace(state, outliers_by_pressures=outliers)
        # what is known of a directivity by other bands depends on the outliers
        is_directed = state.directivity_parameters is not None
        state = release(state) if is_directed else state
        state = rebuild(state) if is_directed else with_outliers(state)
        fits = forward_pass(state.each, settings, part(progress, 0.8, 1.0), first)
    position_sd_scale = contradicted_position_sd_scale(state, fits)
    if position_sd_scale > 1.0:
        place, origin = inflate_position_sds(state.scene, state.origin, position_sd_scale)
        first, fits = vectors(fits), []
        state = release(replace(state, scene=place, origin=origin))
        state = rebuild(state)
        fits = forward_pass(state.each, settings, part(progress, 0.8, 1.0), first)
    fits = _uncontradicted(state, fits)
    # what is gained if what is fixed is fitted
    delays = positions = None
    if not settings.reflection_delays:
        delays = _freed(state, fits, replace(settings, reflection_delays=True))
    if settings.positions == "fixed":
        positions = _freed(state, fits, replace(settings, positions="auto"))
    fits, final = leave_one_out_pass(state.each, fits, settings)
    is_settled = final is None or agree(fits, final)
    while final is not None and not is_settled:
        trim_memory()
        other = forward_pass(state.each, settings, None, vectors(fits), final)
        other, found = leave_one_out_pass(state.each, other, settings)
        is_settled = increases_likelihood(fits, other) < UNDECIDED
        if not is_settled:
            fits, final = other, found
        del other
    trim_memory()
    geometry = state.geometry
    estimate = None if geometry is None or final is None else fitted_geometry(geometry, final)
    late = contradicted_sources(tested, source_scores(state))
    evidences, contradicted = _log_evidences(state, fits), (*state.contradicted, *late)
    tests = CoherentTests(_outliers(state), position_sd_scale, delays, positions)
    return CoherentFit(state, tuple(fits), evidences, estimate, tests, contradicted)


def _freed(state: State, fits: Sequence[CoherentBandFit | None], settings: Settings) -> Freed:
    """Return by how much the data are likelier, over all bands, and by how many more unknowns."""
    freer = rebuild(replace(state, settings=settings))
    freed = forward_pass(freer.each, settings, None, vectors(fits))
    gain = increases_likelihood(fits, freed)
    before, after = (
        0 if g is None else int(np.count_nonzero(g.moves()))
        for g in (state.geometry, freer.geometry)
    )
    n_windows = sum(f.fit.expected.size for f in fits if f is not None)
    return Freed(gain, after - before, n_windows)


def contradicted_position_sd_scale(state: State, fits: Sequence[CoherentBandFit | None]) -> float:
    """Return by how much position standard deviations are too small, of bands that contradict them.

    A band that its positions keep from being explained by pressures has moved none of them: what
    all bands together say of positions is then asked of a pass by pressures.
    """
    settings = state.settings
    if settings.model == "auto" and contradicts_geometry(state.each, fits):
        by_pressures = replace(settings, model="coherent")
        fits = forward_pass(state.each, by_pressures, None, vectors(fits))
    return estimate_position_sd_scale(state.scene, state.each, fits)


def estimate_position_sd_scale(
    scene: Scene,
    prepared: Sequence[CoherentBand | None],
    fits: Sequence[CoherentBandFit | None],
) -> float:
    """Return by how much position standard deviations are too small; 1 where they may be right.

    The mean square of the shifts of all coordinates, in prior standard deviations and with the
    posterior variance of each, against chi-square with as many degrees of freedom, n. At most 5.
    """
    band = next((b for b in prepared if b is not None), None)
    found = [f.found for f in fits if f is not None and f.found is not None]
    if band is None or not found:
        return 1.0
    geometry, last = band.coherent.geometry, found[-1]
    moving = np.flatnonzero(geometry.moves())
    is_position = moving < n_position_coordinates(scene)
    n = int(np.count_nonzero(is_position))
    if n < _FEWEST_COORDINATES:
        return 1.0
    variance = np.diag(np.linalg.inv(last.information))
    mean = float(np.mean((last.mean**2 + variance)[is_position]))
    return 1.0 if mean <= chdtri(n, 1.0 - LEVEL) / n else min(float(np.sqrt(mean)), _LARGEST_SCALE)


def _uncontradicted(
    state: State, fits: list[CoherentBandFit | None]
) -> list[CoherentBandFit | None]:
    """Return the fits, none where the model is chosen and bands contradict pressures."""
    is_open = state.settings.model == "auto"
    return [None] * len(fits) if is_open and contradicts_geometry(state.each, fits) else fits


def _outliers_by_pressures(
    state: State, fits: Sequence[CoherentBandFit | None]
) -> dict[MeasuredPair, float]:
    misfits = [
        file_misfits(
            fitted_in_band(state.files, b), own.coherent.energies, fit.fit, own.energies.inflation
        )
        for b, (own, fit) in enumerate(zip(state.each, fits, strict=True))
        if own is not None and fit is not None
    ]
    return outlier_files(misfits, LEAST_BY_PRESSURES)


def _outliers(state: State) -> dict[Measurement, float]:
    """Return the recordings whose variances are inflated, by energies or by pressures."""
    return {m.measurement: x for m, x in {**state.outliers, **state.outliers_by_pressures}.items()}


def _log_first_answer(state: State, fits: Sequence[CoherentBandFit | None]) -> None:
    """Log what the first pass has found, long before the answer is examined and complete.

    Intervals are Gaussian, without the errors that windows share.
    """
    if not _LOG.isEnabledFor(_NOTICE):
        return
    evidences, columns = _log_evidences(state, fits), []
    for b, (own, fit) in enumerate(zip(state.each, fits, strict=True)):
        if own is None:
            continue
        parameters, found = own.energies.parameters, own.energy_fit
        if fit is not None and not evidences[b, 1] < evidences[b, 0]:
            parameters, found = fit.parameters, fit.fit
        how = fit_covariance(found), found.chi2_reduced
        at = absorption_intervals(parameters, found.vector, *how)
        numbers = 100.0 * np.stack([at.absorption, at.lower95, at.upper95], axis=1)
        entries = [f"{a:.0f} ({low:.0f}-{high:.0f})" for a, low, high in numbers]
        columns.append([f"{state.bands.centres_hz[b]:g} Hz", *entries])
    names = [p.name for p in state.priors]
    _LOG.log(_NOTICE, "so far, absorption in % and its 95 % interval; not yet examined:")
    for name, *entries in zip(["", *names], *columns, strict=True):
        _LOG.log(_NOTICE, "%-16.16s%s", name, "".join(f"{e:>12s}" for e in entries))


def _log_evidences(state: State, fits: Sequence[CoherentBandFit | None]) -> FloatArray:
    found: FloatArray = np.full((len(fits), 2), np.nan)
    for b, (own, fit) in enumerate(zip(state.each, fits, strict=True)):
        if own is not None and fit is not None:
            found[b] = log_evidences(own, fit)
    return found
