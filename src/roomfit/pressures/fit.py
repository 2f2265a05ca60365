"""Every band fitted with partly coherent image sources, the geometry along with it.

Energies are fitted first; they suffice to find outliers and to equalise the magnitude responses of
the sources in all but the lowest bands. Then bands are fitted by pressures from low to high: a low
band is coherent in spite of centimetres of position error and determines positions well enough for
the next one to be coherent, too. Where they move, image sources are found anew. Last, every band is
fitted once more under what all the others determine of the geometry. What is fixed is fitted as
well, for comparison only.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias, cast

import numpy as np
from scipy.special import chdtri

from roomfit.base.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import Bands
from roomfit.base.forks import in_forks
from roomfit.base.typing import FloatArray, Progress, part
from roomfit.fit.directivity import (
    DirectivityScore,
    SourceGain,
    contradicted_sources,
    directivities_under_cavity_priors,
    directivity_score,
    moved_start,
    with_fitted_sources,
)
from roomfit.fit.fits import CoherentTests, FittedGeometry, Freed
from roomfit.fit.outliers import (
    LEAST_BY_ENERGIES,
    LEAST_BY_PRESSURES,
    file_misfits,
    outlier_files,
    variance_inflation,
)
from roomfit.fit.paths import TracedPaths, trim_memory
from roomfit.fit.systematics import (
    SLOT_S,
    effect_on_answer,
    middles_s,
    relative_errors,
    shared_errors,
)
from roomfit.materials.priors import MaterialPrior
from roomfit.model.binned import BinnedPaths
from roomfit.model.directivity import (
    BandDirectivities,
    DirectivityParameters,
    directed,
    directed_band,
    energy_objective,
    row_bases,
    with_directivities,
)
from roomfit.model.energy import EnergyTerm
from roomfit.model.observation import energy_term, energy_terms, fitted_in_band
from roomfit.model.parameters import physical_values
from roomfit.model.problem import DataTerm, Objective, Prediction
from roomfit.model.windows import WINDOW_DECAYS, windows_decay_s
from roomfit.pressures.data_term import CoherentTerm, coherent_term, cut_at, fully_coherent
from roomfit.pressures.equalise import SCHROEDER_FACTOR, equalise_sources
from roomfit.pressures.geometry import (
    LEVEL,
    Geometry,
    campaign_geometry,
    fitted_geometry,
    inflate_position_sds,
    moved_scene,
    n_position_coordinates,
)
from roomfit.pressures.response import ImagePaths, image_paths, images_of
from roomfit.pressures.sequential import (
    BEFORE_THE_LAST_PASS_SD,
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
from roomfit.room.scene import Scene, material_areas_m2
from roomfit.settings import Settings
from roomfit.signals.measurement import MeasuredPair, Measurement
from roomfit.solver import BandFit, fit_band, score_band
from roomfit.tracing.paths import Paths
from roomfit.uncertainty.gaussian import (
    FittedBand,
    absorption_intervals,
    band_estimate,
    fit_covariance,
)

# Shortest window in units of 1 / B: finer ones than energies need tell of phases.
_WINDOW_PERIODS = 0.75
# Between INFO, which names a stage, and WARNING: lines that progress leaves standing.
_LOG, _NOTICE = logging.getLogger("roomfit"), 25
# Of the lowest band: so much after the last pressure an image may still ring into its window.
_REACH_PERIODS = 5.0


# Bands up to here determine positions within a few millimetres, in spite of hidden images.
_RETRACE_BELOW_HZ = 1000.0
# Bands up to here are those in which a first guess of the walls does not determine the magnitude
# response of a loudspeaker.
_RETRACE_ENERGIES_BELOW_HZ = 250.0


Retrace: TypeAlias = Callable[[Scene], tuple[Paths, FloatArray | None, BinnedPaths]]
"""Traces a scene whose positions have moved: paths, their factors in each band, the same binned."""


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """What is to be fitted, its paths, and its bands made ready."""

    scene: Scene
    bands: Bands
    priors: tuple[MaterialPrior, ...]
    # measurements, as sources of a flat magnitude response would have given them
    files: tuple[MeasuredPair, ...]
    start: FloatArray  # (n_bands,)
    settings: Settings
    speed_sd: float  # prior relative standard deviation of the speed of sound
    late_end_s: float  # where the last window ends at the latest
    others: tuple[tuple[DataTerm, ...], ...]  # by band, data beside the responses
    directivity_parameters: DirectivityParameters | None  # of sources whose directivity is fitted
    tested_sources: DirectivityParameters | None  # those that are taken for omnidirectional
    fits_contradicted: bool  # whether directivities of these are fitted where data contradict it
    # (n_materials, n_bands) and (n_materials,): coefficients, and the standard deviation they share
    scattering: tuple[FloatArray, FloatArray]
    retrace: Retrace | None  # None where positions are not fitted, or images all stay
    paths: Paths
    weights: FloatArray | None  # (n_bands, n_paths)
    binned: BinnedPaths
    # free numbers of the geometry for which the paths were traced; None for those specified
    origin: FloatArray | None = None
    each: tuple[CoherentBand | None, ...] = ()  # the bands
    starts: tuple[FloatArray | None, ...] = ()  # answers by energies of bands that were let go of
    first: tuple[FloatArray | None, ...] = ()  # answers by pressures of an earlier pass
    images: ImagePaths | None = None  # of these paths, what all bands share; None: not made yet
    # how many times worse than others energies, and pressures, explain a file
    outliers: Mapping[MeasuredPair, float] = field(default_factory=dict)
    outliers_by_pressures: Mapping[MeasuredPair, float] = field(default_factory=dict)
    contradicted: tuple[SourceGain, ...] = ()  # of tested sources that the data contradict

    @property
    def geometry(self) -> Geometry | None:
        """The unknowns of arrival times, the same in all bands; None without data."""
        return next((b.coherent.geometry for b in self.each if b is not None), None)

    @property
    def fitted(self) -> tuple[MeasuredPair, ...]:
        """The files that are fitted in some band."""
        return tuple(m for m in self.files if m.measurement.use == "fit")


def initialise(state: State, traced: TracedPaths) -> State:
    """Return the bands ready to be fitted, paths found anew where positions must have moved."""
    settings, files, retrace = state.settings, state.files, state.retrace
    state = replace(
        state,
        paths=traced.paths,
        weights=traced.factors,
        binned=cut_at(traced.binned, state.late_end_s),
        origin=None,
        each=(),
        starts=(),
        images=None,
    )
    state = rebuild(state)
    coloured = False
    if state.directivity_parameters is None:
        even = _even(state, files, current_absorption(state), SCHROEDER_FACTOR)
        coloured = any(new is not old for new, old in zip(even, files, strict=True))
        if coloured:
            state = release(replace(state, files=even))
            state = rebuild(state)
    moves = retrace is not None and settings.positions != "fixed"
    if not (moves or coloured) or settings.quick:
        return state
    highest_hz = _RETRACE_BELOW_HZ if moves else _RETRACE_ENERGIES_BELOW_HZ
    low = [
        band if f <= highest_hz else None
        for band, f in zip(state.each, state.bands.centres_hz, strict=True)
    ]
    fits = forward_pass(low, settings, None)
    guess = current_absorption(state, fits)
    known = [f.found for f in fits if f is not None and f.found is not None]
    if retrace is not None and moves and known and state.geometry is not None:
        place, origin = moved_scene(state.scene, state.geometry, known[-1].mean)
        paths, weights, binned = retrace(place)
        binned = cut_at(binned, state.late_end_s)
        moved = {"paths": paths, "weights": weights, "binned": binned, "origin": origin}
        state = replace(state, images=None, **cast(Any, moved))
    state = replace(release(state), first=_vectors(fits))
    del low, fits
    if coloured:
        state = replace(state, files=_even(state, files, guess, 0.0))
    return rebuild(state)


def release(state: State) -> State:
    """Return a state without its bands, whose answers are kept: if no other name holds them."""
    return replace(state, each=(), starts=_answers(state))


def _vectors(fits: Sequence[CoherentBandFit | None]) -> tuple[FloatArray | None, ...]:
    return tuple(None if f is None else f.fit.vector for f in fits)


def _answers(state: State) -> tuple[FloatArray | None, ...]:
    found = tuple(None if b is None else b.energy_fit.vector for b in state.each)
    return found or state.starts


def rebuild(state: State) -> State:
    """Return the same files and paths with bands made anew, as `with_outliers` leaves them.

    The energies of every band are fitted by themselves, in the windows that pressures need. Fits of
    bands made before are where these begin.
    """
    trim_memory()
    limit, unknown = state.settings.max_rounds, state.directivity_parameters
    # what the free numbers of a directivity mean changes with its prior
    starts = (_answers(state) if unknown is None else ()) or (None,) * len(state.bands)
    # every band has the same unknowns, in whichever files it hears
    geometry = campaign_geometry(
        state.scene,
        state.priors,
        state.fitted,
        positions=state.settings.positions != "fixed",
        delays=state.settings.reflection_delays,
        speed_sd=state.speed_sd,
        origin=state.origin,
    )
    made = energy_terms(
        state.scene,
        state.bands,
        state.priors,
        state.files,
        state.binned,
        state.start,
        periods=_WINDOW_PERIODS,
    )
    images = state.images
    if images is None:
        pairs = np.array([m.pair for m in state.fitted])
        reach_s = state.settings.coherent_until_s
        reach_s += _REACH_PERIODS / float(state.bands.centres_hz[0])
        images = image_paths(state.paths, pairs, 0.0, speed_of_sound_m_s(state.scene.air) * reach_s)
    bases = None if unknown is None else row_bases(unknown, state.scene, state.paths, state.binned)
    ready: list[tuple[int, Objective, CoherentTerm, BandDirectivities | None]] = []
    for b, found in enumerate(made):
        if found is None:
            continue
        windows, parameters = found
        directivity, coherent = None, _as_pressures(state, b, windows, geometry, images)
        if unknown is not None and bases is not None:
            files = fitted_in_band(state.files, b)
            directivity = directed_band(unknown, state.scene, bases, windows, files)
            coherent = coherent.aimed(directivity.aims)
        energies = energy_objective(windows, parameters, directivity, state.others[b])
        ready.append((b, energies, coherent, directivity))

    def fitted(own: tuple[int, Objective, CoherentTerm, BandDirectivities | None]) -> BandFit:
        before, energies = starts[own[0]], own[1]
        if before is None:
            return fit_band(energies, max_rounds=limit, settled_sd=BEFORE_THE_LAST_PASS_SD)
        return score_band(energies, before, max_rounds=limit, settled_sd=BEFORE_THE_LAST_PASS_SD)

    each: list[CoherentBand | None] = [None] * len(state.bands)
    for (b, energies, coherent, directivity), fit in zip(
        ready, in_forks(fitted, ready), strict=True
    ):
        each[b] = CoherentBand(energies, fit, coherent, directivity)
    misfits = [
        file_misfits(fitted_in_band(state.files, b), own.coherent.energies, own.energy_fit, None)
        for b, own in enumerate(each)
        if own is not None
    ]
    outliers = outlier_files(misfits, LEAST_BY_ENERGIES)
    return with_outliers(replace(state, each=tuple(each), images=images, outliers=outliers))


def with_outliers(state: State) -> State:
    """Return the same bands with larger variances for files that others contradict.

    By energies, or by pressures where these were fitted, which know more.
    """
    bands = list(state.each)
    outliers = {**state.outliers, **state.outliers_by_pressures}
    for b, own in enumerate(bands):
        if own is not None and outliers:
            files, n_data = fitted_in_band(state.files, b), own.energy_fit.measured.size
            factor = variance_inflation(own.coherent.energies, files, outliers, n_data)
            energies = replace(own.energies, inflation=factor)
            fit = score_band(
                energies,
                own.energy_fit.vector,
                max_rounds=state.settings.max_rounds,
                settled_sd=BEFORE_THE_LAST_PASS_SD,
            )
            bands[b] = replace(own, energies=energies, energy_fit=fit)
    if state.directivity_parameters is not None:
        bands = _under_cavity_priors(state, bands)
    return replace(state, each=tuple(bands))


def _as_pressures(
    state: State, band: int, windows: EnergyTerm, geometry: Geometry, images: ImagePaths
) -> CoherentTerm:
    """Return the windows of a band as pressures."""
    files = fitted_in_band(state.files, band)
    own = np.flatnonzero([m in files for m in state.fitted])
    return coherent_term(
        state.bands,
        band,
        windows,
        float(attenuation_per_m(state.scene.air, state.bands)[band]),
        images_of(images, own, None if state.weights is None else state.weights[band]),
        state.binned,
        replace(geometry, columns=geometry.columns[own]),
        state.settings.coherent_until_s,
    )


def _under_cavity_priors(
    state: State, bands: Sequence[CoherentBand | None]
) -> list[CoherentBand | None]:
    """Fit the energies again under what other bands say of the directivity."""
    directivities = directivities_under_cavity_priors(
        cast(DirectivityParameters, state.directivity_parameters),
        state.bands,
        [None if own is None else own.directivity for own in bands],
        [None if own is None else own.energy_fit for own in bands],
    )
    out: list[CoherentBand | None] = []
    for own, directivity in zip(bands, directivities, strict=True):
        if own is None or own.directivity is None or directivity is None:
            out.append(own)
            continue
        start = moved_start(own.energy_fit, own.directivity.unknown, directivity.unknown)
        energies = replace(
            own.energies,
            parameters=with_directivities(own.energies.parameters, directivity.unknown),
            terms=(directed(own.coherent.energies, directivity), *own.energies.terms[1:]),
        )
        fit = score_band(energies, start, max_rounds=state.settings.max_rounds)
        out.append(CoherentBand(energies, fit, own.coherent, directivity))
    return out


def current_absorption(state: State, fits: Sequence[CoherentBandFit | None] = ()) -> FloatArray:
    """Return absorption by pressures where fitted, else by energies, else the start.

    Shape (n_materials, n_bands).
    """
    out = np.tile(state.start, (len(state.priors), 1))
    for i, band in enumerate(state.each):
        if band is not None:
            parameters, vector = band.energies.parameters, band.energy_fit.vector
            out[:, i] = physical_values(parameters, vector)[0]["absorption"]
    for i, fit in enumerate(fits):
        if fit is not None:
            out[:, i] = physical_values(fit.parameters, fit.fit.vector)[0]["absorption"]
    return out


def _even(
    state: State, files: tuple[MeasuredPair, ...], absorption: FloatArray, factor: float
) -> tuple[MeasuredPair, ...]:
    trim_memory()
    return equalise_sources(
        state.scene, state.bands, files, state.paths, absorption, schroeder_factor=factor
    )


def _freed(state: State, fits: Sequence[CoherentBandFit | None], settings: Settings) -> Freed:
    """Return by how much the data are likelier, over all bands, and by how many more unknowns."""
    freer = rebuild(replace(state, settings=settings))
    freed = forward_pass(freer.each, settings, None, _vectors(fits))
    gain = increases_likelihood(fits, freed)
    before, after = (
        0 if g is None else int(np.count_nonzero(g.moves()))
        for g in (state.geometry, freer.geometry)
    )
    n_windows = sum(f.fit.expected.size for f in fits if f is not None)
    return Freed(gain, after - before, n_windows)


# errors that windows share, by name and one sd a column, and the prediction at the fit
SharedErrors: TypeAlias = tuple[Mapping[str, FloatArray], Prediction]


@dataclass(frozen=True, slots=True, eq=False)
class CoherentFit:
    """Every band fitted with partly coherent image sources, and what was found on the way."""

    state: State
    fits: tuple[CoherentBandFit | None, ...]  # None where too few windows rise above the noise
    # of the energy model and of the partly coherent one; NaN where not tried; (n_bands, 2)
    log_evidences: FloatArray
    geometry: FittedGeometry | None  # None where no band was coherent
    shared: tuple[SharedErrors | None, ...]  # of the fits
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
        evidences, shared = _log_evidences(state, fits), _shared_errors(state, fits)
        return CoherentFit(
            state, tuple(fits), evidences, None, shared, CoherentTests(_outliers(state))
        )
    _log_first_answer(state, fits)
    misfits = [
        file_misfits(
            fitted_in_band(state.files, b), own.coherent.energies, fit.fit, own.energies.inflation
        )
        for b, (own, fit) in enumerate(zip(state.each, fits, strict=True))
        if own is not None and fit is not None
    ]
    outliers = outlier_files(misfits, LEAST_BY_PRESSURES)
    if outliers:
        first, fits = _vectors(fits), []
        state = replace(state, outliers_by_pressures=outliers)
        # what is known of a directivity by other bands depends on the outliers
        is_directed = state.directivity_parameters is not None
        state = release(state) if is_directed else state
        state = rebuild(state) if is_directed else with_outliers(state)
        fits = forward_pass(state.each, settings, part(progress, 0.8, 1.0), first)
    position_sd_scale = contradicted_position_sd_scale(state, fits)
    if position_sd_scale > 1.0:
        place, origin = inflate_position_sds(state.scene, state.origin, position_sd_scale)
        first, fits = _vectors(fits), []
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
        other = forward_pass(state.each, settings, None, _vectors(fits), final)
        other, found = leave_one_out_pass(state.each, other, settings)
        is_settled = increases_likelihood(fits, other) < UNDECIDED
        if not is_settled:
            fits, final = other, found
        del other
    trim_memory()
    geometry = state.geometry
    estimate = None if geometry is None or final is None else fitted_geometry(geometry, final)
    late = contradicted_sources(tested, _source_scores(state))
    evidences, shared = _log_evidences(state, fits), _shared_errors(state, fits)
    tests = CoherentTests(_outliers(state), position_sd_scale, delays, positions)
    return CoherentFit(
        state, tuple(fits), evidences, estimate, shared, tests, (*state.contradicted, *late)
    )


def contradicted_position_sd_scale(state: State, fits: Sequence[CoherentBandFit | None]) -> float:
    """Return by how much position standard deviations are too small, of bands that contradict them.

    A band that its positions keep from being explained by pressures has moved none of them: what
    all bands together say of positions is then asked of a pass by pressures.
    """
    settings = state.settings
    if settings.model == "auto" and contradicts_geometry(state.each, fits):
        by_pressures = replace(settings, model="coherent")
        fits = forward_pass(state.each, by_pressures, None, _vectors(fits))
    return estimate_position_sd_scale(state.scene, state.each, fits)


def _uncontradicted(
    state: State, fits: list[CoherentBandFit | None]
) -> list[CoherentBandFit | None]:
    """Return the fits, none where the model is chosen and bands contradict pressures."""
    is_open = state.settings.model == "auto"
    return [None] * len(fits) if is_open and contradicts_geometry(state.each, fits) else fits


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


def _shared_errors(
    state: State, fits: Sequence[CoherentBandFit | None]
) -> tuple[SharedErrors | None, ...]:
    """Return the errors that windows share in each fit; what is fitted is large."""

    def errors(b: int) -> SharedErrors | None:
        own, fit = state.each[b], fits[b]
        if own is None or fit is None:
            return None
        objective = fit.objective(own)
        relative = _relative_errors(state, objective, fit.fit, own.coherent.energies)
        shared = shared_errors(objective, fit.fit, _sources(state, b), relative)
        noise = np.concatenate([o.noise for o in own.coherent.energies.observations])
        signal = fit.fit.expected[: noise.size] - noise
        shared["lost coherence"] = (signal * lost_coherence(own, fit.fit))[:, None]
        return shared, objective.predict(fit.fit.vector)

    return tuple(in_forks(errors, range(len(fits))))


def _source_scores(state: State) -> dict[int, DirectivityScore]:
    """Return by band what contradicts that sources taken for omnidirectional are."""
    tested = state.tested_sources
    if tested is None:
        return {}
    bases = row_bases(tested, state.scene, state.paths, state.binned)

    def score(band: tuple[int, CoherentBand]) -> DirectivityScore:
        b, own = band
        files = fitted_in_band(state.files, b)
        directivity = directed_band(tested, state.scene, bases, own.coherent.energies, files)
        return directivity_score(own.energies, own.energy_fit, directivity)

    there = [(b, own) for b, own in enumerate(state.each) if own is not None]
    return dict(zip((b for b, _ in there), in_forks(score, there), strict=True))


def with_sources_examined(state: State, traced: TracedPaths) -> State:
    """Return the bands anew with unknown directivities where energies contradict that of a source.

    Of all sources taken for omnidirectional: a measurement rarely has two kinds. It comes before
    all else is fitted: where a loudspeaker is taken for omnidirectional, positions, scattering and
    the laws of the measurement chain are bent to explain what it does to the levels of reflections.
    """
    if not state.fits_contradicted or state.tested_sources is None:
        return state
    found = contradicted_sources(state.tested_sources, _source_scores(state))
    if not found:
        return state
    fitted = with_fitted_sources(state.directivity_parameters, state.tested_sources)
    again = replace(
        state, directivity_parameters=fitted, tested_sources=None, contradicted=found, first=()
    )
    return initialise(again, traced)


def coherent_estimate(fit: CoherentFit, b: int) -> FittedBand | None:
    """Return a band's coherent estimate, common-mode errors included in the covariance.

    Without fit and problem where energies explain the band better: its intervals are of no use.
    """
    state = fit.state
    areas_m2 = material_areas_m2(state.scene.room)
    band, found, errors = state.each[b], fit.fits[b], fit.shared[b]
    if band is None or found is None or errors is None:
        return None
    objective = found.objective(band)
    effect = effect_on_answer(objective, found.fit, errors[0], areas_m2, errors[1])
    own = band_estimate(objective.parameters, found.fit, "coherent", effect)
    own = replace(own, window_decays_s=_window_decays_s(band.coherent.energies, found.fit))
    lost = float(fit.log_evidences[b, 0] - fit.log_evidences[b, 1])
    beaten = state.settings.model != "coherent" and lost >= UNDECIDED
    return FittedBand(own) if beaten else FittedBand(own, objective, found.fit, effect.steps)


def _window_decays_s(windows: EnergyTerm, fit: BandFit) -> dict[str, FloatArray]:
    """Return decays of each file from its windows, measured and as fitted, shape (2, n_files)."""
    ends = np.cumsum([o.energy.size for o in windows.observations])[:-1]
    fitted = np.split(fit.expected[: windows.measured().size], ends)
    return {
        name: np.array(
            [
                [windows_decay_s(o.edges_s, e - o.noise, name) for e in (o.energy, expected)]
                for o, expected in zip(windows.observations, fitted, strict=True)
            ]
        ).T
        for name in WINDOW_DECAYS
    }


def _relative_errors(
    state: State, objective: Objective, fit: BandFit, windows: EnergyTerm
) -> FloatArray:
    absorption = physical_values(objective.parameters, fit.vector)[0]["absorption"]
    return relative_errors(
        state.scene.air, state.bands, windows, state.paths, absorption, state.scattering
    )


def _sources(state: State, band: int) -> tuple[int, ...]:
    """Return the source of each of a band's observations."""
    return tuple(int(state.scene.pairs[m.pair][0]) for m in fitted_in_band(state.files, band))


def energy_estimates(fit: CoherentFit) -> Callable[[int], FittedBand | None]:
    """Return what says of a band by energies alone, in the windows whose noise is known to suit.

    None where the partly coherent model decides, or where there are no data.
    """
    state = fit.state
    areas_m2 = material_areas_m2(state.scene.room)
    may_decide = state.settings.model != "coherent"
    wanted = [
        f is None or (may_decide and bool(x[1] - x[0] < UNDECIDED))
        for f, x in zip(fit.fits, fit.log_evidences, strict=True)
    ]
    unknown, bases = state.directivity_parameters, None
    if unknown is not None and any(wanted):
        bases = row_bases(unknown, state.scene, state.paths, state.binned)

    def estimate(number: int) -> FittedBand | None:
        if not wanted[number]:
            return None
        made = energy_term(
            state.scene, state.bands, state.priors, state.files, state.binned, state.start, number
        )
        if made is None:
            return None
        (windows, parameters), band = made, state.each[number]
        files = fitted_in_band(state.files, number)
        directivity = None if band is None else band.directivity
        if directivity is not None and unknown is not None and bases is not None:
            # other windows may hear other rows
            rows = directed_band(unknown, state.scene, bases, windows, files)
            directivity = replace(rows, unknown=directivity.unknown)
        objective = energy_objective(windows, parameters, directivity, state.others[number])
        if band is not None and band.energies.inflation is not None:
            # as for the finer windows: one factor an observation
            fine = [o.energy.size for o in band.coherent.energies.observations]
            factors = band.energies.inflation[np.cumsum([0, *fine[:-1]])]
            outliers = dict(zip(files, factors.tolist(), strict=True))
            n_data = objective.measured().size
            factor = variance_inflation(windows, files, outliers, n_data)
            objective = replace(objective, inflation=factor)
        own_fit = fit_band(objective, max_rounds=state.settings.max_rounds)
        relative = _relative_errors(state, objective, own_fit, windows)
        shared = shared_errors(objective, own_fit, _sources(state, number), relative)
        effect = effect_on_answer(objective, own_fit, shared, areas_m2)
        answer = band_estimate(objective.parameters, own_fit, "energy", effect)
        return FittedBand(answer, objective, own_fit, effect.steps)

    return estimate


def lost_coherence(band: CoherentBand, fit: BandFit) -> FloatArray:
    """Return the relative change of the expected energy if all images were coherent.

    Images that are not known to be coherent are taken to add as energies. Between smooth, parallel
    walls they do not: images on a lattice keep their order, and in boxes the late energy of an
    octave is 10 to 25 % below the sum of their energies. Small errors of time at every reflection
    change the phase of single paths, but hardly this mean over all responses, so that images at
    their assumed positions give it. It is taken over slots of 40 ms; after the last window in which
    pressures add, the value of the last slot is kept.

    Shape (n_windows,).
    """
    energies = band.coherent.energies
    noise = np.concatenate([o.noise for o in energies.observations])
    windows = directed(fully_coherent(band.coherent), band.directivity)
    whole = Objective(band.parameters, (windows,))
    expected = fit.expected[: noise.size]
    more, signal = whole.expected(fit.vector) - expected, expected - noise
    weight = signal / fit.variance[: noise.size]
    early = np.isin(np.arange(noise.size), band.coherent.early_windows())
    slot = np.floor(middles_s(energies) / SLOT_S).astype(np.int64)
    weight = np.where(early, weight, 0.0)
    top = np.bincount(slot, weight * more, slot.max() + 1)
    bottom = np.bincount(slot, weight * signal, slot.max() + 1)
    change = np.divide(top, bottom, out=np.zeros(top.size), where=bottom > 0.0)
    informative = np.flatnonzero(bottom > 0.0)
    return np.asarray(change[np.minimum(slot, informative[-1])])


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
