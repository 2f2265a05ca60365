"""Bands fitted one by one, energies also from random starts: do they end in one minimum?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roomfit.base.typing import FloatArray, Progress
from roomfit.fit.simplex import unit_box_solver
from roomfit.materials.priors import MaterialPrior
from roomfit.model.energy import only_energies
from roomfit.model.parameters import (
    physical_values,
    position_of,
    prior_residuals,
    start_vector,
)
from roomfit.model.problem import Objective
from roomfit.settings import Settings
from roomfit.solver import (
    BandFit,
    Solver,
    first_round,
    fit_band,
    gauss_newton,
)
from roomfit.uncertainty.gaussian import (
    FittedBand,
    SharedCovariance,
    Starts,
    absorption_intervals,
    band_estimate,
    prior_only_band,
)

N_STARTS = 3
# Log-likelihoods with priors that differ by less do not decide between two minima.
ALIKE = 2.0
# Of a standard deviation: first rounds end within a hundredth of where they lead.
_SAME_PLACE = 0.2


def from_random_starts(
    objective: Objective, fit: BandFit, rng: np.random.Generator, number: int = N_STARTS
) -> tuple[BandFit, Starts]:
    """Return the likeliest of a fit and of others from random starts, and whether they agree.

    Starts are drawn evenly over absorption, gains as in the fit. Those whose first round ends where
    that of the usual start does are not followed any further.
    """
    usual = first_round(objective, start_vector(objective.parameters))
    evaluations = fit.evaluations + usual.evaluations
    sd = np.sqrt(np.diag(np.linalg.inv(fit.information)))
    fits = [fit]
    for _ in range(number):
        other = first_round(objective, _random_start(objective, fit, rng))
        alike = bool(np.all(np.abs(other.x - usual.x) <= _SAME_PLACE * sd))
        fits.append(fit if alike else fit_band(objective, start=other.x))
        evaluations += other.evaluations + (0 if alike else fits[-1].evaluations)
    priors = [prior_residuals(objective.parameters, f.vector)[0] for f in fits]
    worth = [f.log_likelihood - 0.5 * float(p @ p) for f, p in zip(fits, priors, strict=True)]
    best = int(np.argmax(worth))
    # rounding and rounds of weights are no better answer
    best = best if worth[best] > worth[0] + 0.05 else 0
    found = absorption_intervals(
        objective.parameters, fits[best].vector, fits[best].information, fits[best].chi2_reduced
    )
    absorptions = [physical_values(objective.parameters, f.vector)[0]["absorption"] for f in fits]
    within = [bool(np.all((p >= found.lower95) & (p <= found.upper95))) for p in absorptions]
    losses = [worth[best] - w for w in worth]
    others = [i for i in range(len(fits)) if not within[i] and losses[i] < ALIKE]
    nearest = min(others, key=lambda i: losses[i], default=None)
    return replace(fits[best], evaluations=evaluations), Starts(
        number,
        sum(within) - 1,
        None if nearest is None else absorptions[nearest],
        0.0 if nearest is None else float(losses[nearest]),
    )


def _random_start(objective: Objective, fit: BandFit, rng: np.random.Generator) -> FloatArray:
    start, first = np.array(fit.vector), position_of(objective.parameters, "absorption")
    block = next(b for b in objective.parameters.blocks if b.name == "absorption")
    share = rng.uniform(0.02, 0.98, int(np.count_nonzero(block.fitted)))
    start[first : first + share.size] = np.log(share) - np.log1p(-share)
    return start


def fitted_band(
    band: int,
    objective: Objective | None,
    priors: tuple[MaterialPrior, ...],
    settings: Settings,
    progress: Progress | None = None,
    shared_covariance: SharedCovariance | None = None,
) -> FittedBand:
    """Return a band with its fit; without data, with its prior."""
    if objective is None:
        return FittedBand(prior_only_band(priors, band))
    method, seed = settings.method, settings.seed
    starts: Starts | None = None
    model = "energy" if objective.is_gamma().any() else "values"
    solver: Solver = gauss_newton
    if method in ("simplex", "annealing"):
        solver = unit_box_solver(objective.parameters, method, np.random.default_rng(seed))
    fit = fit_band(objective, solver, max_rounds=settings.max_rounds, progress=progress)
    if method == "auto" and fit.vector.size and only_energies(objective) is not None:
        fit, starts = from_random_starts(
            objective, fit, np.random.default_rng(seed), settings.n_random_starts
        )
    noisy = fit if shared_covariance is None else shared_covariance(band, objective, fit)
    own = band_estimate(objective.parameters, noisy, model)
    return FittedBand(replace(own, starts=starts), objective, fit)
