"""The absorption of every band estimated: by energies, or by pressures where they explain more."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from roomfit.base.air import Air, relative_speed_sd
from roomfit.base.forks import in_forks
from roomfit.base.typing import BoolArray, FloatArray, Progress, part
from roomfit.fit.bands import fitted_band
from roomfit.fit.directivity import (
    DirectivityScore,
    band_directivities,
    contradicted_sources,
    directed_energies,
    directivity_parameters,
    is_fittable,
    omnidirectional,
    source_scorer,
    with_fitted_sources,
)
from roomfit.fit.fits import BandFits
from roomfit.fit.measurements import Measurements
from roomfit.fit.paths import TracedPaths, traced_paths
from roomfit.fit.systematics import (
    inflated_by_adjacent_bands,
    relative_errors,
    shared_errors,
    with_both_intervals,
    with_decay_errors,
    with_shared_errors,
)
from roomfit.fit.trace_plan import is_coherent
from roomfit.materials.priors import MaterialPrior
from roomfit.model.directivity import (
    BandDirectivities,
    DirectivityParameters,
    energy_objective,
)
from roomfit.model.observation import energy_term, fitted_in_band
from roomfit.model.parameters import physical_values
from roomfit.model.problem import DataTerm, Objective
from roomfit.model.room_parameters import value_terms, without_responses
from roomfit.pressures.fit import (
    CoherentFit,
    CoherentTask,
    coherent_estimate,
    contradicted_position_sd_scale,
    energy_estimates,
    initialise,
    with_sources_examined,
)
from roomfit.pressures.sequential import (
    TELLING_HZ,
    UNDECIDED,
    CoherentOptions,
    forward_pass,
    log_evidences,
)
from roomfit.room.scene import material_areas_m2, select_pairs
from roomfit.settings import Model, Settings
from roomfit.solver import BandFit
from roomfit.uncertainty.gaussian import BandEstimate, Refine, SharedCovariance


def shared_error_covariance(measured: Measurements, traced: TracedPaths) -> SharedCovariance:
    """Return what adds to a band's fit the covariance of the errors that its windows share.

    Room parameters without responses stay as they are.
    """
    scene, bands = measured.scene, measured.bands
    areas_m2 = material_areas_m2(scene.room)

    def add_shared_errors(band: int, objective: Objective, fit: BandFit) -> BandFit:
        windows = objective.as_energies(fit.vector)
        if windows is None or not fit.vector.size:
            return fit
        files = fitted_in_band(measured.responses, band)
        sources = [int(scene.pairs[m.pair][0]) for m in files]
        walls = physical_values(objective.parameters, fit.vector)[0]["absorption"]
        relative = relative_errors(
            scene.air,
            bands,
            windows,
            traced.paths,
            walls,
            (traced.scattering, traced.scattering_sd),
        )
        shared = shared_errors(objective, fit, sources, relative)
        return with_shared_errors(objective, fit, shared, areas_m2=areas_m2)

    return add_shared_errors


def prior_speed_sd(air: Air, settings: Settings) -> float:
    """Return the prior relative standard deviation of the speed of sound, 1e-6 at least."""
    if settings.temperature_sd_c is None:
        return settings.speed_of_sound_sd
    return max(relative_speed_sd(air, settings.temperature_sd_c), 1e-6)


def estimate_energies(
    measured: Measurements,
    priors: tuple[MaterialPrior, ...],
    traced: TracedPaths,
    start: FloatArray,
    settings: Settings,
    refine: Refine,
    progress: Progress | None,
) -> BandFits:
    """Estimate the absorption of every band by window energies and room parameters.

    Shapes: `start` (n_bands,).
    """
    unknown = directivity_parameters(measured, settings)
    tested = omnidirectional(measured) if unknown is None else None
    areas_m2 = material_areas_m2(measured.scene.room)

    def estimated(
        unknown: DirectivityParameters | None, tested: DirectivityParameters | None
    ) -> BandFits:
        directivities = directed_energies(measured, priors, traced, start, unknown)
        objective_of = energy_objectives(measured, priors, traced, start, directivities)
        score = None
        if tested is not None:
            score = source_scorer(measured, traced, tested)
        shared, n = shared_error_covariance(measured, traced), len(measured.bands)

        def answer(band: int) -> tuple[BandEstimate, DirectivityScore | None]:
            done = part(progress, band / n, (band + 1) / n)
            own = fitted_band(band, objective_of(band), priors, settings, done, shared)
            against: DirectivityScore | None = None
            if score is not None and own.objective is not None and own.fit is not None:
                against = score(band, own.objective, own.fit)
            return refine(own, None), against

        answers = in_forks(answer, range(n))
        scores = {band: score for band, (_, score) in enumerate(answers) if score is not None}
        estimates = with_decay_errors([found for found, _ in answers], areas_m2, priors)
        found = band_directivities(measured.scene, unknown, directivities, estimates)
        against = contradicted_sources(tested, scores)
        return BandFits(
            estimates, directivities=found, unknown_sources=unknown, contradicted=against
        )

    fits = estimated(unknown, tested)
    against = fits.contradicted
    if not against or tested is None or settings.quick or not is_fittable(measured, settings):
        return fits
    return replace(estimated(with_fitted_sources(unknown, tested), None), contradicted=against)


def energy_objectives(
    measured: Measurements,
    priors: tuple[MaterialPrior, ...],
    traced: TracedPaths,
    start: FloatArray,
    directivities: tuple[BandDirectivities | None, ...],
) -> Callable[[int], Objective | None]:
    """Return what makes the objective of a band from window energies, room parameters, or both."""
    others = _other_terms(measured, traced)
    scene, bands, responses = measured.scene, measured.bands, measured.responses

    def objective(band: int) -> Objective | None:
        own = energy_term(scene, bands, priors, responses, traced.binned, start, band)
        if own is None:
            return without_responses(others[band], priors, band, start)
        return energy_objective(*own, directivities[band], others[band])

    return objective


def coherent_task(
    measured: Measurements,
    priors: tuple[MaterialPrior, ...],
    traced: TracedPaths,
    start: FloatArray,
    settings: Settings,
) -> CoherentTask:
    """Return what is to be fitted by partly coherent image sources; see `estimate_energies`."""
    unknown = directivity_parameters(measured, settings)
    return CoherentTask(
        measured.scene,
        measured.bands,
        priors,
        measured.responses,
        start,
        CoherentOptions(
            positions="fixed" if settings.positions == "fixed" else "fit",
            delays=settings.reflection_delays,
            model="coherent" if settings.model == "coherent" else "auto",
            end_s=settings.coherent_until_s,
            late_end_s=traced.fit_until_s,
            speed_sd=prior_speed_sd(measured.scene.air, settings),
            max_rounds=settings.max_rounds,
            quick=settings.quick,
        ),
        _other_terms(measured, traced),
        unknown,
        omnidirectional(measured) if unknown is None else None,
        scattering=(traced.scattering, traced.scattering_sd),
        fits_contradicted=is_fittable(measured, settings),
    )


# The trial of pressures: how many responses at most, and how far apart its two bands are; rays a
# source and images a pair at most, the latter .14 s of 70 m3.
_TRIED_RESPONSES, _TRIED_OCTAVES = 8, 2.0
_TRIED_PATHS = {
    "n_rays": 10_000,
    "n_rays_beside_images": 10_000,
    "most_images": 6_000,
    "most_coherent_images": 6_000,
}


def chosen_model(
    measured: Measurements,
    priors: tuple[MaterialPrior, ...],
    start: FloatArray,
    settings: Settings,
) -> Model:
    """Return the model of the settings, "energy" where few responses contradict pressures.

    Before the room is traced for either. Positions, speed of sound and delays that a band at 250 Hz
    determines are known to millimetres. Where they are the room's, pressures explain the octave of
    1 kHz better than energies; where they have absorbed what the model of pressures lacks
    (loudspeakers, scattering, walls that are not specified), energies are likelier there by
    `log_evidences`, and what was fitted to the lower band is no geometry. Nor is there anything to
    gain where energies are likelier in both bands. Where positions contradict what is stated of
    them, all responses decide. Eight responses at most are compared, in the
    highest band up to 1 kHz and the one nearest to two octaves below.

    Shapes: `start` (n_bands,).
    """
    centres_hz = measured.bands.centres_hz
    high = int(np.searchsorted(centres_hz, 1.01 * TELLING_HZ)) - 1
    if settings.model != "auto" or high < 1 or not is_coherent(measured.responses, settings):
        return settings.model
    octaves = np.log2(centres_hz[high] / centres_hz[:high])
    low = int(np.argmin(np.abs(octaves - _TRIED_OCTAVES)))
    few = _few(measured, np.isin(np.arange(centres_hz.size), (low, high)))
    most: dict[str, Any] = {
        name: min(n, getattr(settings, name) or n) for name, n in _TRIED_PATHS.items()
    }
    quick = replace(settings, quick=True, **most)
    priors = tuple(replace(k, fit_scattering=False) for k in priors)
    traced = replace(traced_paths(few, priors, quick, start, None), again=None)
    if not traced.far_images:
        return settings.model
    task = coherent_task(few, priors, traced, start, quick)
    state = with_sources_examined(initialise(task, traced), traced)
    fits = forward_pass(state.bands, task.settings, None)
    gains = []
    for own, fit in ((state.bands[b], fits[b]) for b in (low, high)):
        if own is None:
            return settings.model
        if fit is None:
            return "energy"
        energies, pressures = log_evidences(own, fit)
        gains.append(pressures - energies)
    if max(gains) > 0.0 and gains[1] <= -UNDECIDED:
        # positions that are known less well than stated explain it: a fit inflates that
        is_too_sure = contradicted_position_sd_scale(state, fits) > 1.0
        return settings.model if is_too_sure else "energy"
    return settings.model if max(gains) > 0.0 else "energy"


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


def coherent_answers(
    fit: CoherentFit, settings: Settings, refine: Refine, progress: Progress | None
) -> BandFits:
    """Return each band's estimate by partly coherent image sources where they explain it."""
    task, n = fit.state.task, len(fit.fits)
    by_energies = energy_estimates(fit)

    def answers(b: int) -> tuple[BandEstimate | None, BandEstimate | None]:
        pressures, energies = coherent_estimate(fit, b), by_energies(b)
        done = part(progress, 0.8 * b / n, 0.8 * (b + 1) / n)
        return (
            None if pressures is None else refine(pressures, done),
            None if energies is None else refine(energies, None),
        )

    coherent, energy = zip(*in_forks(answers, range(n)), strict=True)
    areas_m2 = material_areas_m2(task.scene.room)
    chosen = decided(fit, energy, inflated_by_adjacent_bands(coherent, task.priors))

    # where no response has data, room parameters or the prior
    def rest(b: int) -> BandEstimate:
        alone = without_responses(task.others[b], task.priors, b, task.start)
        done = part(progress, 0.8 + 0.2 * b / n, 0.8 + 0.2 * (b + 1) / n)
        return refine(fitted_band(b, alone, task.priors, settings, done), None)

    missing = [b for b, e in enumerate(chosen) if e is None]
    others = dict(zip(missing, in_forks(rest, missing), strict=True))
    each = [others[b] if e is None else e for b, e in enumerate(chosen)]
    estimates = with_decay_errors(each, areas_m2, task.priors)
    directivities = tuple(None if b is None else b.directivity for b in fit.state.bands)
    found = band_directivities(task.scene, task.directivity_parameters, directivities, estimates)
    unknown = task.directivity_parameters
    return BandFits(estimates, fit.geometry, found, unknown, fit.contradicted, fit.tests)


def decided(
    fit: CoherentFit,
    energy: Sequence[BandEstimate | None],
    coherent: Sequence[BandEstimate | None],
) -> tuple[BandEstimate | None, ...]:
    """Return each band's estimate by the model of larger evidence, None without data."""
    task = fit.state.task
    return tuple(
        _decided(*each, task.settings)
        for each in zip(energy, coherent, fit.log_evidences, strict=True)
    )


def _decided(
    energy: BandEstimate | None,
    coherent: BandEstimate | None,
    evidences: FloatArray,
    settings: CoherentOptions,
) -> BandEstimate | None:
    """Return the answer of larger evidence; with both intervals where evidence cannot decide."""
    if coherent is None:
        return energy
    if energy is None or settings.model == "coherent":
        return coherent
    better = evidences[1] - evidences[0]
    best, other = (coherent, energy) if better > 0.0 else (energy, coherent)
    return best if abs(better) >= UNDECIDED else with_both_intervals(best, other)


def _other_terms(measured: Measurements, traced: TracedPaths) -> tuple[tuple[DataTerm, ...], ...]:
    """Return the data of every band beside responses: one entry of `kinds` each kind of data."""
    scene, bands = measured.scene, measured.bands
    kinds: list[Sequence[DataTerm | None]] = []
    if measured.values:
        kinds.append(value_terms(scene, bands, measured.values, traced.binned))
    each = zip(*kinds, strict=True) if kinds else ((),) * len(bands)
    return tuple(tuple(term for term in own if term is not None) for own in each)
