"""The absorption of every band estimated by window energies and room parameters.

Bands are fitted one by one, energies also from random starts: do they end in one minimum?
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from roomfit.base.forks import in_forks
from roomfit.base.typing import FloatArray, Progress, part
from roomfit.fit.choice import choose
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
from roomfit.fit.simplex import unit_box_solver
from roomfit.fit.systematics import effect_on_answer, relative_errors, shared_errors
from roomfit.materials.priors import MaterialPrior
from roomfit.model.directivity import DirectivityParameters, energy_objective
from roomfit.model.energy import only_energies
from roomfit.model.observation import energy_term, fitted_in_band
from roomfit.model.parameters import (
    absorption_of,
    physical_values,
    position_of,
    prior_residuals,
    start_vector,
)
from roomfit.model.problem import DataTerm, Objective
from roomfit.model.room_parameters import value_terms, without_responses
from roomfit.room.scene import material_areas_m2
from roomfit.settings import Settings
from roomfit.solver import BandFit, Solver, first_round, fit_band, gauss_newton
from roomfit.uncertainty import gaussian

# Log-likelihoods with priors that differ by less do not decide between two minima.
ALIKE = 2.0
# Of a standard deviation: first rounds end within a hundredth of where they lead.
_SAME_PLACE = 0.2

ErrorsOfBand: TypeAlias = Callable[[int, Objective, BandFit], gaussian.SharedErrors | None]
"""What errors that a band's windows share do to its fit; None where it has no windows."""


def from_random_starts(
    objective: Objective, fit: BandFit, rng: np.random.Generator, number: int
) -> tuple[BandFit, gaussian.Starts]:
    """Return the likeliest of a fit and of others from random starts, and whether they agree.

    Starts are even over absorption. One whose first round ends where that of the usual start does
    is not followed any further.
    """
    parameters = objective.parameters
    usual = first_round(objective, start_vector(parameters))
    evaluations = fit.evaluations + usual.evaluations
    sd = np.sqrt(np.diag(np.linalg.inv(fit.information)))
    fits, first = [fit], position_of(parameters, "absorption")
    for _ in range(number):
        start = np.array(fit.vector)
        share = rng.uniform(0.02, 0.98, int(np.count_nonzero(absorption_of(parameters).fitted)))
        start[first : first + share.size] = np.log(share) - np.log1p(-share)
        other = first_round(objective, start)
        alike = bool(np.all(np.abs(other.x - usual.x) <= _SAME_PLACE * sd))
        fits.append(fit if alike else fit_band(objective, start=other.x))
        evaluations += other.evaluations + (0 if alike else fits[-1].evaluations)
    priors = [prior_residuals(parameters, f.vector)[0] for f in fits]
    worth = [f.log_likelihood - 0.5 * float(p @ p) for f, p in zip(fits, priors, strict=True)]
    # rounding and rounds of weights are no better answer
    best, alike_best = choose(range(len(fits)), worth, ALIKE, least_gain=0.05)
    how = gaussian.fit_covariance(fits[best]), fits[best].chi2_reduced
    found = gaussian.absorption_intervals(parameters, fits[best].vector, *how)
    absorptions = [physical_values(parameters, f.vector)[0]["absorption"] for f in fits]
    within = [bool(np.all((p >= found.lower95) & (p <= found.upper95))) for p in absorptions]
    others = [i for i in alike_best if not within[i]]
    nearest = max(others, key=lambda i: worth[i], default=None)
    return replace(fits[best], evaluations=evaluations), gaussian.Starts(
        number,
        sum(within) - 1,
        None if nearest is None else absorptions[nearest],
        0.0 if nearest is None else float(worth[best] - worth[nearest]),
    )


def fitted_band(
    band: int,
    objective: Objective | None,
    priors: tuple[MaterialPrior, ...],
    settings: Settings,
    progress: Progress | None = None,
    errors_of: ErrorsOfBand | None = None,
) -> gaussian.FittedBand:
    """Return a band with its fit; without data, with its prior."""
    if objective is None:
        return gaussian.FittedBand(gaussian.prior_only_band(priors, band))
    parameters, rng = objective.parameters, np.random.default_rng(settings.seed)
    solver: Solver = gauss_newton
    if settings.method in ("simplex", "annealing"):
        solver = unit_box_solver(parameters, settings.method, rng)
    fit = fit_band(objective, solver, max_rounds=settings.max_rounds, progress=progress)
    starts: gaussian.Starts | None = None
    if settings.method == "auto" and fit.vector.size and only_energies(objective) is not None:
        rng = np.random.default_rng(settings.seed)
        fit, starts = from_random_starts(objective, fit, rng, settings.n_random_starts)
    shared = None if errors_of is None else errors_of(band, objective, fit)
    model = "energy" if objective.is_gamma().any() else "values"
    estimate = replace(gaussian.band_estimate(parameters, fit, model, shared), starts=starts)
    return gaussian.FittedBand(estimate, objective, fit, None if shared is None else shared.steps)


def estimate_energies(
    measured: Measurements,
    priors: tuple[MaterialPrior, ...],
    traced: TracedPaths,
    start: FloatArray,
    settings: Settings,
    refine: gaussian.Refine,
    progress: Progress | None,
) -> BandFits:
    """Estimate the absorption of every band by window energies and room parameters.

    Where data contradict a source that was taken for omnidirectional, its directivity is fitted.
    """
    unknown = directivity_parameters(measured, settings)
    tested = omnidirectional(measured) if unknown is None else None
    scene, bands, responses = measured.scene, measured.bands, measured.responses
    n, others = len(bands), other_terms(measured, traced)

    def errors(band: int, objective: Objective, fit: BandFit) -> gaussian.SharedErrors | None:
        windows = objective.as_energies(fit.vector)
        if windows is None or not fit.vector.size:
            return None
        sources = [int(scene.pairs[m.pair][0]) for m in fitted_in_band(responses, band)]
        walls = physical_values(objective.parameters, fit.vector)[0]["absorption"]
        scattering = traced.scattering, traced.scattering_sd
        relative = relative_errors(scene.air, bands, windows, traced.paths, walls, scattering)
        shared = shared_errors(objective, fit, sources, relative)
        return effect_on_answer(objective, fit, shared, material_areas_m2(scene.room))

    def estimated(
        unknown: DirectivityParameters | None, tested: DirectivityParameters | None
    ) -> BandFits:
        directivities = directed_energies(measured, priors, traced, start, unknown)
        score = None if tested is None else source_scorer(measured, traced, tested)

        def answer(band: int) -> tuple[gaussian.BandEstimate, DirectivityScore | None]:
            made = energy_term(scene, bands, priors, responses, traced.binned, start, band)
            if made is None:
                objective = without_responses(others[band], priors, band, start)
            else:
                objective = energy_objective(*made, directivities[band], others[band])
            done = part(progress, band / n, (band + 1) / n)
            own = fitted_band(band, objective, priors, settings, done, errors)
            against: DirectivityScore | None = None
            if score is not None and own.objective is not None and own.fit is not None:
                against = score(band, own.objective, own.fit)
            return refine(own), against

        estimates, scores = zip(*in_forks(answer, range(n)), strict=True)
        found = band_directivities(scene, unknown, directivities, estimates)
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


def other_terms(measured: Measurements, traced: TracedPaths) -> tuple[tuple[DataTerm, ...], ...]:
    """Return the data of every band beside responses, of which room parameters are one kind."""
    if not measured.values:
        return ((),) * len(measured.bands)
    terms = value_terms(measured.scene, measured.bands, measured.values, traced.binned)
    return tuple(() if term is None else (term,) for term in terms)
