"""Intervals of a fitted band where a Gaussian does not suffice, and draws for predictions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from roomfit.base.logit import Z95, expit, logit
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.materials.priors import (
    MaterialPrior,
    are_specified,
    plain_logit_law,
    prior_logit_law,
)
from roomfit.model import parameters
from roomfit.model.problem import Objective
from roomfit.solver import BandFit, score_band
from roomfit.uncertainty import gaussian
from roomfit.uncertainty.posterior import band_draws
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

    def __call__(self, band: gaussian.FittedBand) -> gaussian.BandEstimate:
        """Return a band's estimate with better intervals, and what mirror images explain."""
        answer, objective, fit, _ = band
        if objective is None or fit is None or fit.vector.size == 0:
            return answer
        trials = tuple(_mirrored(objective, fit, exchange) for exchange in self.exchanges)
        evaluations = answer.evaluations + sum(t.evaluations for t in trials)
        draws = None
        if self.n_draws and answer.model == "values":
            rng = np.random.default_rng(self.seed)
            block = parameters.absorption_of(objective.parameters)
            free, more = posterior_draws(objective, fit, self.n_draws, rng)
            low, high = block.lower[block.fitted], block.upper[block.fitted]
            draws = np.tile(answer.absorption, (len(free), 1))
            draws[:, block.fitted] = low + (high - low) * expit(free)
            draws, evaluations = draws[:, parameters.leaders(block)], evaluations + more
        answer = replace(answer, mirrors=trials, draws=draws, evaluations=evaluations)
        return profiled(band._replace(estimate=answer)) if self.profiles else answer


def _mirrored(objective: Objective, fit: BandFit, exchange: IntArray) -> gaussian.MirrorTrial:
    """Return where a second fit ends that begins with the absorptions exchanged."""
    block = parameters.absorption_of(objective.parameters)
    values, _ = parameters.physical_values(objective.parameters, fit.vector)
    start, first = np.array(fit.vector), parameters.position_of(objective.parameters, "absorption")
    free = parameters.to_free(block, values["absorption"][exchange])[block.fitted]
    start[first : first + free.size] = free
    other = score_band(objective, start)
    there, _ = parameters.physical_values(objective.parameters, other.vector)
    gain = other.log_likelihood - fit.log_likelihood
    return gaussian.MirrorTrial(there["absorption"], gain, other.evaluations)


def profiled(band: gaussian.FittedBand) -> gaussian.BandEstimate:
    """Return the estimate with profile intervals for absorptions whose likelihood is skew.

    Weights are kept. An interval of 0 to 1, where the data determine nothing, stays as it is. What
    windows share of errors is added to either side as one more standard deviation.
    """
    answer, objective, fit, steps = band
    if objective is None or fit is None:
        return answer
    of_all = objective.parameters
    block, first = parameters.absorption_of(of_all), parameters.position_of(of_all, "absorption")
    free = parameters.to_free(block, answer.absorption)
    sd = np.sqrt(np.diag(answer.logit_covariance))
    shared_sd = np.zeros(fit.vector.size) if steps is None else np.linalg.norm(steps, axis=1)
    lower, upper = np.array(answer.lower95), np.array(answer.upper95)
    kinds, found = list(answer.kinds), []
    prediction = None  # at the answer, the same for all
    for entry, own in enumerate(np.flatnonzero(block.fitted), start=first):
        unspecified = (lower[own], upper[own]) == (0.0, 1.0)
        if unspecified or not may_be_bent(fit, entry):
            continue
        prediction = objective.predict(fit.vector) if prediction is None else prediction
        line = profile(objective, fit, entry, prediction)
        found.append(line)
        if line.gaussian:
            continue
        at, ends = free[own], np.array(free)
        more, least = Z95 * shared_sd[entry], LEAST_SIDE * Z95 * sd[own]
        ends[own] = at - max(np.hypot(at - line.lower, more), least)
        lower[own] = parameters.to_physical(block, ends)[0][own]
        ends[own] = at + max(np.hypot(line.upper - at, more), least)
        upper[own] = parameters.to_physical(block, ends)[0][own]
        kinds[own] = "profile"
    leader = parameters.leaders(block)
    return replace(
        answer,
        lower95=lower[leader],
        upper95=upper[leader],
        kinds=tuple(kinds[i] for i in leader),
        n_profiles=len(found),
        evaluations=answer.evaluations + bool(found) + sum(p.evaluations for p in found),
    )


def prior_logit_covariance(priors: tuple[MaterialPrior, ...], band: int) -> FloatArray:
    """Return that of the logits of all materials, tied ones alike, (n_materials, n_materials)."""
    leader = gaussian.leaders_of(priors)
    return np.asarray(prior_logit_law(priors)[1][band][np.ix_(leader, leader)])


def identifiable_by_rule(
    answers: Sequence[gaussian.BandEstimate], priors: tuple[MaterialPrior, ...]
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
        fits = max(answer.chi2_reduced, answer.chi2_beside) <= gaussian.LARGEST_CHI2_REDUCED
        sure = fits & (width <= gaussian.WIDEST_IDENTIFIABLE) & (sd <= 0.5 * prior_sd)
        found.append(sure | (width == 0.0))
    return np.stack(found, axis=1)


def with_both_intervals(
    best: gaussian.BandEstimate, other: gaussian.BandEstimate
) -> gaussian.BandEstimate:
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


def widened(answer: gaussian.BandEstimate, covariance: FloatArray) -> gaussian.BandEstimate:
    """Return the answer with an error of its logits added, of a covariance (n_materials,) square.

    What is fixed stays.
    """
    fixed = answer.upper95 <= answer.lower95
    covariance = np.where(fixed[:, None] | fixed, 0.0, covariance)
    reach = Z95 * np.sqrt(np.diag(covariance))
    middle = logit(np.clip(answer.absorption, _LEAST, 1.0 - _LEAST), _LEAST)
    lower = expit(middle - np.hypot(middle - logit(answer.lower95, _LEAST), reach))
    upper = expit(middle + np.hypot(logit(answer.upper95, _LEAST) - middle, reach))
    draws = answer.draws
    if draws is not None:
        size, directions = np.linalg.eigh(covariance)
        root = directions * np.sqrt(np.maximum(size, 0.0))
        noise = np.random.default_rng(1).standard_normal(draws.shape) @ root.T
        draws = np.where(reach > 0.0, expit(logit(draws, _LEAST) + noise), draws)
    return replace(
        answer,
        lower95=np.where(fixed, answer.lower95, np.minimum(lower, answer.lower95)),
        upper95=np.where(fixed, answer.upper95, np.maximum(upper, answer.upper95)),
        draws=draws,
        logit_covariance=answer.logit_covariance + covariance,
    )


def decay_error_sds(rates: Sequence[gaussian.DecayRate]) -> FloatArray:
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
    answers: Sequence[gaussian.BandEstimate], areas_m2: FloatArray, more: Mapping[int, FloatArray]
) -> tuple[gaussian.BandEstimate, ...]:
    """Return intervals that allow for errors that only all bands together tell.

    A rate of decay that is not that of the walls, and `more`: by band the covariance of logits
    that others add. Walls move along the shift of their answer by such a rate, all together: in
    absorption, of which the rate determines a sum. Its first order in a logit would exaggerate what
    hardly absorbs.
    """
    rates = [a.decay for a in answers if a.decay is not None]
    sds: Iterator[float] = iter(decay_error_sds(rates).tolist() if rates else [])
    found = []
    for band, answer in enumerate(answers):
        own, added = answer, more.get(band)
        if answer.decay is not None:
            step = next(sds) * answer.decay.step
            a = np.clip(answer.absorption, _LEAST, 1.0 - _LEAST)
            nearer_half = np.where(a < 0.5, a + np.abs(step), a - np.abs(step))
            change = np.sign(step) * np.abs(logit(nearer_half, _LEAST) - logit(a, _LEAST))
            mean_sd = float(np.abs(areas_m2 @ step) / areas_m2.sum())
            costs = {name: np.hypot(sd, change) for name, sd in answer.costs.items()}
            of_mean = {name: float(np.hypot(x, mean_sd)) for name, x in answer.mean_costs.items()}
            costs["decay"], of_mean["decay"] = answer.costs[""], answer.mean_costs[""]
            own = replace(answer, costs=costs, mean_costs=of_mean)
            by_rate = np.outer(change, change)
            added = by_rate if added is None else by_rate + added
        found.append(own if added is None else widened(own, added))
    return tuple(found)


def with_draws(
    answers: Sequence[gaussian.BandEstimate],
    priors: tuple[MaterialPrior, ...],
    logit_covariance: FloatArray,
    n_draws: int,
    seed: int,
) -> tuple[gaussian.BandEstimate, ...]:
    """Return estimates with draws of absorption in all bands, if any was drawn from its model.

    Otherwise predictions draw from the covariance, as is done here for bands by responses beside
    others by room parameters alone. Bands are independent.

    Shapes: `logit_covariance` (n_bands, n_materials, n_materials).
    """
    if all(answer.draws is None for answer in answers):
        return tuple(answers)
    found, (mean, prior) = [], plain_logit_law(priors)
    for band, answer in enumerate(answers):
        rng, drawn = np.random.default_rng((seed, band)), answer.draws
        if answer.model == "prior":
            drawn = gaussian.prior_absorptions(priors, band, n_draws, rng)
        if drawn is None:
            law = answer.absorption, logit_covariance[band], mean[:, band], prior[band]
            drawn = band_draws(*law, n_draws, rng, specified=are_specified(priors))
        found.append(replace(answer, draws=rng.permutation(drawn)))
    return tuple(found)
