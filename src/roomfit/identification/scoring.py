"""Damped Fisher scoring of one band's problem, and what a fit leaves for the next band."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.identification.reweighted import BandFit
from roomfit.objective.parameters import prior_residuals
from roomfit.objective.problem import BandProblem, Prediction
from roomfit.typing import FloatArray

_MOST_DAMPING = 1e6
# Of the standard deviation: a step no longer than this ends the search.
_SETTLED = 0.05


def score_band(
    problem: BandProblem, start: FloatArray, *, rounds: int = 4, steps: int = 3
) -> BandFit:
    """Return the answer near a start: weights frozen for a few steps, then renewed.

    Each step solves the normal equations, damped [1]_ until the weighted squares fall.

    Parameters
    ----------
    problem : BandProblem
    start : float array, shape (n_free,)
        Near the answer, for instance that of a coarser model.
    rounds : int
        How often the weights are renewed at most.
    steps : int
        Steps between two renewals at most.

    References
    ----------
    .. [1] D. W. Marquardt, "An algorithm for least-squares estimation of nonlinear parameters",
           J. Soc. Indust. Appl. Math. 11, 431-441 (1963).
    """
    state = _State(problem, np.array(start))
    settled = False
    for _ in range(rounds):
        state.renew()
        first = True
        for _ in range(steps):
            moved = state.step()
            if moved <= _SETTLED:
                settled = first
                break
            first = False
        if settled:
            break
    state.renew()
    return _band_fit(state, converged=settled)


class _State:
    """The present point of a search, with frozen weights."""

    def __init__(self, problem: BandProblem, vector: FloatArray) -> None:
        self.problem = problem
        self.vector = vector
        self.measured = problem.measured()
        self.neighbours = problem.counted_as_one()
        self.prediction: Prediction = problem.predict(vector)
        self.variance = problem.variance(vector)
        self.damping = 1e-3
        self.evaluations = 1

    def renew(self) -> None:
        """Take the weights of the present point."""
        self.variance = self.problem.variance(self.vector)

    def cost(self, vector: FloatArray, prediction: Prediction) -> float:
        prior, _ = prior_residuals(self.problem.parameters, vector)
        r = self.measured - prediction.expected
        return float(0.5 * (r @ (r / (self.neighbours * self.variance)) + prior @ prior))

    def information(self) -> FloatArray:
        """Return the Gauss-Newton Hessian of the cost."""
        _, rows = prior_residuals(self.problem.parameters, self.vector)
        jacobian = self.prediction.jacobian
        weighed = jacobian / (self.neighbours * self.variance)[:, None]
        return np.asarray(jacobian.T @ weighed + rows.T @ rows)

    def step(self) -> float:
        """Take one step that lowers the cost; return its length in standard deviations."""
        prior, rows = prior_residuals(self.problem.parameters, self.vector)
        residual = (self.measured - self.prediction.expected) / (self.neighbours * self.variance)
        downhill = self.prediction.jacobian.T @ residual - rows.T @ prior
        hessian = self.information()
        before = self.cost(self.vector, self.prediction)
        while self.damping < _MOST_DAMPING:
            step = np.linalg.solve(hessian + self.damping * np.diag(np.diag(hessian)), downhill)
            step *= min(1.0, 3.0 / max(float(np.abs(step).max()), 1e-12))
            vector = self.vector + step
            prediction = self.problem.predict(vector)
            self.evaluations += 1
            if self.cost(vector, prediction) <= before:
                self.vector, self.prediction = vector, prediction
                self.damping = max(0.1 * self.damping, 1e-6)
                return float(np.max(np.abs(step) / np.sqrt(np.diag(np.linalg.inv(hessian)))))
            self.damping *= 10.0
        self.damping = 1e-3
        return 0.0


def _band_fit(state: _State, *, converged: bool) -> BandFit:
    information = state.information()
    r = state.measured - state.prediction.expected
    jacobian = state.prediction.jacobian
    data = jacobian.T @ (jacobian / (state.neighbours * state.variance)[:, None])
    spent = float(np.trace(np.linalg.solve(information, data)))
    freedom = max(r.size - spent, 1.0)
    log_likelihood = state.problem.log_likelihood(state.prediction.expected, state.variance)
    return BandFit(
        state.vector,
        state.cost(state.vector, state.prediction),
        float(np.sum(r**2 / state.variance)) / freedom,
        information,
        state.prediction.expected,
        state.variance,
        state.measured,
        float(np.sum(log_likelihood / state.neighbours)),
        state.evaluations,
        converged,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Marginal:
    """What data and prior say of some entries when all others are integrated out.

    Attributes
    ----------
    mean : float array, shape (n,)
    information : float array, shape (n, n)
    """

    mean: FloatArray
    information: FloatArray


def marginal(fit: BandFit, first: int, prior: FloatArray) -> Marginal:
    """Return what one band's fit says of the last entries of its vector, for the next band.

    The Schur complement of the information over all entries before `first`; what the data add to
    the prior is divided by max(phi, 1), since data that the model misses tell less.

    Parameters
    ----------
    first : int
        Where the entries begin; they reach to the end of the vector.
    prior : float array, shape (n, n)
        Information about them before this band, part of the fit's.
    """
    whole = fit.information
    cross = whole[first:, :first]
    schur = whole[first:, first:] - cross @ np.linalg.solve(whole[:first, :first], cross.T)
    told = prior + (schur - prior) / max(fit.phi, 1.0)
    return Marginal(np.array(fit.vector[first:]), 0.5 * (told + told.T))
