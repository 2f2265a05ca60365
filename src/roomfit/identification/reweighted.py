"""Fit data whose scatter depends on the answer: weights frozen, solved, renewed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import digamma, polygamma

from roomfit.identification.least_squares import ResidualFunction
from roomfit.identification.solvers import Solver
from roomfit.objective.parameters import prior_residuals, start_vector
from roomfit.objective.problem import BandProblem, Prediction
from roomfit.typing import FloatArray, Progress

MOST_ROUNDS = 12
# From this round on weights go only half of the way: two answers may each lead to the other's.
_HALF_WAY_FROM = 5


@dataclass(frozen=True, slots=True, eq=False)
class BandFit:
    """Best free vector of one band, and what is needed to say how sure it is.

    Attributes
    ----------
    vector : float array, shape (n_free,)
    cost : float
        Half the sum of squared weighted residuals and prior residuals.
    phi : float
        Pearson's chi-square over the degrees of freedom: 1 where the noise model holds, above 2
        where the model does not explain the data.
    information : float array, shape (n_free, n_free)
        Gauss-Newton Hessian of the cost at the answer, prior included.
    expected, variance, measured : float arrays, shape (n_data,)
    log_likelihood : float
        Of all data under their own laws, with every constant, neighbours that share information
        counted once: compares models of the same data.
    evaluations : int
        How often the response was weighed with its derivative.
    converged : bool
        Whether the last two rounds agree within a tenth of the standard deviation.
    """

    vector: FloatArray
    cost: float
    phi: float
    information: FloatArray
    expected: FloatArray
    variance: FloatArray
    measured: FloatArray
    log_likelihood: float
    evaluations: int
    converged: bool


def fit_band(
    problem: BandProblem,
    solver: Solver,
    refiner: Solver,
    *,
    progress: Progress | None = None,
) -> BandFit:
    """Return the most likely values of one band's unknowns.

    The first round compares logarithms of energies, which finds its way from any start. Each
    further round takes the variances at the last answer, holds them fixed, and solves the weighted
    squares: letting the variance move inside a step rewards predictions that are large and
    uncertain. The result solves the quasi-likelihood equations of a Gamma-like law (variance
    proportional to the mean squared) [1]_.

    Parameters
    ----------
    problem : BandProblem
    solver, refiner : Solver
        Minimise the first round's squares, and those of the rounds that follow.

    References
    ----------
    .. [1] P. McCullagh, J. A. Nelder, Generalized Linear Models, 2nd ed., 1989, section 9.2.
    """
    measured = problem.measured()
    neighbours = problem.counted_as_one()
    counter = _Counter(problem)
    vector = solver(_first_squares(counter, measured), start_vector(problem.parameters))
    variance = problem.variance(vector)
    converged = False
    for number in range(MOST_ROUNDS):
        if converged:
            break
        previous = vector
        spread = neighbours * variance
        vector = refiner(_weighted_squares(counter, measured, spread), vector)
        sd = np.sqrt(np.diag(np.linalg.inv(_information(counter, spread, vector))))
        converged = bool(np.all(np.abs(vector - previous) <= 0.1 * sd))
        renewed = problem.variance(vector)
        variance = np.sqrt(variance * renewed) if number >= _HALF_WAY_FROM else renewed
        if progress is not None:
            progress((number + 1) / MOST_ROUNDS)
    variance = problem.variance(vector)
    if progress is not None:
        progress(1.0)
    prediction = counter.predict(vector)
    spread = neighbours * variance
    chi_square = float(np.sum((measured - prediction.expected) ** 2 / variance))
    prior, _ = prior_residuals(problem.parameters, vector)
    information = _information(counter, spread, vector)
    return BandFit(
        vector,
        float(0.5 * (np.sum((measured - prediction.expected) ** 2 / spread) + prior @ prior)),
        chi_square / _freedom(prediction, spread, information),
        information,
        prediction.expected,
        variance,
        measured,
        float(np.sum(problem.log_likelihood(prediction.expected, variance) / neighbours)),
        counter.evaluations,
        converged,
    )


def first_round(problem: BandProblem, solver: Solver, start: FloatArray) -> FloatArray:
    """Return where the first round of `fit_band` ends from another start, shape (n_free,).

    Enough to tell whether another start leads elsewhere, for a fraction of a whole fit.
    """
    return solver(_first_squares(_Counter(problem), problem.measured()), start)


class _Counter:
    """Remembers the last prediction, so that residuals and Jacobian cost one weighing."""

    def __init__(self, problem: BandProblem) -> None:
        self.problem = problem
        self.evaluations = 0
        self._last: tuple[FloatArray, Prediction] | None = None

    def predict(self, vector: FloatArray) -> Prediction:
        if self._last is None or not np.array_equal(vector, self._last[0]):
            self._last = (np.array(vector), self.problem.predict(vector))
            self.evaluations += 1
        return self._last[1]


def _first_squares(counter: _Counter, measured: FloatArray) -> ResidualFunction:
    """Compare energies by their logarithms, everything else as it is.

    The mean of the log of a Gamma variate lies below the log of its mean, by digamma.
    """
    problem = counter.problem
    start = start_vector(problem.parameters)
    logs = problem.are_energies()
    expected = counter.predict(start).expected
    variance = problem.variance(start)
    # a window that neither a path nor noise reaches has no logarithm
    least = np.where(logs, 1e-9 * float(expected.max(where=logs, initial=0.0)), 0.0)
    expected = np.where(logs, expected + least, 1.0)
    shape = np.clip(expected**2 / variance, 0.5, 100.0)
    sd = np.where(logs, np.sqrt(polygamma(1, shape)), np.sqrt(variance))
    # an empty window says "low", not minus infinity
    seen = np.where(logs, np.maximum(measured, 1e-3 * expected), 1.0)
    target = np.where(logs, np.log(seen) - digamma(shape) + np.log(shape), measured)

    def squares(vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        prediction = counter.predict(vector)
        prior, prior_rows = prior_residuals(problem.parameters, vector)
        positive = np.where(logs, prediction.expected + least, 1.0)
        predicted = np.where(logs, np.log(positive), prediction.expected)
        rows = -prediction.jacobian / (positive * sd)[:, None]
        residuals = (target - predicted) / sd
        return np.concatenate((residuals, prior)), np.concatenate((rows, prior_rows))

    return squares


def _weighted_squares(
    counter: _Counter, measured: FloatArray, variance: FloatArray
) -> ResidualFunction:
    sd = np.sqrt(variance)

    def squares(vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        prediction = counter.predict(vector)
        prior, prior_rows = prior_residuals(counter.problem.parameters, vector)
        residuals = np.concatenate(((measured - prediction.expected) / sd, prior))
        return residuals, np.concatenate((-prediction.jacobian / sd[:, None], prior_rows))

    return squares


def _information(counter: _Counter, variance: FloatArray, vector: FloatArray) -> FloatArray:
    jacobian = counter.predict(vector).jacobian / np.sqrt(variance)[:, None]
    _, prior = prior_residuals(counter.problem.parameters, vector)
    return np.asarray(jacobian.T @ jacobian + prior.T @ prior)


def _freedom(prediction: Prediction, variance: FloatArray, information: FloatArray) -> float:
    """Windows less the parameters that the data, not the prior, determine."""
    jacobian = prediction.jacobian / np.sqrt(variance)[:, None]
    spent = float(np.trace(np.linalg.solve(information, jacobian.T @ jacobian)))
    return max(variance.size - spent, 1.0)
