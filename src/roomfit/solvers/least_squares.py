"""Reweighted least squares of one band's data, whose variance depends on the answer.

Weights are taken at the present answer, the weighted squares are solved, and the weights updated
until the answer agrees with the last one. What solves the squares is an argument: damped
Gauss-Newton steps, or the searches of Suh's paper. Also: what one band's fit says to the next.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from scipy.special import digamma, polygamma

from roomfit.logit import expit
from roomfit.objective.parameters import (
    Marginal,
    Parameters,
    marginal_information,
    prior_residuals,
    start_vector,
    to_free,
)
from roomfit.objective.problem import BandProblem, Prediction
from roomfit.solvers.ending import Ending
from roomfit.solvers.levenberg_marquardt import (
    MarquardtSettings,
    Minimum,
    ResidualFunction,
    levenberg_marquardt,
)
from roomfit.solvers.search import Fit, anneal, downhill_simplex, simplex_around
from roomfit.typing import FloatArray, Progress

Solver: TypeAlias = Callable[[ResidualFunction, FloatArray], Minimum]
"""Residuals with derivative, and a start, shape (n,), to a minimum of their squares."""

# Gains are searched within a factor of e^3, 13 dB, either side of where total energies agree.
_LOG_REACH = 3.0
_FIRST_EDGE = 0.1
# Few unknowns and many residuals: normal equations cost a tenth of the singular values that
# scipy's solver takes. The gain is a thousandth of what one standard deviation would cost.
_GAUSS_NEWTON = MarquardtSettings(length_sd=0.01, gain=0.5e-3)
_FEW_GAUSS_NEWTON = replace(_GAUSS_NEWTON, max_trials=15)
_SCORING = MarquardtSettings(
    raised=10.0,
    least_damping=1e-6,
    most_damping=1e6,
    longest_entry=3.0,
    accepts_equal=True,
    entry_sd=0.05,
)


def gauss_newton(residuals: ResidualFunction, start: FloatArray) -> Minimum:
    """Return the minimum that damped Gauss-Newton steps lead to, to a hundredth of its sd."""
    return levenberg_marquardt(residuals, start, _GAUSS_NEWTON)


def few_gauss_newton_steps(residuals: ResidualFunction, start: FloatArray) -> Minimum:
    """Take at most 15 steps of `gauss_newton` towards squares whose weights will be updated."""
    return levenberg_marquardt(residuals, start, _FEW_GAUSS_NEWTON)


def simplex_solver(parameters: Parameters) -> Solver:
    """Return the paper's downhill simplex, over absorption itself and log gains."""
    return _unit_box_solver(
        parameters, lambda error, x: downhill_simplex(error, simplex_around(x, _FIRST_EDGE))
    )


def annealing_solver(parameters: Parameters, rng: np.random.Generator) -> Solver:
    """Return the paper's simulated annealing with its simplex, over absorption and log gains."""
    return _unit_box_solver(parameters, lambda error, x: anneal(error, x.size, rng))


def _unit_box_solver(
    parameters: Parameters, search: Callable[[Callable[[FloatArray], float], FloatArray], Fit]
) -> Solver:
    """Return a solver that searches the sum of squares over the unit box."""

    def solve(residuals: ResidualFunction, start: FloatArray) -> Minimum:
        if not start.size:
            return Minimum(start, 0.0, 0, Ending.CONVERGED)

        def error(point: FloatArray) -> float:
            r, _ = residuals(_from_unit(parameters, point))
            return float(r @ r)

        found = search(error, _to_unit(parameters, start))
        x = _from_unit(parameters, found.x)
        return Minimum(x, 0.5 * found.cost, found.evaluations, found.ending)

    return solve


def _from_unit(parameters: Parameters, point: FloatArray) -> FloatArray:
    """Map the unit box: absorption between its bounds, evenly; gains evenly in logarithm."""
    parts, position = [], 0
    for block in parameters.blocks:
        n = int(np.count_nonzero(block.fitted))
        share = point[position : position + n]
        position += n
        if block.transform == "logit":
            values = np.array(block.start)
            low, high = block.lower[block.fitted], block.upper[block.fitted]
            values[block.fitted] = low + (high - low) * share
            parts.append(to_free(block, values)[block.fitted])
        else:
            middle = to_free(block, block.start)[block.fitted]
            parts.append(middle + _LOG_REACH * (2.0 * share - 1.0))
    return np.concatenate(parts)


def _to_unit(parameters: Parameters, vector: FloatArray) -> FloatArray:
    parts, position = [], 0
    for block in parameters.blocks:
        n = int(np.count_nonzero(block.fitted))
        free = vector[position : position + n]
        position += n
        if block.transform == "logit":
            parts.append(expit(free))
        else:
            middle = to_free(block, block.start)[block.fitted]
            parts.append(np.clip(0.5 + 0.5 * (free - middle) / _LOG_REACH, 0.0, 1.0))
    return np.concatenate(parts)


# Of updated weights; from this round on they go only half of the way, since two answers may each
# lead to the other's.
_MOST_ROUNDS, _HALF_WAY_FROM = 12, 5
# Of the standard deviation: two rounds whose answers differ by less agree.
_AGREEMENT_SD = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class BandFit:
    """Best free vector of one band, how it was found, and what is needed for its uncertainty."""

    vector: FloatArray  # (n_free,)
    cost: float  # half the sum of squared weighted residuals and prior residuals
    # Pearson's chi-square over the degrees of freedom: 1 where the noise model holds, above 2 where
    # the model does not explain the data
    chi2_reduced: float
    information: FloatArray  # (n_free, n_free), Gauss-Newton Hessian of the cost, with the prior
    expected: FloatArray  # (n_data,)
    variance: FloatArray  # (n_data,)
    measured: FloatArray  # (n_data,)
    # of all data under their own laws, with every constant, neighbours that share information
    # counted once: compares models of the same data
    log_likelihood: float
    evaluations: int  # how often the response was weighed with its derivative
    ending: Ending

    @property
    def converged(self) -> bool:
        """Whether the answer no longer moves when the weights are updated."""
        return self.ending.converged


def fit_band(
    problem: BandProblem,
    solver: Solver,
    refiner: Solver,
    *,
    progress: Progress | None = None,
) -> BandFit:
    """Return the most likely values of one band's unknowns.

    The first round compares logarithms of energies, which converges from any start. Each further
    round takes the variances at the last answer, keeps them, and solves the weighted squares:
    letting the variance move inside a step rewards predictions that are large and uncertain. The
    result solves the quasi-likelihood equations of a Gamma-like law (variance proportional to the
    mean squared) [1]_. Converged where two rounds agree within a tenth of a standard deviation.

    Parameters
    ----------
    solver, refiner : Solver
        Minimise the first round's squares, and those of the rounds that follow.

    References
    ----------
    .. [1] P. McCullagh, J. A. Nelder, Generalized Linear Models, 2nd ed., 1989, section 9.2.
    """
    counter = _Counter(problem)
    vector = solver(_first_squares(counter), start_vector(problem.parameters)).x
    variance, ending = problem.variance(vector), Ending.OUT_OF_ROUNDS
    for number in range(_MOST_ROUNDS):
        previous, spread = vector, counter.neighbours * variance
        found = refiner(_weighted_squares(counter, spread), vector)
        vector = found.x
        sd = np.sqrt(np.diag(np.linalg.inv(_information(counter, spread, vector))))
        if progress is not None:
            progress((number + 1) / _MOST_ROUNDS)
        if np.all(np.abs(vector - previous) <= _AGREEMENT_SD * sd):
            # a point that no damping can leave agrees with itself
            is_stuck = found.ending is Ending.OUT_OF_DAMPING
            ending = found.ending if is_stuck else Ending.CONVERGED
            break
        new = problem.variance(vector)
        variance = np.sqrt(variance * new) if number >= _HALF_WAY_FROM else new
    if progress is not None:
        progress(1.0)
    return _band_fit(counter, vector, ending)


def score_band(
    problem: BandProblem, start: FloatArray, *, rounds: int = 4, steps: int = 3
) -> BandFit:
    """Return the answer near a start, such as that of a coarser model, by Fisher scoring.

    Weights are kept for a few steps, then updated; the damping goes on from round to round.
    Converged where the first step after weights were updated is already short.

    Parameters
    ----------
    start : float array, shape (n_free,)
    rounds : int
        How often the weights are updated at most.
    steps : int
        Steps between two renewals at most.
    """
    counter = _Counter(problem)
    vector = np.array(start)
    settings, ending = replace(_SCORING, max_steps=steps), Ending.OUT_OF_ROUNDS
    for _ in range(rounds):
        squares = _weighted_squares(counter, counter.neighbours * problem.variance(vector))
        found = levenberg_marquardt(squares, vector, settings)
        vector = found.x
        is_short = found.ending is Ending.CONVERGED and found.steps == 1
        is_stuck = found.ending in (Ending.NO_MORE_PROGRESS, Ending.OUT_OF_DAMPING)
        if is_short or (is_stuck and found.steps == 0):
            ending = found.ending
            break
        settings = replace(settings, damping=_SCORING.damping if is_stuck else found.damping)
    return _band_fit(counter, vector, ending)


def _band_fit(counter: _Counter, vector: FloatArray, ending: Ending) -> BandFit:
    """Return a fit that ended at a vector, with the weights of that vector."""
    problem, measured = counter.problem, counter.measured
    variance, prediction = problem.variance(vector), counter.predict(vector)
    spread = counter.neighbours * variance
    prior, _ = prior_residuals(problem.parameters, vector)
    information = _information(counter, spread, vector)
    squares = (measured - prediction.expected) ** 2
    log_likelihood = problem.log_likelihood(prediction.expected, variance)
    return BandFit(
        vector,
        float(0.5 * (np.sum(squares / spread) + prior @ prior)),
        float(np.sum(squares / variance)) / _freedom(prediction, spread, information),
        information,
        prediction.expected,
        variance,
        measured,
        float(np.sum(log_likelihood / counter.neighbours)),
        counter.evaluations,
        ending,
    )


def first_round(problem: BandProblem, solver: Solver, start: FloatArray) -> Minimum:
    """Return where the first round of `fit_band` ends from another start.

    Enough to know whether another start leads elsewhere, for a fraction of a whole fit.
    """
    counter = _Counter(problem)
    found = solver(_first_squares(counter), start)
    return found._replace(evaluations=counter.evaluations)


class _Counter:
    """Remembers the last prediction, so that residuals and Jacobian cost one weighing."""

    def __init__(self, problem: BandProblem) -> None:
        self.problem = problem
        self.measured = problem.measured()
        self.neighbours = problem.correlation_length()
        self.evaluations = 0
        self._last: tuple[FloatArray, Prediction] | None = None

    def predict(self, vector: FloatArray) -> Prediction:
        if self._last is None or not np.array_equal(vector, self._last[0]):
            self._last = (np.array(vector), self.problem.predict(vector))
            self.evaluations += 1
        return self._last[1]


def _first_squares(counter: _Counter) -> ResidualFunction:
    """Compare energies by their logarithms, everything else as it is.

    The mean of the log of a Gamma variate lies below the log of its mean, by digamma.
    """
    problem, measured = counter.problem, counter.measured
    start = start_vector(problem.parameters)
    logs = problem.is_gamma()
    expected = counter.predict(start).expected
    variance = problem.variance(start)
    # a window that neither a path nor noise reaches has no logarithm
    least = np.where(logs, 1e-9 * float(expected.max(where=logs, initial=0.0)), 0.0)
    expected = np.where(logs, expected + least, 1.0)
    shape = np.clip(expected**2 / variance, 0.5, 100.0)
    sd = np.where(logs, np.sqrt(polygamma(1, shape)), np.sqrt(variance))
    # an empty window says "low", not minus infinity
    floored = np.where(logs, np.maximum(measured, 1e-3 * expected), 1.0)
    target = np.where(logs, np.log(floored) - digamma(shape) + np.log(shape), measured)

    def squares(vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        prediction = counter.predict(vector)
        prior, prior_rows = prior_residuals(problem.parameters, vector)
        positive = np.where(logs, prediction.expected + least, 1.0)
        predicted = np.where(logs, np.log(positive), prediction.expected)
        rows = -prediction.jacobian / (positive * sd)[:, None]
        residuals = (target - predicted) / sd
        return np.concatenate((residuals, prior)), np.concatenate((rows, prior_rows))

    return squares


def _weighted_squares(counter: _Counter, variance: FloatArray) -> ResidualFunction:
    sd = np.sqrt(variance)

    def squares(vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        prediction = counter.predict(vector)
        prior, prior_rows = prior_residuals(counter.problem.parameters, vector)
        residuals = np.concatenate(((counter.measured - prediction.expected) / sd, prior))
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


def marginal(fit: BandFit, first: int, prior: FloatArray) -> Marginal:
    """Return what one band's fit says of the last entries of its vector, for the next band.

    The Schur complement of the information over all entries before `first`; what the data add to
    the prior is divided by max(phi, 1), since data that the model misses say less.

    Parameters
    ----------
    first : int
        Where the entries begin; they reach to the end of the vector.
    prior : float array, shape (n, n)
        Information about them before this band, part of the fit's.
    """
    whole = marginal_information(fit.information, first)
    information = prior + (whole - prior) / max(fit.chi2_reduced, 1.0)
    return Marginal(np.array(fit.vector[first:]), 0.5 * (information + information.T))
