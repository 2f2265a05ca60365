"""The absorption of every band estimated by window energies and room parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from roomfit.base.forks import in_forks
from roomfit.base.typing import FloatArray, Progress, part
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
from roomfit.fit.paths import TracedPaths
from roomfit.fit.systematics import effect_on_answer, relative_errors, shared_errors
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
from roomfit.room.scene import material_areas_m2
from roomfit.settings import Settings
from roomfit.solver import BandFit
from roomfit.uncertainty.gaussian import BandEstimate, Refine, SharedErrors


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

    Where data contradict a source that was taken for omnidirectional, its directivity is fitted.

    Shapes: `start` (n_bands,).
    """
    unknown = directivity_parameters(measured, settings)
    tested = omnidirectional(measured) if unknown is None else None

    def estimated(
        unknown: DirectivityParameters | None, tested: DirectivityParameters | None
    ) -> BandFits:
        directivities = directed_energies(measured, priors, traced, start, unknown)
        objective_of = energy_objectives(measured, priors, traced, start, directivities)
        score = None if tested is None else source_scorer(measured, traced, tested)
        n = len(measured.bands)

        def errors(band: int, objective: Objective, fit: BandFit) -> SharedErrors | None:
            return _shared_errors(measured, traced, band, objective, fit)

        def answer(band: int) -> tuple[BandEstimate, DirectivityScore | None]:
            done = part(progress, band / n, (band + 1) / n)
            own = fitted_band(band, objective_of(band), priors, settings, done, errors)
            against: DirectivityScore | None = None
            if score is not None and own.objective is not None and own.fit is not None:
                against = score(band, own.objective, own.fit)
            return refine(own), against

        estimates, scores = zip(*in_forks(answer, range(n)), strict=True)
        found = band_directivities(measured.scene, unknown, directivities, estimates)
        known = {band: score for band, score in enumerate(scores) if score is not None}
        against = contradicted_sources(tested, known)
        return BandFits(
            estimates, directivities=found, unknown_sources=unknown, contradicted=against
        )

    fits = estimated(unknown, tested)
    against = fits.contradicted
    if not against or tested is None or settings.quick or not is_fittable(measured, settings):
        return fits
    return replace(estimated(with_fitted_sources(unknown, tested), None), contradicted=against)


def _shared_errors(
    measured: Measurements, traced: TracedPaths, band: int, objective: Objective, fit: BandFit
) -> SharedErrors | None:
    """Return what errors that windows share do to a band's fit; None without responses."""
    scene, windows = measured.scene, objective.as_energies(fit.vector)
    if windows is None or not fit.vector.size:
        return None
    sources = [int(scene.pairs[m.pair][0]) for m in fitted_in_band(measured.responses, band)]
    walls = physical_values(objective.parameters, fit.vector)[0]["absorption"]
    scattering = traced.scattering, traced.scattering_sd
    known = scene.air, measured.bands, windows, traced.paths, walls, scattering
    shared = shared_errors(objective, fit, sources, relative_errors(*known))
    return effect_on_answer(objective, fit, shared, material_areas_m2(scene.room))


def energy_objectives(
    measured: Measurements,
    priors: tuple[MaterialPrior, ...],
    traced: TracedPaths,
    start: FloatArray,
    directivities: tuple[BandDirectivities | None, ...],
) -> Callable[[int], Objective | None]:
    """Return what makes the objective of a band from window energies, room parameters, or both."""
    others = other_terms(measured, traced)
    scene, bands, responses = measured.scene, measured.bands, measured.responses

    def objective(band: int) -> Objective | None:
        own = energy_term(scene, bands, priors, responses, traced.binned, start, band)
        if own is None:
            return without_responses(others[band], priors, band, start)
        return energy_objective(*own, directivities[band], others[band])

    return objective


def other_terms(measured: Measurements, traced: TracedPaths) -> tuple[tuple[DataTerm, ...], ...]:
    """Return the data of every band beside responses: one entry of `kinds` each kind of data."""
    scene, bands = measured.scene, measured.bands
    kinds: list[Sequence[DataTerm | None]] = []
    if measured.values:
        kinds.append(value_terms(scene, bands, measured.values, traced.binned))
    each = zip(*kinds, strict=True) if kinds else ((),) * len(bands)
    return tuple(tuple(term for term in own if term is not None) for own in each)
