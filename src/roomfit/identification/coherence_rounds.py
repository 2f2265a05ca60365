"""Rounds of a partly coherent fit: as places become known, paths become coherent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from roomfit.identification.reweighted import BandFit
from roomfit.identification.scoring import Marginal, marginal, score_band
from roomfit.objective.coherent_geometry import GEOMETRY
from roomfit.objective.parameters import JointPrior, Parameters, position_of
from roomfit.objective.problem import BandProblem
from roomfit.typing import FloatArray

ProblemOf = Callable[[FloatArray | None], BandProblem]
"""Makes the problem whose coherence belongs to a covariance of the fitted geometry."""


@dataclass(frozen=True, slots=True, eq=False)
class CoherentBandFit:
    """The last round's fit.

    Attributes
    ----------
    fit : BandFit
    log_likelihood : float
        Of all data, none counted less than once: compares models of the same data.
    found : Marginal or None
        What this band and those before say of the geometry; None where nothing of it is fitted.
    problem : BandProblem
        With the coherence of the last round.
    """

    fit: BandFit
    log_likelihood: float
    found: Marginal | None
    problem: BandProblem

    @property
    def parameters(self) -> Parameters:
        """The unknowns of the problem."""
        return self.problem.parameters


def geometry_information(parameters: Parameters) -> FloatArray:
    """Return the prior information of the fitted geometry, shape (n, n)."""
    if parameters.joint is not None:
        return parameters.joint.information
    block = next(b for b in parameters.blocks if b.name == GEOMETRY)
    return np.diag(block.prior_sd[block.fitted] ** -2.0)


def fit_in_rounds(
    problem_of: ProblemOf, start: FloatArray, *, rounds: int = 3, covariance: FloatArray | None
) -> CoherentBandFit:
    """Fit, take the coherence that the fit's own geometry permits, and fit again.

    Parameters
    ----------
    problem_of : callable
    start : float array, shape (n_free,)
    rounds : int
        1 or more; one is enough where nothing of the geometry is fitted.
    covariance : float array, shape (n, n), or None
        Of the fitted geometry, for the first round; None takes the prior.
    """
    vector = start
    for _ in range(rounds):
        problem = problem_of(covariance)
        fit = score_band(problem, vector)
        vector = fit.vector
        first = position_of(problem.parameters, GEOMETRY)
        if first == vector.size:
            break
        own = np.linalg.inv(fit.information)[first:, first:]
        covariance = np.asarray(own * max(fit.phi, 1.0))
    each = problem.log_likelihood(fit.expected, fit.variance)
    likelihood = float(each.sum())
    if first == vector.size:
        return CoherentBandFit(fit, likelihood, None, problem)
    found = marginal(fit, first, geometry_information(problem.parameters))
    return CoherentBandFit(fit, likelihood, found, problem)


def without_band(final: Marginal, after: Marginal, before: FloatArray) -> JointPrior:
    """Return what all bands but one say of the geometry, as a prior for that one.

    Parameters
    ----------
    final : Marginal
        What all bands say.
    after : Marginal
        What was known after that band.
    before : float array, shape (n, n)
        Information before it.
    """
    return JointPrior(GEOMETRY, final.mean, final.information - (after.information - before))
