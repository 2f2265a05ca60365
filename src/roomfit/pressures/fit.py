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
from typing import TypeAlias, cast

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
from roomfit.pressures.far_images import Retrace
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
    CoherentOptions,
    agree,
    contradicts_geometry,
    forward_pass,
    increases_likelihood,
    leave_one_out_pass,
    log_evidences,
)
from roomfit.room.scene import Scene, material_areas_m2
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


@dataclass(frozen=True, slots=True, eq=False)
class CoherentTask:
    """Quantities independent of the traced paths.

    `values` has the room parameters of each band that are fitted with its windows.
    `directivity_parameters` are the sources whose directivity is fitted, `tested_sources` those
    that are taken for omnidirectional. `outliers` says how many times worse than others pressures
    explain a file.
    """

    scene: Scene
    bands: Bands
    priors: tuple[MaterialPrior, ...]
    measured: tuple[MeasuredPair, ...]
    start: FloatArray
    settings: CoherentOptions
    others: tuple[tuple[DataTerm, ...], ...]  # by band, data beside the responses
    directivity_parameters: DirectivityParameters | None = None
    tested_sources: DirectivityParameters | None = None
    outliers: Mapping[MeasuredPair, float] = field(default_factory=dict)
    # (n_materials, n_bands) and (n_materials,): coefficients, and the standard deviation they share
    scattering: tuple[FloatArray, FloatArray] | None = None  # None: known
    # of tested sources that the data contradict, whose directivity is fitted where that is possible
    contradicted: tuple[SourceGain, ...] = ()
    fits_contradicted: bool = False
    retrace: Retrace | None = None  # None where positions are not fitted, or images all stay


# Bands up to here determine positions within a few millimetres, in spite of hidden images.
_RETRACE_BELOW_HZ = 1000.0
# Bands up to here are those in which a first guess of the walls does not determine the magnitude
# response of a loudspeaker.
_RETRACE_ENERGIES_BELOW_HZ = 250.0


@dataclass(frozen=True, slots=True, eq=False)
class SequentialState:
    """A task, its paths, and its bands made ready."""

    # with the measurements as sources of a flat magnitude response would have given them
    task: CoherentTask
    paths: Paths
    weights: FloatArray | None  # (n_bands, n_paths)
    binned: BinnedPaths
    # free numbers of the geometry for which the paths were traced; None for those specified
    origin: FloatArray | None
    bands: tuple[CoherentBand | None, ...] = ()
    starts: tuple[FloatArray | None, ...] = ()  # answers by energies of bands that were let go of
    first: tuple[FloatArray | None, ...] = ()  # answers by pressures of an earlier pass
    images: ImagePaths | None = None  # of these paths, what all bands share; None: not made yet
    outliers: Mapping[MeasuredPair, float] = field(default_factory=dict)  # by energies

    @property
    def geometry(self) -> Geometry | None:
        """The unknowns of arrival times, the same in all bands; None without data."""
        return next((b.coherent.geometry for b in self.bands if b is not None), None)


def initialise(task: CoherentTask, traced: TracedPaths) -> SequentialState:
    """Return the bands ready to be fitted, paths found anew where positions must have moved."""
    settings, measured, retrace = task.settings, task.measured, task.retrace
    binned = cut_at(traced.binned, settings.late_end_s)
    state = rebuild(SequentialState(task, traced.paths, traced.factors, binned, None))
    if settings.model == "energy":
        return state
    coloured = False
    if task.directivity_parameters is None:
        even = _even(state, measured, current_absorption(state), SCHROEDER_FACTOR)
        coloured = any(new is not old for new, old in zip(even, measured, strict=True))
        if coloured:
            state = release(replace(state, task=replace(task, measured=even)))
            state = rebuild(state)
    moves = retrace is not None and settings.positions == "fit"
    if not (moves or coloured) or settings.quick:
        return state
    highest_hz = _RETRACE_BELOW_HZ if moves else _RETRACE_ENERGIES_BELOW_HZ
    low = [
        band if f <= highest_hz else None
        for band, f in zip(state.bands, task.bands.centres_hz, strict=True)
    ]
    fits = forward_pass(low, settings, None)
    guess = current_absorption(state, fits)
    known = [f.found for f in fits if f is not None and f.found is not None]
    if retrace is not None and moves and known and state.geometry is not None:
        place, origin = moved_scene(task.scene, state.geometry, known[-1].mean)
        paths, weights, binned = retrace(place)
        binned = cut_at(binned, settings.late_end_s)
        state = replace(
            state, paths=paths, weights=weights, binned=binned, origin=origin, images=None
        )
    state = replace(release(state), first=_vectors(fits))
    del low, fits
    if coloured:
        even = _even(state, measured, guess, 0.0)
        state = replace(state, task=replace(state.task, measured=even))
    return rebuild(state)


def release(state: SequentialState) -> SequentialState:
    """Return a state without its bands, whose answers are kept: if no other name holds them."""
    return replace(state, bands=(), starts=_answers(state))


def _vectors(fits: Sequence[CoherentBandFit | None]) -> tuple[FloatArray | None, ...]:
    return tuple(None if f is None else f.fit.vector for f in fits)


def _answers(state: SequentialState) -> tuple[FloatArray | None, ...]:
    found = tuple(None if b is None else b.energy_fit.vector for b in state.bands)
    return found or state.starts


def rebuild(state: SequentialState) -> SequentialState:
    """Return the same task and paths with bands made anew, as `with_outliers` leaves them.

    The energies of every band are fitted by themselves, in the windows that pressures need. Fits of
    bands made before are where these begin.
    """
    trim_memory()
    task, limit = state.task, state.task.settings.max_rounds
    unknown = task.directivity_parameters
    # what the free numbers of a directivity mean changes with its prior
    starts = (_answers(state) if unknown is None else ()) or (None,) * len(task.bands)
    geometry = replace(
        campaign_geometry(
            task.scene,
            task.priors,
            # every band has the same unknowns, in whichever files it hears
            tuple(m for m in task.measured if m.measurement.use == "fit"),
            positions=task.settings.positions == "fit",
            delays=task.settings.delays,
            speed_sd=task.settings.speed_sd,
        ),
        origin=state.origin,
    )
    made = energy_terms(
        task.scene,
        task.bands,
        task.priors,
        task.measured,
        state.binned,
        task.start,
        periods=_WINDOW_PERIODS,
    )
    images = _images(state) if state.images is None else state.images
    bases = None if unknown is None else row_bases(unknown, task.scene, state.paths, state.binned)
    ready: list[tuple[int, Objective, CoherentTerm, BandDirectivities | None]] = []
    for b, found in enumerate(made):
        if found is None:
            continue
        windows, parameters = found
        directivity, coherent = None, _early(state, b, windows, geometry, images)
        if unknown is not None and bases is not None:
            files = fitted_in_band(task.measured, b)
            directivity = directed_band(unknown, task.scene, bases, windows, files)
            coherent = coherent.aimed(directivity.aims)
        energies = energy_objective(windows, parameters, directivity, task.others[b])
        ready.append((b, energies, coherent, directivity))

    def fitted(own: tuple[int, Objective, CoherentTerm, BandDirectivities | None]) -> BandFit:
        before, energies = starts[own[0]], own[1]
        if before is None:
            return fit_band(energies, max_rounds=limit, settled_sd=BEFORE_THE_LAST_PASS_SD)
        return score_band(energies, before, max_rounds=limit, settled_sd=BEFORE_THE_LAST_PASS_SD)

    bands: list[CoherentBand | None] = [None] * len(task.bands)
    for (b, energies, coherent, directivity), fit in zip(
        ready, in_forks(fitted, ready), strict=True
    ):
        bands[b] = CoherentBand(energies, fit, coherent, directivity)
    misfits = [
        file_misfits(fitted_in_band(task.measured, b), own.coherent.energies, own.energy_fit, None)
        for b, own in enumerate(bands)
        if own is not None
    ]
    outliers = outlier_files(misfits, LEAST_BY_ENERGIES)
    return with_outliers(replace(state, bands=tuple(bands), images=images, outliers=outliers))


def with_outliers(state: SequentialState) -> SequentialState:
    """Return the same bands with larger variances for files that others contradict.

    By energies, or by pressures if the task says so, which know more.
    """
    task, bands = state.task, list(state.bands)
    outliers = {**state.outliers, **task.outliers}
    for b, own in enumerate(bands):
        if own is not None and outliers:
            files, n_data = fitted_in_band(task.measured, b), own.energy_fit.measured.size
            factor = variance_inflation(own.coherent.energies, files, outliers, n_data)
            energies = replace(own.energies, inflation=factor)
            fit = score_band(
                energies,
                own.energy_fit.vector,
                max_rounds=task.settings.max_rounds,
                settled_sd=BEFORE_THE_LAST_PASS_SD,
            )
            bands[b] = replace(own, energies=energies, energy_fit=fit)
    if task.directivity_parameters is not None:
        bands = _under_cavity_priors(task, bands)
    return replace(state, bands=tuple(bands))


def _images(state: SequentialState) -> ImagePaths:
    """Return the images of everything that is fitted, as far as any band adds pressures."""
    task = state.task
    pairs = np.array([m.pair for m in task.measured if m.measurement.use == "fit"])
    reach_s = task.settings.end_s + _REACH_PERIODS / float(task.bands.centres_hz[0])
    c = speed_of_sound_m_s(task.scene.air)
    return image_paths(state.paths, pairs, 0.0, c * reach_s)


def _early(
    state: SequentialState,
    band: int,
    windows: EnergyTerm,
    geometry: Geometry,
    images: ImagePaths,
) -> CoherentTerm:
    """Return the windows of a band as pressures."""
    task, files = state.task, fitted_in_band(state.task.measured, band)
    fitted = [m for m in task.measured if m.measurement.use == "fit"]
    own = np.flatnonzero([m in files for m in fitted])
    return coherent_term(
        task.bands,
        band,
        windows,
        float(attenuation_per_m(task.scene.air, task.bands)[band]),
        images_of(images, own, None if state.weights is None else state.weights[band]),
        state.binned,
        replace(geometry, columns=geometry.columns[own]),
        task.settings.end_s,
    )


def _under_cavity_priors(
    task: CoherentTask, bands: Sequence[CoherentBand | None]
) -> list[CoherentBand | None]:
    """Fit the energies again under what other bands say of the directivity."""
    directivities = directivities_under_cavity_priors(
        cast(DirectivityParameters, task.directivity_parameters),
        task.bands,
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
        fit = score_band(energies, start, max_rounds=task.settings.max_rounds)
        out.append(CoherentBand(energies, fit, own.coherent, directivity))
    return out


def current_absorption(
    state: SequentialState, fits: Sequence[CoherentBandFit | None] = ()
) -> FloatArray:
    """Return absorption by pressures where fitted, else by energies, else the start.

    Shape (n_materials, n_bands).
    """
    out = np.tile(state.task.start, (len(state.task.priors), 1))
    for i, band in enumerate(state.bands):
        if band is not None:
            parameters, vector = band.energies.parameters, band.energy_fit.vector
            out[:, i] = physical_values(parameters, vector)[0]["absorption"]
    for i, fit in enumerate(fits):
        if fit is not None:
            out[:, i] = physical_values(fit.parameters, fit.fit.vector)[0]["absorption"]
    return out


def _even(
    state: SequentialState,
    measured: tuple[MeasuredPair, ...],
    absorption: FloatArray,
    schroeder_factor: float,
) -> tuple[MeasuredPair, ...]:
    task = state.task
    trim_memory()
    return equalise_sources(
        task.scene, task.bands, measured, state.paths, absorption, schroeder_factor=schroeder_factor
    )


def freed_parameters(
    state: SequentialState, fits: Sequence[CoherentBandFit | None]
) -> tuple[Freed | None, Freed | None]:
    """Return what is gained if delays, and positions, are fitted; None of what is not fixed."""
    settings = state.task.settings
    if settings.model == "energy":
        return None, None
    delays = positions = None
    if not settings.delays:
        delays = _freed(state, fits, replace(settings, delays=True))
    if settings.positions == "fixed":
        positions = _freed(state, fits, replace(settings, positions="fit"))
    return delays, positions


def _freed(
    state: SequentialState,
    fits: Sequence[CoherentBandFit | None],
    settings: CoherentOptions,
) -> Freed:
    """Return by how much the data are likelier, over all bands, and by how many more unknowns."""
    freer = rebuild(replace(state, task=replace(state.task, settings=settings)))
    freed = forward_pass(freer.bands, settings, None, _vectors(fits))
    gain = increases_likelihood(fits, freed)
    before, after = (
        0 if g is None else int(np.count_nonzero(g.fitted & (g.sd > 0.0)))
        for g in (state.geometry, freer.geometry)
    )
    n_windows = sum(f.fit.expected.size for f in fits if f is not None)
    return Freed(gain, after - before, n_windows)


# errors that windows share, by name and one sd a column, and the prediction at the fit
SharedErrors: TypeAlias = tuple[Mapping[str, FloatArray], Prediction]


@dataclass(frozen=True, slots=True, eq=False)
class CoherentFit:
    """Every band fitted with partly coherent image sources, and what was found on the way."""

    state: SequentialState
    fits: tuple[CoherentBandFit | None, ...]  # None where too few windows rise above the noise
    # of the energy model and of the partly coherent one; NaN where not tried; (n_bands, 2)
    log_evidences: FloatArray
    geometry: FittedGeometry | None  # None where no band was coherent
    shared: tuple[SharedErrors | None, ...]  # of the fits
    tests: CoherentTests
    # by band, what contradicts that sources are omnidirectional
    contradicted: tuple[SourceGain, ...] = ()  # of the sources taken for omnidirectional


def fit_coherent(
    state: SequentialState, traced: TracedPaths, progress: Progress | None = None
) -> CoherentFit:
    """Fit every band with image sources as coherent as their times are known.

    Which images a receiver sees depends on where it stands, except in a box: elsewhere the bands
    up to 1 kHz are fitted first, images are found anew at the positions they tell, and everything
    is fitted again from the specified prior.
    """
    state = state if state.task.settings.quick else with_sources_examined(state, traced)
    task, settings = state.task, state.task.settings
    fits = forward_pass(state.bands, settings, part(progress, 0.0, 0.8), state.first)
    if settings.quick:
        fits, _ = leave_one_out_pass(state.bands, _uncontradicted(state, fits), settings)
        evidences, shared = _log_evidences(state, fits), _shared_errors(state, fits)
        tests = CoherentTests(_outliers(state))
        return CoherentFit(state, tuple(fits), evidences, None, shared, tests)
    _log_first_answer(state, fits)
    misfits = [
        file_misfits(
            fitted_in_band(state.task.measured, b),
            own.coherent.energies,
            fit.fit,
            own.energies.inflation,
        )
        for b, (own, fit) in enumerate(zip(state.bands, fits, strict=True))
        if own is not None and fit is not None
    ]
    outliers = outlier_files(misfits, LEAST_BY_PRESSURES)
    if outliers:
        first, fits = _vectors(fits), []
        state = replace(state, task=replace(state.task, outliers=outliers))
        # what is known of a directivity by other bands depends on the outliers
        is_directed = state.task.directivity_parameters is not None
        state = release(state) if is_directed else state
        state = rebuild(state) if is_directed else with_outliers(state)
        fits = forward_pass(state.bands, settings, part(progress, 0.8, 1.0), first)
    position_sd_scale = contradicted_position_sd_scale(state, fits)
    if position_sd_scale > 1.0:
        place, origin = inflate_position_sds(state.task.scene, state.origin, position_sd_scale)
        moved, first, fits = replace(state.task, scene=place), _vectors(fits), []
        state = release(replace(state, task=moved, origin=origin))
        state = rebuild(state)
        fits = forward_pass(state.bands, settings, part(progress, 0.8, 1.0), first)
    delays, positions = freed_parameters(state, fits := _uncontradicted(state, fits))
    fits, final = leave_one_out_pass(state.bands, fits, settings)
    is_settled = final is None or agree(fits, final)
    while final is not None and not is_settled:
        trim_memory()
        other = forward_pass(state.bands, settings, None, _vectors(fits), final)
        other, found = leave_one_out_pass(state.bands, other, settings)
        is_settled = increases_likelihood(fits, other) < UNDECIDED
        if not is_settled:
            fits, final = other, found
        del other
    trim_memory()
    geometry = state.geometry
    estimate = None if geometry is None or final is None else fitted_geometry(geometry, final)
    late = contradicted_sources(task.tested_sources, _source_scores(state))
    evidences, shared = _log_evidences(state, fits), _shared_errors(state, fits)
    tests = CoherentTests(_outliers(state), position_sd_scale, delays, positions)
    return CoherentFit(
        state, tuple(fits), evidences, estimate, shared, tests, (*task.contradicted, *late)
    )


def contradicted_position_sd_scale(
    state: SequentialState, fits: Sequence[CoherentBandFit | None]
) -> float:
    """Return by how much position standard deviations are too small, of bands that contradict them.

    A band that its positions keep from being explained by pressures has moved none of them: what
    all bands together say of positions is then asked of a pass by pressures.
    """
    settings = state.task.settings
    if settings.model == "auto" and contradicts_geometry(state.bands, fits):
        by_pressures = replace(settings, model="coherent")
        fits = forward_pass(state.bands, by_pressures, None, _vectors(fits))
    return estimate_position_sd_scale(state.task.scene, state.bands, fits)


def _uncontradicted(
    state: SequentialState, fits: list[CoherentBandFit | None]
) -> list[CoherentBandFit | None]:
    """Return the fits, none where the model is chosen and bands contradict pressures."""
    is_open = state.task.settings.model == "auto"
    return [None] * len(fits) if is_open and contradicts_geometry(state.bands, fits) else fits


def _outliers(state: SequentialState) -> dict[Measurement, float]:
    """Return the recordings whose variances are inflated, by energies or by pressures."""
    return {m.measurement: x for m, x in {**state.outliers, **state.task.outliers}.items()}


def _log_first_answer(state: SequentialState, fits: Sequence[CoherentBandFit | None]) -> None:
    """Log what the first pass has found, long before the answer is examined and complete.

    Intervals are Gaussian, without the errors that windows share.
    """
    if not _LOG.isEnabledFor(_NOTICE):
        return
    evidences, columns = _log_evidences(state, fits), []
    for b, (own, fit) in enumerate(zip(state.bands, fits, strict=True)):
        if own is None:
            continue
        parameters, found = own.energies.parameters, own.energy_fit
        if fit is not None and not evidences[b, 1] < evidences[b, 0]:
            parameters, found = fit.parameters, fit.fit
        how = fit_covariance(found), found.chi2_reduced
        at = absorption_intervals(parameters, found.vector, *how)
        numbers = 100.0 * np.stack([at.absorption, at.lower95, at.upper95], axis=1)
        entries = [f"{a:.0f} ({low:.0f}-{high:.0f})" for a, low, high in numbers]
        columns.append([f"{state.task.bands.centres_hz[b]:g} Hz", *entries])
    names = [p.name for p in state.task.priors]
    _LOG.log(_NOTICE, "so far, absorption in % and its 95 % interval; not yet examined:")
    for name, *entries in zip(["", *names], *columns, strict=True):
        _LOG.log(_NOTICE, "%-16.16s%s", name, "".join(f"{e:>12s}" for e in entries))


def _log_evidences(state: SequentialState, fits: Sequence[CoherentBandFit | None]) -> FloatArray:
    found: FloatArray = np.full((len(fits), 2), np.nan)
    for b, (own, fit) in enumerate(zip(state.bands, fits, strict=True)):
        if own is not None and fit is not None:
            found[b] = log_evidences(own, fit)
    return found


def _shared_errors(
    state: SequentialState, fits: Sequence[CoherentBandFit | None]
) -> tuple[SharedErrors | None, ...]:
    """Return the errors that windows share in each fit; what is fitted is large."""

    def errors(b: int) -> SharedErrors | None:
        own, fit = state.bands[b], fits[b]
        if own is None or fit is None:
            return None
        objective = fit.objective(own)
        relative = _relative_errors(state, objective, fit.fit, own.coherent.energies)
        shared = shared_errors(objective, fit.fit, _sources(state.task, b), relative)
        noise = np.concatenate([o.noise for o in own.coherent.energies.observations])
        signal = fit.fit.expected[: noise.size] - noise
        shared["lost coherence"] = (signal * lost_coherence(own, fit.fit))[:, None]
        return shared, objective.predict(fit.fit.vector)

    return tuple(in_forks(errors, range(len(fits))))


def _source_scores(state: SequentialState) -> dict[int, DirectivityScore]:
    """Return by band what contradicts that sources taken for omnidirectional are."""
    task, tested = state.task, state.task.tested_sources
    if tested is None:
        return {}
    bases = row_bases(tested, task.scene, state.paths, state.binned)

    def score(band: tuple[int, CoherentBand]) -> DirectivityScore:
        b, own = band
        files = fitted_in_band(task.measured, b)
        directivity = directed_band(tested, task.scene, bases, own.coherent.energies, files)
        return directivity_score(own.energies, own.energy_fit, directivity)

    there = [(b, own) for b, own in enumerate(state.bands) if own is not None]
    return dict(zip((b for b, _ in there), in_forks(score, there), strict=True))


def with_sources_examined(state: SequentialState, traced: TracedPaths) -> SequentialState:
    """Return the bands anew with unknown directivities where energies contradict that of a source.

    Of all sources taken for omnidirectional: a measurement rarely has two kinds. It comes before
    all else is fitted: where a loudspeaker is taken for omnidirectional, positions, scattering and
    the laws of the measurement chain are bent to explain what it does to the levels of reflections.
    """
    task = state.task
    if not task.fits_contradicted or task.tested_sources is None:
        return state
    found = contradicted_sources(task.tested_sources, _source_scores(state))
    if not found:
        return state
    fitted = with_fitted_sources(task.directivity_parameters, task.tested_sources)
    again = replace(task, directivity_parameters=fitted, tested_sources=None, contradicted=found)
    return initialise(again, traced)


def coherent_estimate(fit: CoherentFit, b: int) -> FittedBand | None:
    """Return a band's coherent estimate, common-mode errors included in the covariance.

    Without fit and problem where energies explain the band better: its intervals are of no use.
    """
    state, task = fit.state, fit.state.task
    areas_m2 = material_areas_m2(task.scene.room)
    band, found, errors = state.bands[b], fit.fits[b], fit.shared[b]
    if band is None or found is None or errors is None:
        return None
    objective = found.objective(band)
    effect = effect_on_answer(objective, found.fit, errors[0], areas_m2, errors[1])
    own = band_estimate(objective.parameters, found.fit, "coherent", effect)
    own = replace(own, window_decays_s=_window_decays_s(band.coherent.energies, found.fit))
    lost = float(fit.log_evidences[b, 0] - fit.log_evidences[b, 1])
    beaten = task.settings.model != "coherent" and lost >= UNDECIDED
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
    state: SequentialState, objective: Objective, fit: BandFit, windows: EnergyTerm
) -> FloatArray:
    task = state.task
    known = np.zeros((len(task.priors), len(task.bands))), np.zeros(len(task.priors))
    return relative_errors(
        task.scene.air,
        task.bands,
        windows,
        state.paths,
        physical_values(objective.parameters, fit.vector)[0]["absorption"],
        task.scattering or known,
    )


def _sources(task: CoherentTask, band: int) -> tuple[int, ...]:
    """Return the source of each of a band's observations."""
    return tuple(int(task.scene.pairs[m.pair][0]) for m in fitted_in_band(task.measured, band))


def energy_estimates(fit: CoherentFit) -> Callable[[int], FittedBand | None]:
    """Return what says of a band by energies alone, in the windows whose noise is known to suit.

    None where the partly coherent model decides, or where there are no data.
    """
    state, task = fit.state, fit.state.task
    areas_m2 = material_areas_m2(task.scene.room)
    may_decide = task.settings.model != "coherent"
    wanted = [
        f is None or (may_decide and bool(x[1] - x[0] < UNDECIDED))
        for f, x in zip(fit.fits, fit.log_evidences, strict=True)
    ]
    unknown, bases = task.directivity_parameters, None
    if unknown is not None and any(wanted):
        bases = row_bases(unknown, task.scene, state.paths, state.binned)

    def estimate(number: int) -> FittedBand | None:
        if not wanted[number]:
            return None
        made = energy_term(
            task.scene, task.bands, task.priors, task.measured, state.binned, task.start, number
        )
        if made is None:
            return None
        (windows, parameters), band = made, state.bands[number]
        files = fitted_in_band(task.measured, number)
        directivity = None if band is None else band.directivity
        if directivity is not None and unknown is not None and bases is not None:
            # other windows may hear other rows
            rows = directed_band(unknown, task.scene, bases, windows, files)
            directivity = replace(rows, unknown=directivity.unknown)
        objective = energy_objective(windows, parameters, directivity, task.others[number])
        if band is not None and band.energies.inflation is not None:
            # as for the finer windows: one factor an observation
            fine = [o.energy.size for o in band.coherent.energies.observations]
            factors = band.energies.inflation[np.cumsum([0, *fine[:-1]])]
            outliers = dict(zip(files, factors.tolist(), strict=True))
            n_data = objective.measured().size
            factor = variance_inflation(windows, files, outliers, n_data)
            objective = replace(objective, inflation=factor)
        own_fit = fit_band(objective, max_rounds=task.settings.max_rounds)
        relative = _relative_errors(state, objective, own_fit, windows)
        shared = shared_errors(objective, own_fit, _sources(task, number), relative)
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
    moving = np.flatnonzero(geometry.fitted & (geometry.sd > 0.0))
    is_position = moving < n_position_coordinates(scene)
    n = int(np.count_nonzero(is_position))
    if n < _FEWEST_COORDINATES:
        return 1.0
    variance = np.diag(np.linalg.inv(last.information))
    mean = float(np.mean((last.mean**2 + variance)[is_position]))
    return 1.0 if mean <= chdtri(n, 1.0 - LEVEL) / n else min(float(np.sqrt(mean)), _LARGEST_SCALE)
