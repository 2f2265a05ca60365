"""Intervals of a fitted band where a Gaussian does not suffice, and draws for predictions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from roomfit.base.logit import Z95, expit, logit
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.materials.priors import MaterialPrior, prior_logit_law
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
from roomfit.solver import BandFit, DecayRate, score_band
from roomfit.uncertainty.gaussian import (
    LARGEST_CHI2_REDUCED,
    WIDEST_IDENTIFIABLE,
    BandEstimate,
    FittedBand,
    MirrorTrial,
)
from roomfit.uncertainty.profile import may_be_bent, profile
from roomfit.uncertainty.sampling import posterior_draws

# A profile never narrows either side of an interval, in the logit, to less than this of the
# Gaussian's: a skew likelihood halves a side at most in every case examined, and what asks for
# more is rather an error of the weights.
LEAST_SIDE = 0.5
_LEAST = 1e-9  # distance of an absorption from 0 and 1 in its logit
# Prior of the rates of decay of a room over those of its model: with each probability a normal law
# about 1 of that standard deviation in every band. docs/decisions/0048-what-stands-in-the-room.md.
DECAY_PROBABILITIES, DECAY_SDS = np.array([0.75, 0.25]), np.array([0.01, 0.2])


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """What is done to every band after its fit."""

    profiles: bool  # whether intervals of skew likelihoods are those of profiles
    seed: int
    # of materials, by a symmetry of room and positions: fitted a second time from there
    exchanges: tuple[IntArray, ...] = ()
    n_draws: int = 0  # for predictions, of bands without responses: there they are not Gaussian

    def __call__(self, band: FittedBand) -> BandEstimate:
        """Return a band's estimate with better intervals, and what mirror images explain."""
        objective, fit, answer = band.objective, band.fit, band.estimate
        if objective is None or fit is None or fit.vector.size == 0:
            return answer
        trials = tuple(_mirrored(objective, fit, exchange) for exchange in self.exchanges)
        evaluations = answer.evaluations + sum(t.evaluations for t in trials)
        answer = replace(answer, mirrors=trials, evaluations=evaluations)
        if self.n_draws and answer.model == "values":
            rng, parameters = np.random.default_rng(self.seed), objective.parameters
            drawn, more = posterior_draws(objective, fit, self.n_draws, rng)
            beyond = _beyond_fit(parameters, fit, answer)
            draws = _absorptions(parameters, drawn, answer, beyond, rng)
            evaluations = answer.evaluations + more
            answer = replace(answer, draws=draws, evaluations=evaluations)
        return profiled(objective, fit, answer) if self.profiles else answer


def profiled(
    objective: Objective,
    fit: BandFit,
    answer: BandEstimate,
) -> BandEstimate:
    """Return the answer with profile intervals for the absorptions whose likelihood is skew.

    Weights are kept. An interval of 0 to 1, where the data determine nothing, stays as it is. What
    the Gaussian answer allows for beyond its fit's information, as the noise of the rays, is added
    to either side as one more standard deviation.
    """
    block = absorption_of(objective.parameters)
    first, fitted = _columns(objective.parameters)
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
    return replace(
        answer,
        lower95=lower,
        upper95=upper,
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
    first, fitted = _columns(parameters)
    low, high = block.lower[fitted], block.upper[fitted]
    free = draws[:, first : first + fitted.size]
    if beyond.any():
        size, directions = np.linalg.eigh(beyond)
        root = directions * np.sqrt(np.maximum(size, 0.0))
        free = free + rng.standard_normal(free.shape) @ root.T
    found = np.tile(answer.absorption, (len(draws), 1))
    found[:, fitted] = low + (high - low) * expit(free)
    return found[:, leaders(block)]


def _columns(parameters: Parameters) -> tuple[int, IntArray]:
    """Return where the fitted absorptions begin, and which entries of their block they are."""
    block = absorption_of(parameters)
    return position_of(parameters, "absorption"), np.flatnonzero(block.fitted)


def _beyond_fit(parameters: Parameters, fit: BandFit, answer: BandEstimate) -> FloatArray:
    """Return the covariance of an answer's fitted logits that its fit does not know of.

    Shape (n_fitted, n_fitted), symmetric, positive semi-definite.
    """
    first, fitted = _columns(parameters)
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


def prior_logit_covariance(priors: tuple[MaterialPrior, ...], band: int) -> FloatArray:
    """Return that of the logits of all materials, tied ones alike, (n_materials, n_materials)."""
    names = [k.name for k in priors]
    leader = [names.index(k.tied_to or k.name) for k in priors]
    return np.asarray(prior_logit_law(priors)[1][band][np.ix_(leader, leader)])


def identifiable_by_rule(
    answers: Sequence[BandEstimate], priors: tuple[MaterialPrior, ...]
) -> BoolArray:
    """Return which absorptions the data determine, shape (n_materials, n_bands).

    Reduced chi-square at most 2, 95 % interval no wider than 0.2 in absorption, and a posterior
    standard deviation in the logit at most half the prior's. What is fixed counts as identifiable.
    """
    found = []
    for band, answer in enumerate(answers):
        sd = np.sqrt(np.diag(answer.logit_covariance))
        prior_sd = np.sqrt(np.diag(prior_logit_covariance(priors, band)))
        width = answer.upper95 - answer.lower95
        fits = max(answer.chi2_reduced, answer.chi2_beside) <= LARGEST_CHI2_REDUCED
        sure = fits & (width <= WIDEST_IDENTIFIABLE) & (sd <= 0.5 * prior_sd)
        found.append(sure | (width == 0.0))
    return np.stack(found, axis=1)


def with_both_intervals(best: BandEstimate, other: BandEstimate) -> BandEstimate:
    """Return an answer whose intervals contain those of another model, too."""
    lower = np.minimum(best.lower95, other.lower95)
    upper = np.maximum(best.upper95, other.upper95)
    middle = logit(best.absorption, _LEAST)
    reach = np.maximum(logit(upper, _LEAST) - middle, middle - logit(lower, _LEAST)) / Z95
    sd = np.sqrt(np.diagonal(best.logit_covariance))
    # draws for a prediction must spread as far as the intervals
    sd_scale = np.where(sd > 0.0, np.maximum(reach, sd) / np.where(sd > 0.0, sd, 1.0), 1.0)
    return replace(
        best,
        lower95=lower,
        upper95=upper,
        draws=None,
        logit_covariance=best.logit_covariance * np.outer(sd_scale, sd_scale),
        chi2_beside=other.chi2_reduced,
    )


def widened(answer: BandEstimate, covariance: FloatArray) -> BandEstimate:
    """Return the answer with an error of its logits added, of a covariance (n_materials,) square.

    What is fixed stays.
    """
    fixed = answer.upper95 <= answer.lower95
    covariance = np.where(fixed[:, None] | fixed, 0.0, covariance)
    logit_sd = np.sqrt(np.diag(covariance))
    middle = logit(np.clip(answer.absorption, _LEAST, 1.0 - _LEAST), _LEAST)
    lower = middle - np.hypot(middle - logit(answer.lower95, _LEAST), Z95 * logit_sd)
    upper = middle + np.hypot(logit(answer.upper95, _LEAST) - middle, Z95 * logit_sd)
    draws = answer.draws
    if draws is not None:
        size, directions = np.linalg.eigh(covariance)
        root = directions * np.sqrt(np.maximum(size, 0.0))
        noise = np.random.default_rng(1).standard_normal(draws.shape) @ root.T
        draws = np.where(logit_sd > 0.0, expit(logit(draws, _LEAST) + noise), draws)
    return replace(
        answer,
        lower95=np.where(fixed, answer.lower95, np.minimum(expit(lower), answer.lower95)),
        upper95=np.where(fixed, answer.upper95, np.maximum(expit(upper), answer.upper95)),
        draws=draws,
        logit_covariance=answer.logit_covariance + covariance,
    )


def decay_error_sds(rates: Sequence[DecayRate]) -> FloatArray:
    """Return how far, relatively, each band's rate of decay may be from that of its walls.

    Shape (n_bands,): the root mean square about 0 of the changes after the data. Their prior is a
    mixture: of rooms that decay as their model does in every band, and of such that do not. All
    bands together say which, so that one band that prefers another rate by chance does not; data
    that contradict the walls' rate widen their intervals, and data that determine it hardly do.
    The answer is not moved: what data prefer is made by anything that early and late windows
    disagree about. No law is taken beyond its own width either: a preferred change of several of
    these is an extrapolation of first order, and says that something else is wrong.
    """
    information, score = (np.array([r[i] for r in rates])[:, None] for i in (0, 1))
    # of each law: its variance and mean after the data, and how well it predicted them
    variance = 1.0 / (information + DECAY_SDS**-2)
    log_evidence = 0.5 * np.sum(variance * score**2 + np.log(variance / DECAY_SDS**2), axis=0)
    weight = DECAY_PROBABILITIES * np.exp(log_evidence - log_evidence.max())
    square = np.minimum(variance + (variance * score) ** 2, DECAY_SDS**2)
    return np.sqrt(np.asarray(square @ weight / weight.sum(), dtype=np.float64))


def with_errors_of_all_bands(
    answers: Sequence[BandEstimate], areas_m2: FloatArray, more: Mapping[int, FloatArray]
) -> tuple[BandEstimate, ...]:
    """Return intervals that allow for errors that only all bands together tell.

    A rate of decay that is not that of the walls, and `more`: by band the covariance of logits
    that others add. Walls move along the shift of their answer by such a rate, all together: in
    absorption, of which the rate determines a sum. Its first order in a logit would exaggerate what
    hardly absorbs.
    """
    rates = [a.decay for a in answers if a.decay is not None]
    sds = iter(decay_error_sds(rates) if rates else ())
    return tuple(
        _with_errors(a, None if a.decay is None else next(sds) * a.decay.step, areas_m2, own)
        for a, own in zip(answers, map(more.get, range(len(answers))), strict=True)
    )


def _with_errors(
    answer: BandEstimate, step: FloatArray | None, areas_m2: FloatArray, more: FloatArray | None
) -> BandEstimate:
    """Return an answer with one error of all absorptions added, of that sd, and a covariance."""
    if step is None:
        return answer if more is None else widened(answer, more)
    a = np.clip(answer.absorption, _LEAST, 1.0 - _LEAST)
    nearer_half = np.where(a < 0.5, a + np.abs(step), a - np.abs(step))
    logit_step = np.sign(step) * np.abs(logit(nearer_half, _LEAST) - logit(a, _LEAST))
    mean_sd = float(np.abs(areas_m2 @ step) / areas_m2.sum())
    costs = {name: np.hypot(own, logit_step) for name, own in answer.costs.items()}
    of_mean = {name: float(np.hypot(own, mean_sd)) for name, own in answer.mean_costs.items()}
    if answer.costs:
        costs["decay"] = answer.costs[""]
    if answer.mean_costs:
        of_mean["decay"] = answer.mean_costs[""]
    added = np.outer(logit_step, logit_step)
    wider = widened(answer, added if more is None else added + more)
    return replace(wider, costs=costs, mean_costs=of_mean)
