"""Fit data whose scatter depends on the answer: weights frozen, solved, renewed.

Damped Fisher scoring of one band's problem, and what a fit leaves for the next band.

The paper's searches and Gauss-Newton behind one face: free vector in, better free vector out.

Where to begin: one absorption for all walls, from the decay, and random points.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.special import digamma, polygamma

from roomfit.objective.parameters import (
    Marginal,
    Parameters,
    marginal_information,
    prior_residuals,
    start_vector,
    to_free,
)
from roomfit.objective.problem import BandProblem, Prediction
from roomfit.solvers.search import anneal, downhill_simplex, simplex_around
from roomfit.typing import FloatArray, Progress

_LOWEST, _HIGHEST = 0.02, 0.98


def decay_rate_per_s(energy: FloatArray, edges_s: FloatArray) -> float:
    """Return the rate k of the decay ``exp(-k t)`` that window energies follow.

    The slope of the backward-integrated energy between 5 and 25 dB below its start, or over all
    windows where those are fewer than three.

    Parameters
    ----------
    energy : float array, shape (n_windows,)
        Energy of each window, any unit, not all zero.
    edges_s : float array, shape (n_windows + 1,)
        Rising window edges.

    Returns
    -------
    float
        1/s; 0 where the energy does not fall.

    Notes
    -----
    Backward integration after M. R. Schroeder, "New method of measuring reverberation time",
    J. Acoust. Soc. Am. 37, 409-412 (1965).
    """
    remaining = np.cumsum(energy[::-1])[::-1]
    alive = remaining > 0.0
    log_energy = np.log(remaining[alive] / remaining[0])
    time_s = edges_s[:-1][alive]
    level_db = 10.0 / np.log(10.0) * log_energy
    usable = (level_db <= -5.0) & (level_db >= -25.0)
    if np.count_nonzero(usable) < 3:
        usable = np.ones_like(usable)
    if np.count_nonzero(usable) < 2:
        return 0.0
    slope = np.polyfit(time_s[usable], log_energy[usable], 1)[0]
    return max(-float(slope), 0.0)


def eyring_absorption(
    decay_rate_per_s: float,
    volume_m3: float,
    surface_m2: float,
    speed_of_sound_m_s: float,
    attenuation_per_m: float = 0.0,
) -> float:
    """Return the absorption which, on all walls alike, gives a decay rate by Eyring's law.

    ``k = c (m - S ln(1 - a) / (4 V))``, kept within 0.02 to 0.98 so that a search can move either
    way.

    Parameters
    ----------
    decay_rate_per_s : float
        Rate k of the energy decay ``exp(-k t)``; 6 ln 10 over the reverberation time.
    volume_m3, surface_m2, speed_of_sound_m_s : float
    attenuation_per_m : float
        Energy attenuation m of the air.

    References
    ----------
    .. [1] C. F. Eyring, "Reverberation time in 'dead' rooms", J. Acoust. Soc. Am. 1,
           217-241 (1930).

    Examples
    --------
    A box of 4 V / S = 4 m and 340 m/s loses half at a hit 85 times a second.

    >>> round(eyring_absorption(85 * np.log(2), 4.0, 4.0, 340.0), 6)
    0.5
    """
    loss_per_m = decay_rate_per_s / speed_of_sound_m_s - attenuation_per_m
    absorption = -np.expm1(-loss_per_m * 4.0 * volume_m3 / surface_m2)
    return float(np.clip(absorption, _LOWEST, _HIGHEST))


def starts(uniform: float, n: int, n_random: int, rng: np.random.Generator) -> FloatArray:
    """Return the uniform start followed by random ones, shape (1 + n_random, n)."""
    return np.concatenate((np.full((1, n), uniform), rng.random((n_random, n))))


ResidualFunction: TypeAlias = Callable[[FloatArray], tuple[FloatArray, FloatArray]]


Solver: TypeAlias = Callable[[ResidualFunction, FloatArray], FloatArray]
"""Residuals with derivative, and a start, shape (n,), to the free vector of least squares."""

# Gains are searched within a factor of e^3, 13 dB, either side of where total energies agree.
_LOG_REACH = 3.0
_FIRST_EDGE = 0.1
_FIRST_DAMPING, _SOLVERS_MOST_DAMPING = 1e-3, 1e10
_MOST_STEPS = 40
_FEW_STEPS = 15
_NEAR = 0.01
# of the sum of squares: a thousandth of what one standard deviation would cost
_LEAST_GAIN = 1e-3


def gauss_newton(
    residuals: ResidualFunction, start: FloatArray, *, most_steps: int = _MOST_STEPS
) -> FloatArray:
    """Solve by damped Gauss-Newton steps with the exact derivative.

    Marquardt's damping [1]_, lowered after a step that helps and raised after one that does not.
    Ends when a step is shorter than a hundredth of a standard deviation, or gains next to nothing.
    Few unknowns and many residuals: normal equations cost a tenth of the singular values that
    scipy's solver takes.

    References
    ----------
    .. [1] D. W. Marquardt, "An algorithm for least-squares estimation of nonlinear parameters",
           J. Soc. Indust. Appl. Math. 11, 431-441 (1963).
    """
    x = np.array(start, dtype=np.float64)
    if not x.size:
        return x
    values, jacobian = residuals(x)
    damping = _FIRST_DAMPING
    for _ in range(most_steps):
        gradient, hessian = jacobian.T @ values, jacobian.T @ jacobian
        scale = np.diag(hessian)
        step = -np.linalg.solve(hessian + damping * np.diag(scale), gradient)
        there, slope_there = residuals(x + step)
        if not there @ there < values @ values:
            damping *= 8.0
            if damping > _SOLVERS_MOST_DAMPING:
                break
            continue
        gain = values @ values - there @ there
        x, values, jacobian = x + step, there, slope_there
        damping *= 0.1
        if step @ hessian @ step < _NEAR**2 or gain < _LEAST_GAIN:
            break
    return x


def few_gauss_newton_steps(residuals: ResidualFunction, start: FloatArray) -> FloatArray:
    """Take steps of `gauss_newton` towards squares whose weights will be renewed anyway."""
    return gauss_newton(residuals, start, most_steps=_FEW_STEPS)


def simplex_solver(parameters: Parameters) -> Solver:
    """Return the paper's downhill simplex, over absorption itself and log gains."""

    def solve(residuals: ResidualFunction, start: FloatArray) -> FloatArray:
        if not start.size:
            return start
        error, first = _in_unit_box(parameters, residuals, start)
        found = downhill_simplex(error, simplex_around(first, _FIRST_EDGE))
        return _from_unit(parameters, found.x)

    return solve


def annealing_solver(parameters: Parameters, rng: np.random.Generator) -> Solver:
    """Return the paper's simulated annealing with its simplex, over absorption and log gains."""

    def solve(residuals: ResidualFunction, start: FloatArray) -> FloatArray:
        if not start.size:
            return start
        error, first = _in_unit_box(parameters, residuals, start)
        return _from_unit(parameters, anneal(error, first.size, rng).x)

    return solve


def _in_unit_box(
    parameters: Parameters, residuals: ResidualFunction, start: FloatArray
) -> tuple[Callable[[FloatArray], float], FloatArray]:
    """Return the sum of squares over the unit box, and the start's place in it."""

    def error(point: FloatArray) -> float:
        r, _ = residuals(_from_unit(parameters, point))
        return float(r @ r)

    return error, _to_unit(parameters, start)


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
            parts.append(1.0 / (1.0 + np.exp(-free)))
        else:
            middle = to_free(block, block.start)[block.fitted]
            parts.append(np.clip(0.5 + 0.5 * (free - middle) / _LOG_REACH, 0.0, 1.0))
    return np.concatenate(parts)


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
    chi2_reduced : float
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
    chi2_reduced: float
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
    neighbours = problem.correlation_length()
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
        new_variance = problem.variance(vector)
        variance = np.sqrt(variance * new_variance) if number >= _HALF_WAY_FROM else new_variance
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


_SCORING_MOST_DAMPING = 1e6
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
    converged = False
    for _ in range(rounds):
        state.renew()
        first = True
        for _ in range(steps):
            moved = state.step()
            if moved <= _SETTLED:
                converged = first
                break
            first = False
        if converged:
            break
    state.renew()
    return _band_fit(state, converged=converged)


class _State:
    """The present point of a search, with frozen weights."""

    def __init__(self, problem: BandProblem, vector: FloatArray) -> None:
        self.problem = problem
        self.vector = vector
        self.measured = problem.measured()
        self.neighbours = problem.correlation_length()
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
        while self.damping < _SCORING_MOST_DAMPING:
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
    whole = marginal_information(fit.information, first)
    information = prior + (whole - prior) / max(fit.chi2_reduced, 1.0)
    return Marginal(np.array(fit.vector[first:]), 0.5 * (information + information.T))
