"""Intervals of a fitted band where a Gaussian does not suffice, and draws for predictions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from roomfit.base.logit import Z95, expit
from roomfit.base.typing import FloatArray, IntArray, Progress
from roomfit.model.parameters import (
    Parameters,
    absorption_of,
    leaders,
    physical_values,
    position_of,
    to_free,
    to_physical,
)
from roomfit.model.problem import Objective
from roomfit.solver import BandFit, score_band
from roomfit.uncertainty.gaussian import BandEstimate, FittedBand, MirrorTrial, is_identifiable
from roomfit.uncertainty.population import posterior_draws
from roomfit.uncertainty.profile import may_be_bent, profile
from roomfit.uncertainty.sampling import absorption_columns

# A profile never narrows either side of an interval, in the logit, to less than this of the
# Gaussian's: a skew likelihood halves a side at most in every case examined, and what asks for
# more is rather an error of the weights.
LEAST_SIDE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """What is done to every band after its fit."""

    intervals: str  # of `INTERVALS`
    seed: int
    # of materials, by a symmetry of room and positions: fitted a second time from there
    exchanges: tuple[IntArray, ...] = ()
    n_draws: int = 0  # of the posterior, for predictions
    only_values: bool = False  # whether bands with responses go without draws

    def __call__(self, band: FittedBand, progress: Progress | None = None) -> BandEstimate:
        """Return a band's estimate with better intervals, and what mirror images explain."""
        objective, fit, answer = band.objective, band.fit, band.estimate
        if objective is None or fit is None or fit.vector.size == 0:
            return answer
        trials = tuple(_mirrored(objective, fit, exchange) for exchange in self.exchanges)
        evaluations = answer.evaluations + sum(t.evaluations for t in trials)
        answer = replace(answer, mirrors=trials, evaluations=evaluations)
        if self.n_draws and (answer.model == "values" or not self.only_values):
            rng, parameters = np.random.default_rng(self.seed), objective.parameters
            found = posterior_draws(objective, fit, self.n_draws, rng)
            beyond = _beyond_fit(parameters, fit, answer)
            draws = _absorptions(parameters, found.draws, answer, beyond, rng)
            evaluations = answer.evaluations + found.evaluations
            answer = replace(answer, draws=draws, evaluations=evaluations)
        return INTERVALS[self.intervals](objective, fit, answer, self, progress)


IntervalMethod: TypeAlias = Callable[
    [Objective, BandFit, BandEstimate, Refinement, Progress | None], BandEstimate
]
"""From a band's objective, fit and Gaussian estimate to its estimate with other intervals."""


def profiled(
    objective: Objective,
    fit: BandFit,
    answer: BandEstimate,
    _settings: Refinement | None = None,
    _progress: Progress | None = None,
) -> BandEstimate:
    """Return the answer with profile intervals for the absorptions whose likelihood is skew.

    Weights are kept. An interval of 0 to 1, where the data determine nothing, stays as it is. What
    the Gaussian answer allows for beyond its fit's information, as the noise of the rays, is added
    to either side as one more standard deviation.
    """
    block = absorption_of(objective.parameters)
    first, fitted = absorption_columns(objective.parameters)
    free, sd = to_free(block, answer.absorption), np.sqrt(np.diag(answer.logit_covariance))
    lower, upper = np.array(answer.lower95), np.array(answer.upper95)
    kinds, found = list(answer.kinds), []
    more = np.sqrt(np.diag(_beyond_fit(objective.parameters, fit, answer)))
    prediction = None  # at the answer, the same for all
    for number, own in enumerate(fitted):
        unspecified = (lower[own], upper[own]) == (0.0, 1.0)
        if unspecified or not may_be_bent(fit, first + number):
            continue
        prediction = objective.predict(fit.vector) if prediction is None else prediction
        line = profile(objective, fit, first + number, prediction)
        found.append(replace(line, entry=int(own)))
        if line.gaussian:
            continue
        ends, at, least = np.array(free), free[own], LEAST_SIDE * Z95 * sd[own]
        ends[own] = at - max(np.hypot(at - line.lower, Z95 * more[number]), least)
        lower[own] = to_physical(block, ends)[0][own]
        ends[own] = at + max(np.hypot(line.upper - at, Z95 * more[number]), least)
        upper[own] = to_physical(block, ends)[0][own]
        kinds[own] = "profile"
    leader = leaders(block)
    lower, upper = lower[leader], upper[leader]
    fixed = ~block.fitted[leader]
    sure = is_identifiable(answer.chi2_reduced, lower, upper, sd, block.prior_sd[leader])
    return replace(
        answer,
        lower95=lower,
        upper95=upper,
        identifiable=sure | fixed,
        kinds=tuple(kinds[i] for i in leader),
        profiles=tuple(found),
        evaluations=answer.evaluations + bool(found) + sum(p.evaluations for p in found),
    )


def _absorptions(
    parameters: Parameters,
    draws: FloatArray,
    answer: BandEstimate,
    beyond: FloatArray,
    rng: np.random.Generator,
) -> FloatArray:
    """Return absorptions of draws of free vectors.

    They are scattered by the covariance `beyond`, of what the law drawn from does not include.
    """
    block = absorption_of(parameters)
    first, fitted = absorption_columns(parameters)
    low, high = block.lower[fitted], block.upper[fitted]
    free = draws[:, first : first + fitted.size]
    if beyond.any():
        size, directions = np.linalg.eigh(beyond)
        root = directions * np.sqrt(np.maximum(size, 0.0))
        free = free + rng.standard_normal(free.shape) @ root.T
    found = np.tile(answer.absorption, (len(draws), 1))
    found[:, fitted] = low + (high - low) * expit(free)
    return found[:, leaders(block)]


def _beyond_fit(parameters: Parameters, fit: BandFit, answer: BandEstimate) -> FloatArray:
    """Return the covariance of an answer's fitted logits that its fit does not know of.

    Shape (n_fitted, n_fitted), symmetric, positive semi-definite.
    """
    first, fitted = absorption_columns(parameters)
    own = slice(first, first + fitted.size)
    plain = np.linalg.inv(fit.information)[own, own] * max(fit.chi2_reduced, 1.0)
    more = answer.logit_covariance[np.ix_(fitted, fitted)] - plain
    size, directions = np.linalg.eigh(0.5 * (more + more.T))
    # what is left by rounding is no noise
    size = np.where(size > 1e-9 * max(float(np.trace(plain)), 1e-300), size, 0.0)
    return np.asarray((directions * size) @ directions.T)


def _mirrored(objective: Objective, fit: BandFit, exchange: IntArray) -> MirrorTrial:
    """Return where a second fit ends that begins with the absorptions exchanged."""
    block = absorption_of(objective.parameters)
    values, _ = physical_values(objective.parameters, fit.vector)
    start, first = np.array(fit.vector), position_of(objective.parameters, "absorption")
    free = to_free(block, values["absorption"][exchange])[block.fitted]
    start[first : first + free.size] = free
    other = score_band(objective, start)
    there, _ = physical_values(objective.parameters, other.vector)
    gain = other.log_likelihood - fit.log_likelihood
    return MirrorTrial(there["absorption"], gain, other.evaluations)


# A new method is a function and a row here; `roomfit.settings.Method` names what a user may choose,
# docs/campaign-file.md and docs/how-far-to-trust.md say what it means.
INTERVALS: Mapping[str, IntervalMethod] = {
    "gaussian": lambda _objective, _fit, answer, _settings, _progress: answer,
    "profile": profiled,
}
"""How intervals are made of a fit, by name; a method of that name in the settings chooses it."""
