"""Reweighted least squares of one band's data, whose variance depends on the answer.

Weights are taken at the present answer, the weighted squares are solved, and the weights updated
until the answer agrees with the last one. What solves the squares is an argument: damped
Gauss-Newton steps, or the searches of Suh's paper. Also: what one band's fit says to the next.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
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
from roomfit.objective.problem import Objective
from roomfit.settings import MAX_ROUNDS
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
_SCORING = MarquardtSettings(
    raised=10.0,
    least_damping=1e-6,
    most_damping=1e6,
    longest_entry=3.0,
    accepts_equal=True,
    entry_sd=0.05,
)


gauss_newton: Solver = partial(levenberg_marquardt, settings=_GAUSS_NEWTON)
"""Damped Gauss-Newton steps, to a hundredth of a standard deviation."""

few_gauss_newton_steps: Solver = partial(
    levenberg_marquardt, settings=replace(_GAUSS_NEWTON, max_trials=15)
)
"""At most 15 of these steps, towards squares whose weights will be updated."""


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


# From this round on updated weights go only half of the way (the geometric mean of old and new),
# since two answers may each lead to the other's.
_HALF_WAY_FROM = 5
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
    previous: FloatArray | None = None  # (n_free,), the answer before the last round
    # (n_free,), standard deviation of the answer if a term of its uncertainty were left out
    costs: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def converged(self) -> bool:
        """Whether the answer no longer moves when the weights are updated."""
        return self.ending.converged


def fit_band(
    objective: Objective,
    solver: Solver = gauss_newton,
    refiner: Solver = few_gauss_newton_steps,
    *,
    start: FloatArray | None = None,
    max_rounds: int = MAX_ROUNDS,
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
    start : float array, shape (n_free,), optional
        Where the first round begins; left out: where the parameters do.
    max_rounds : int
        How often weights are updated at most.

    References
    ----------
    .. [1] P. McCullagh, J. A. Nelder, Generalized Linear Models, 2nd ed., 1989, section 9.2.
    """
    residuals = _Residuals(objective)
    first = start_vector(objective.parameters) if start is None else start
    residuals.compare_logarithms(objective.variance(start_vector(objective.parameters)))
    vector = solver(residuals, first).x
    variance, ending, previous = objective.variance(vector), Ending.OUT_OF_ROUNDS, vector
    for number in range(max_rounds):
        previous = vector
        residuals.weigh(variance)
        found = refiner(residuals, vector)
        vector = found.x
        sd = np.sqrt(np.diag(np.linalg.inv(residuals.information(vector))))
        if progress is not None:
            progress((number + 1) / max_rounds)
        if np.all(np.abs(vector - previous) <= _AGREEMENT_SD * sd):
            # a point that no damping can leave agrees with itself
            is_stuck = found.ending is Ending.OUT_OF_DAMPING
            ending = found.ending if is_stuck else Ending.CONVERGED
            break
        variance = _updated(variance, objective.variance(vector), number)
    if progress is not None:
        progress(1.0)
    return replace(residuals.fit(vector, objective.variance(vector), ending), previous=previous)


def _updated(old: FloatArray, new: FloatArray, number: int) -> FloatArray:
    """Return the variances of the next round."""
    return np.sqrt(old * new) if number >= _HALF_WAY_FROM else new


def score_band(
    objective: Objective, start: FloatArray, *, rounds: int = 4, steps: int = 3
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
    residuals, vector = _Residuals(objective), np.array(start)
    settings, ending = replace(_SCORING, max_steps=steps), Ending.OUT_OF_ROUNDS
    variance, previous = objective.variance(vector), vector
    for number in range(rounds):
        if number:
            variance = _updated(variance, objective.variance(vector), number)
        residuals.weigh(variance)
        found = levenberg_marquardt(residuals, vector, settings)
        previous, vector = vector, found.x
        is_short = found.ending is Ending.CONVERGED and found.steps == 1
        is_stuck = found.ending in (Ending.NO_MORE_PROGRESS, Ending.OUT_OF_DAMPING)
        if is_short or (is_stuck and found.steps == 0):
            ending = found.ending
            break
        settings = replace(settings, damping=_SCORING.damping if is_stuck else found.damping)
    return replace(residuals.fit(vector, objective.variance(vector), ending), previous=previous)


def first_round(objective: Objective, start: FloatArray) -> Minimum:
    """Return where the first round of `fit_band` ends from another start.

    Enough to know whether another start leads elsewhere, for a fraction of a whole fit.
    """
    residuals = _Residuals(objective)
    residuals.compare_logarithms(objective.variance(start_vector(objective.parameters)))
    found = gauss_newton(residuals, start)
    return found._replace(evaluations=residuals.evaluations)


class _Residuals:
    """Residuals of data and prior, each over its standard deviation, and their derivative.

    Remembers the last prediction, so that all that is asked at one point costs one.
    """

    def __init__(self, objective: Objective) -> None:
        self.objective = objective
        self.measured = objective.measured()
        self.neighbours = objective.correlation_length()
        self.evaluations = 0
        self.weigh(np.ones(self.measured.size))
        self._at: FloatArray | None = None

    def __call__(self, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        if self._at is None or not np.array_equal(vector, self._at):
            self._at, self.prediction = np.array(vector), self.objective.predict(vector)
            self.evaluations += 1
        expected, jacobian = self.prediction.expected, self.prediction.jacobian
        positive = np.where(self._logs, expected + self._least, 1.0)
        predicted = np.where(self._logs, np.log(positive), expected)
        prior, prior_rows = prior_residuals(self.objective.parameters, vector)
        rows = -jacobian / (positive * self._sd)[:, None]
        residuals = (self._target - predicted) / self._sd
        return np.concatenate((residuals, prior)), np.concatenate((rows, prior_rows))

    def weigh(self, variance: FloatArray) -> None:
        """Compare data as they are, under a variance of each, shape (n_data,)."""
        self._target, self._sd = self.measured, np.sqrt(self.neighbours * variance)
        self._logs, self._least = np.zeros(self.measured.size, dtype=np.bool_), np.zeros(1)

    def compare_logarithms(self, variance: FloatArray) -> None:
        """Compare energies by their logarithms, everything else as it is.

        The mean of the log of a Gamma variate lies below the log of its mean, by digamma. The
        variance, shape (n_data,), is that where the parameters start.
        """
        self(start_vector(self.objective.parameters))
        logs, expected = self.objective.is_gamma(), self.prediction.expected
        # a window that neither a path nor noise reaches has no logarithm
        least = np.where(logs, 1e-9 * float(expected.max(where=logs, initial=0.0)), 0.0)
        expected = np.where(logs, expected + least, 1.0)
        shape = np.clip(expected**2 / variance, 0.5, 100.0)
        self._sd = np.where(logs, np.sqrt(polygamma(1, shape)), np.sqrt(variance))
        # an empty window says "low", not minus infinity
        floored = np.where(logs, np.maximum(self.measured, 1e-3 * expected), 1.0)
        corrected = np.log(floored) - digamma(shape) + np.log(shape)
        self._target = np.where(logs, corrected, self.measured)
        self._logs, self._least = logs, least

    def information(self, vector: FloatArray) -> FloatArray:
        """Return the information of data and prior under the present weights."""
        self(vector)
        jacobian = self.prediction.jacobian / self._sd[:, None]
        _, prior = prior_residuals(self.objective.parameters, vector)
        return np.asarray(jacobian.T @ jacobian + prior.T @ prior)

    def fit(self, vector: FloatArray, variance: FloatArray, ending: Ending) -> BandFit:
        """Return a fit that ended at a vector, with the variance of that vector."""
        self.weigh(variance)
        information, spread = self.information(vector), self.neighbours * variance
        expected, jacobian = self.prediction.expected, self.prediction.jacobian
        prior, _ = prior_residuals(self.objective.parameters, vector)
        squares = (self.measured - expected) ** 2
        # degrees of freedom: data less the parameters that they, not the prior, determine
        weighted = jacobian / self._sd[:, None]
        spent = float(np.trace(np.linalg.solve(information, weighted.T @ weighted)))
        log_likelihood = self.objective.log_likelihood(expected, variance)
        return BandFit(
            vector,
            float(0.5 * (np.sum(squares / spread) + prior @ prior)),
            float(np.sum(squares / variance)) / max(variance.size - spent, 1.0),
            information,
            expected,
            variance,
            self.measured,
            float(np.sum(log_likelihood / self.neighbours)),
            self.evaluations,
            ending,
        )


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
