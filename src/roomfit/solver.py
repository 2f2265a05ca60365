"""Least squares: damped steps, reweighted rounds of one band's data, and how a descent ended.

Squares of logarithms are solved first, by damped Gauss-Newton steps or by another search. Then
every step of scoring renews the weights, whose variance depends on the answer, until what is left
to go is short. Also: what one band's fit says to the next.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np
from scipy.special import digamma, polygamma

from roomfit.base.typing import FloatArray, Progress
from roomfit.model.parameters import Marginal, marginal_information, prior_residuals, start_vector
from roomfit.model.problem import Objective, Prediction
from roomfit.settings import MAX_ROUNDS


class Ending(Enum):
    """Why a minimisation stopped, whether that is convergence, and what to do about it.

    Converged says that the method met its own test; the minimum may still be a local one.
    """

    CONVERGED = (
        "converged",
        True,
        "The last step changed less than the tolerance. It may be a local minimum: start again "
        "elsewhere and compare.",
    )
    NO_MORE_PROGRESS = (
        "no-more-progress",
        True,
        "No step lowers the cost, and its curvature promises less than the tolerance: the answer "
        "is as exact as rounding permits.",
    )
    COLLAPSED = (
        "simplex-collapsed",
        True,
        "The simplex became too small to change before its test was met, as happens where the "
        "lowest error is 0; the point is as exact as numbers allow.",
    )
    OUT_OF_STEPS = (
        "steps-used-up",
        False,
        "The cost still fell when the steps allowed were used up: allow more, or fix parameters "
        "that the data do not determine.",
    )
    OUT_OF_ROUNDS = (
        "rounds-used-up",
        False,
        "The answer still moved after as many rounds of updated weights or corrections as are "
        "allowed: look for outliers, or fix parameters that the data do not determine.",
    )
    OUT_OF_EVALUATIONS = (
        "evaluations-used-up",
        False,
        "The search still moved when the evaluations allowed were used up: allow more, start again "
        "from its best point, or use least squares.",
    )
    OUT_OF_DAMPING = (
        "damping-used-up",
        False,
        "No step along the gradient lowers the cost, however short, although its curvature "
        "promises more than the tolerance: the derivative does not belong to the residuals, or "
        "they are not smooth here.",
    )

    def __init__(self, code: str, converged: bool, advice: str) -> None:
        self.code = code
        self.converged = converged
        self.advice = advice


ResidualFunction: TypeAlias = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Residuals, shape (n_rows,), and their derivative, shape (n_rows, n), at a point, shape (n,)."""


@dataclass(frozen=True, slots=True)
class MarquardtSettings:
    """How steps are damped, and which step is the last.

    A step solves ``(H + damping diag(H)) step = -gradient`` with ``H = J^T J``. The first one that
    meets one of the three tests of convergence ends the descent; a test of 0 is never met.
    """

    max_trials: int = 40  # steps tried, whether they help or not
    damping: float = 1e-3  # of the first step
    lowered: float = 0.1  # factor on the damping after a step that helps
    raised: float = 8.0  # and after one that does not
    least_damping: float = 0.0
    most_damping: float = 1e10
    ridge: float = 0.0  # share of the mean of diag(H) added to it before it is damped
    longest_entry: float = math.inf  # a longer step is shortened, all entries alike
    # converged: ...
    length_sd: float = 0.0  # root of step' H step, a length in standard deviations, below this
    gain: float = 0.0  # the cost fell by less
    relative_gain: float = 0.0  # the cost fell by less than this share of it
    # a step that does not help is the last where it promised at most this share of the cost
    least_promise: float = 0.0


class Minimum(NamedTuple):
    """Where a descent ended, and how."""

    x: FloatArray  # (n,)
    cost: float  # half the sum of squares
    evaluations: int
    ending: Ending
    normal: FloatArray = np.empty((0, 0))  # J^T J at x, undamped; (0, 0) without derivative


def levenberg_marquardt(
    residuals: ResidualFunction, start: FloatArray, settings: MarquardtSettings
) -> Minimum:
    """Return a local minimum of the sum of squares [1]_.

    Running out of damping is convergence only where a Gauss-Newton step from there would pass the
    test of convergence: rounding then leaves nothing to gain. Otherwise the derivative is wrong.

    Shapes: `start` (n,).

    References
    ----------
    .. [1] D. W. Marquardt, "An algorithm for least-squares estimation of nonlinear parameters",
           J. Soc. Indust. Appl. Math. 11, 431-441 (1963).
    """
    x = np.array(start, dtype=np.float64)
    values, jacobian = residuals(x)
    cost, damping = 0.5 * float(values @ values), settings.damping
    gradient, normal = jacobian.T @ values, jacobian.T @ jacobian
    trials = 0

    def ended(ending: Ending) -> Minimum:
        return Minimum(x, cost, 1 + trials, ending, normal)

    if not x.size:
        return ended(Ending.CONVERGED)
    while trials < settings.max_trials:
        step = _damped_step(normal, gradient, damping, settings)
        values, jacobian = residuals(x + step)
        trials += 1
        there = 0.5 * float(values @ values)
        if there < cost:
            last = _is_last(step, normal, cost - there, cost, settings)
            x, cost = x + step, there
            gradient, normal = jacobian.T @ values, jacobian.T @ jacobian
            damping = max(settings.lowered * damping, settings.least_damping)
            if last:
                return ended(Ending.CONVERGED)
            continue
        damping *= settings.raised
        promises_little = -float(gradient @ step) <= settings.least_promise * cost
        if damping >= settings.most_damping or promises_little:
            newton = _damped_step(normal, gradient, settings.damping, settings)
            promised = -0.5 * float(gradient @ newton)
            exact = _is_last(newton, normal, promised, cost, settings)
            return ended(Ending.NO_MORE_PROGRESS if exact else Ending.OUT_OF_DAMPING)
    return ended(Ending.OUT_OF_STEPS)


def _damped_step(
    normal: FloatArray, gradient: FloatArray, damping: float, settings: MarquardtSettings
) -> FloatArray:
    scale = np.diag(normal)
    if settings.ridge:
        scale = scale + settings.ridge * np.trace(normal) / len(normal)
    step = -np.linalg.solve(normal + damping * np.diag(scale), gradient)
    if math.isfinite(settings.longest_entry):
        step *= min(1.0, settings.longest_entry / max(float(np.abs(step).max()), 1e-12))
    return np.asarray(step, dtype=np.float64)


def _is_last(
    step: FloatArray, normal: FloatArray, gain: float, cost: float, settings: MarquardtSettings
) -> bool:
    """Whether a step meets one of the tests of convergence."""
    if gain < settings.gain or gain < settings.relative_gain * cost:
        return True
    return float(step @ normal @ step) < settings.length_sd**2


Solver: TypeAlias = Callable[[ResidualFunction, FloatArray], Minimum]
"""Residuals with derivative, and a start, shape (n,), to a minimum of their squares."""

# Few unknowns and many residuals: normal equations cost a tenth of the singular values that
# scipy's solver takes. Steps from far away are longer than logarithms are straight.
_ROUGHLY = MarquardtSettings(length_sd=1.0, gain=0.5, longest_entry=2.0)
_EXACTLY = replace(_ROUGHLY, length_sd=0.01, gain=0.5e-3)

gauss_newton: Solver = partial(levenberg_marquardt, settings=_ROUGHLY)
"""Damped Gauss-Newton steps, to a standard deviation: what follows does the rest."""


# Of the standard deviation, misfit included. A fit ends where absorptions are so near to where they
# lead, and where squares under the weights at hand would move nothing by more than the second.
_SETTLED_SD, _AGREEMENT_SD = 0.02, 0.1
# Enough to compare models: a few hundredths of a log-likelihood.
COMPARED_SD = 0.1
_FIRST_DAMPING, _MOST_DAMPING, _LONGEST_STEP = 0.01, 1e8, 3.0
# A step is taken where it gains this share of what it promises.
_LEAST_GAIN = 1e-3


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
    previous: FloatArray | None = None  # (n_free,), the answer before the last step

    @property
    def converged(self) -> bool:
        """Whether the answer no longer moves although weights are renewed."""
        return self.ending.converged


def fit_band(
    objective: Objective,
    solver: Solver = gauss_newton,
    *,
    start: FloatArray | None = None,
    max_rounds: int = MAX_ROUNDS,
    settled_sd: float | None = None,
    progress: Progress | None = None,
) -> BandFit:
    """Return the most likely values of one band's unknowns.

    Logarithms of energies are compared first, which converges from any start. `score_band` goes on
    from there with the energies themselves.

    Shapes: `start` (n_free,).
    """
    first = start_vector(objective.parameters) if start is None else start
    logarithms = _Logarithms(objective)
    vector = solver(logarithms, first).x
    if progress is not None:
        progress(0.5)
    fit = score_band(objective, vector, max_rounds=max_rounds, settled_sd=settled_sd)
    if progress is not None:
        progress(1.0)
    return replace(fit, evaluations=logarithms.evaluations + fit.evaluations)


def score_band(
    objective: Objective,
    start: FloatArray,
    *,
    max_rounds: int = MAX_ROUNDS,
    settled_sd: float | None = None,
) -> BandFit:
    """Return the answer near a start, such as that of a coarser model, by Fisher scoring.

    Solved are the quasi-likelihood equations [1]_: the weighted residuals, their weights those at
    the answer itself, have no slope. A variance that moved inside a minimised sum would reward
    predictions that are large and uncertain. Each step solves ``(H + C + damping diag(H)) step =
    -slope``, H the information under the weights at hand; C is what earlier steps have shown of how
    the slope changes beyond H, since weights follow the answer [2]_. A step counts as gain what the
    squares fall by under the geometric mean of the variances at both of its ends, the
    quasi-likelihood itself to the third order where the variance goes with the square of the mean.
    Back and forth gains 0, so that no two answers can each lead to the other. The damping follows
    the share of the promised gain that came true [3]_.

    Shapes: `start` (n_free,).

    References
    ----------
    .. [1] R. W. M. Wedderburn, "Quasi-likelihood functions, generalized linear models, and the
           Gauss-Newton method", Biometrika 61, 439-447 (1974).
    .. [2] C. G. Broyden, "A class of methods for solving nonlinear simultaneous equations", Math.
           Comp. 19, 577-593 (1965).
    .. [3] H. B. Nielsen, "Damping parameter in Marquardt's method", IMM-REP-1999-05, Technical
           University of Denmark (1999).
    """
    at = _Weighed.at(objective, np.array(start, dtype=np.float64))
    names = [b.name for b in objective.parameters.blocks for _ in range(int(b.fitted.sum()))]
    settled_sd = _SETTLED_SD if settled_sd is None else settled_sd
    agreement_sd = max(_AGREEMENT_SD, settled_sd)
    within = np.where(np.array(names) == "absorption", settled_sd, agreement_sd)
    none = np.zeros_like(at.information)
    previous, more, damping, raised = at.vector, none, _FIRST_DAMPING, 2.0
    for number in range(max_rounds + 1):
        agrees = bool(np.all(at.left_sd(none) <= agreement_sd))
        if agrees and np.all(at.left_sd(more) <= within):
            return at.fit(Ending.CONVERGED, number + 1, previous)
        if number == max_rounds or damping > _MOST_DAMPING:
            break
        step = at.step(more, damping)
        if at.slope @ step >= 0.0:  # what was learned on the way is of no use here
            more = none
            step = at.step(more, damping)
        there = _Weighed.at(objective, at.vector + step)
        downhill = -float(at.slope @ step)
        promised = downhill - 0.5 * float(step @ (at.information + more) @ step)
        share = at.gain(there) / max(promised, 0.25 * downhill)
        along = 0.5 * (at.information + there.information) @ step
        beyond = there.slope - at.slope - along - more @ step
        more = more + np.outer(beyond, along) / float(along @ step)
        if share > _LEAST_GAIN:
            previous, at, raised = at.vector, there, 2.0
            damping *= max(1.0 / 3.0, 1.0 - (2.0 * share - 1.0) ** 3)
        else:
            damping, raised = max(raised * damping, _FIRST_DAMPING), 2.0 * raised
    ending = Ending.NO_MORE_PROGRESS if agrees else Ending.OUT_OF_DAMPING
    return at.fit(
        Ending.OUT_OF_ROUNDS if damping <= _MOST_DAMPING else ending, number + 1, previous
    )


class _Weighed(NamedTuple):
    """Data of a band predicted at one point, under the variances that they have there."""

    objective: Objective
    vector: FloatArray  # (n_free,)
    prediction: Prediction
    variance: FloatArray  # (n_data,)
    spread: FloatArray  # (n_data,), variance times the number of neighbours that count as one
    off: FloatArray  # (n_data,), measured minus expected
    prior: FloatArray  # residuals of the prior
    slope: FloatArray  # (n_free,), of half the squares
    information: FloatArray  # (n_free, n_free), of data and prior
    chi2_reduced: float

    @classmethod
    def at(cls, objective: Objective, vector: FloatArray) -> _Weighed:
        """Return what is asked at a point, each part of the response evaluated once."""
        prediction = objective.predict(vector)
        variance = objective.variance(vector)
        off = objective.measured() - prediction.expected
        spread = objective.correlation_length() * variance
        prior, rows = prior_residuals(objective.parameters, vector)
        weighted = prediction.jacobian / spread[:, None]
        data = prediction.jacobian.T @ weighted
        information = np.asarray(data + rows.T @ rows)
        # degrees of freedom: data less the parameters that they, not the prior, determine
        spent = float(np.trace(np.linalg.solve(information, data)))
        return cls(
            objective,
            vector,
            prediction,
            variance,
            spread,
            off,
            prior,
            rows.T @ prior - weighted.T @ off,
            information,
            float(np.sum(off**2 / variance)) / max(variance.size - spent, 1.0),
        )

    def step(self, more: FloatArray, damping: float) -> FloatArray:
        """Return a damped step, no entry longer than `_LONGEST_STEP`."""
        scale = damping * np.diag(np.diag(self.information))
        step = -np.linalg.solve(self.information + more + scale, self.slope)
        return np.asarray(step * min(1.0, _LONGEST_STEP / max(np.abs(step).max(), 1e-12)))

    def left_sd(self, more: FloatArray) -> FloatArray:
        """Return how far each number would go undamped, in its standard deviations, (n_free,)."""
        variance = np.diag(np.linalg.inv(self.information)) * max(self.chi2_reduced, 1.0)
        left = np.linalg.solve(self.information + more, self.slope)
        return np.asarray(np.abs(left) / np.sqrt(variance))

    def gain(self, there: _Weighed) -> float:
        """Return what half the squares fall by, under the mean of the variances at both ends."""
        weight = 1.0 / np.sqrt(self.spread * there.spread)
        data = float(np.sum(weight * (self.off - there.off) * (self.off + there.off)))
        return 0.5 * (data + float(self.prior @ self.prior - there.prior @ there.prior))

    def fit(self, ending: Ending, evaluations: int, previous: FloatArray) -> BandFit:
        """Return a fit that ended here."""
        expected, objective = self.prediction.expected, self.objective
        log_likelihood = objective.log_likelihood(expected, self.variance)
        return BandFit(
            self.vector,
            0.5 * float(np.sum(self.off**2 / self.spread) + self.prior @ self.prior),
            self.chi2_reduced,
            self.information,
            expected,
            self.variance,
            objective.measured(),
            float(np.sum(log_likelihood / objective.correlation_length())),
            evaluations,
            ending,
            previous,
        )


def first_round(objective: Objective, start: FloatArray) -> Minimum:
    """Return where the first squares of `fit_band`, of logarithms, end from another start.

    Enough to know whether another start leads elsewhere, for a fraction of a whole fit.
    """
    residuals = _Logarithms(objective)
    found = levenberg_marquardt(residuals, start, _EXACTLY)
    return found._replace(evaluations=residuals.evaluations)


class _Logarithms:
    """Residuals of data and prior with derivative, energies compared by their logarithms.

    Everything else is compared as it is. The mean of the log of a Gamma variate lies below the log
    of its mean, by digamma. The variance is that where the parameters start. Remembers the last
    prediction, since the start is asked for twice.
    """

    def __init__(self, objective: Objective) -> None:
        self.objective, self.evaluations = objective, 0
        start, measured = start_vector(objective.parameters), objective.measured()
        variance, logs = objective.variance(start), objective.is_gamma()
        self._at, self._prediction = np.array(start), objective.predict(start)
        self.evaluations, expected = 1, self._prediction.expected
        # a window that neither a path nor noise reaches has no logarithm
        least = np.where(logs, 1e-9 * float(expected.max(where=logs, initial=0.0)), 0.0)
        expected = np.where(logs, expected + least, 1.0)
        shape = np.clip(expected**2 / variance, 0.5, 100.0)
        self._sd = np.where(logs, np.sqrt(polygamma(1, shape)), np.sqrt(variance))
        # an empty window says "low", not minus infinity
        floored = np.where(logs, np.maximum(measured, 1e-3 * expected), 1.0)
        corrected = np.log(floored) - digamma(shape) + np.log(shape)
        self._target = np.where(logs, corrected, measured)
        self._logs, self._least = logs, least

    def __call__(self, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        if not np.array_equal(vector, self._at):
            self._at, self._prediction = np.array(vector), self.objective.predict(vector)
            self.evaluations += 1
        prediction = self._prediction
        positive = np.where(self._logs, prediction.expected + self._least, 1.0)
        predicted = np.where(self._logs, np.log(positive), prediction.expected)
        prior, prior_rows = prior_residuals(self.objective.parameters, vector)
        rows = -prediction.jacobian / (positive * self._sd)[:, None]
        residuals = (self._target - predicted) / self._sd
        return np.concatenate((residuals, prior)), np.concatenate((rows, prior_rows))


def marginal(fit: BandFit, first: int, prior: FloatArray) -> Marginal:
    """Return what one band's fit says of the last entries of its vector, for the next band.

    The Schur complement of the information over all entries before `first`; what the data add to
    the prior is divided by max(phi, 1), since data that the model misses say less.

    Shapes: `prior` (n, n).
    """
    whole = marginal_information(fit.information, first)
    information = prior + (whole - prior) / max(fit.chi2_reduced, 1.0)
    return Marginal(np.array(fit.vector[first:]), 0.5 * (information + information.T))
