"""Gaussian intervals of a band's fit, in the free numbers, carried over to absorption.

Errors that all data of a band share are added to the covariance: variances of single windows know
how far each of them may be off, and not that all are off together. Such errors hardly show in the
residuals, for the answer follows them, and they move most of all the sums that data determine best,
as the mean absorption of the room. A reduced chi-square above 1 multiplies the covariance (R. T.
Birge, Phys. Rev. 40, 207-227 (1932)).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

import numpy as np

from roomfit.base.logit import Z95, expit
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.materials.priors import (
    MaterialPrior,
    are_specified,
    is_default_prior,
    prior_logit_law,
    shared_variance,
)
from roomfit.model.directivity import DIRECTIVITY
from roomfit.model.parameters import (
    Block,
    Parameters,
    absorption_of,
    leaders,
    physical_values,
    position_of,
    prior_covariance,
    prior_residuals,
    to_free,
    to_physical,
)
from roomfit.model.problem import Objective
from roomfit.solver import BandFit, Ending

WIDEST_IDENTIFIABLE = 0.2
LARGEST_CHI2_REDUCED = 2.0
# Data whose information is below this share of the prior's narrow its interval by less than 5 %.
_INFORMATION_SHARE = 0.1
# Unknowns that are named of a fit that did not converge.
_MOST_MOVED = 3


class DecayRate(NamedTuple):
    """What a band's data say of a relative change of its rate of decay, all else fitted along."""

    information: float  # its inverse variance by the data alone, misfit included
    score: float  # derivative of the log-likelihood by it, misfit included
    step: FloatArray  # (n,), how far a change by 1 moves each unknown


class SharedErrors(NamedTuple):
    """What errors that all windows of a band share do to the answer of its fit."""

    steps: FloatArray  # (n_free, n_errors), shifts of the answer, one standard deviation each
    costs: Mapping[str, FloatArray]  # (n_free,), see `sd_without_term`
    mean_costs: Mapping[str, float]  # likewise, of the room's mean absorption
    decay: DecayRate


class Starts(NamedTuple):
    """Where least squares from random starts ended."""

    number: int  # of random starts
    agreeing: int  # of them, within the interval of the best
    other: FloatArray | None  # (n_materials,), the likeliest outside of it that explains data alike
    loss: float  # by how much its log-likelihood, prior included, is lower


class MirrorTrial(NamedTuple):
    """Where a second fit ended that began with absorptions exchanged by a symmetry."""

    absorption: FloatArray  # (n_materials,)
    gain: float  # its log-likelihood less that of the first fit
    evaluations: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class BandEstimate:
    """Absorption of the materials in one band."""

    absorption: FloatArray  # (n_materials,), and so the next three
    lower95: FloatArray
    upper95: FloatArray
    logit_mean: FloatArray  # logit of the absorption
    # (n_materials, n_materials), its posterior, misfit included; zeros where absorption is fixed
    logit_covariance: FloatArray
    chi2_reduced: float  # 0 where nothing was fitted, and so the cost
    cost: float
    evaluations: int  # of the model with its derivative: fits, starts, profiles, draws
    ending: Ending
    model: str  # "energy", "coherent", "values", or "prior" where nothing was fitted
    # free numbers of the sources' unknown directivity, (n,), and their covariance, misfit included
    directivity: tuple[FloatArray, FloatArray] | None = None
    chi2_beside: float = 0.0  # of another model, where its intervals are joined to these
    # how each interval was made: "gaussian", "profile", "given", or "none" where the
    # data determine nothing
    kinds: tuple[str, ...] = ()
    n_profiles: int = 0  # of how many absorptions the likelihood was profiled
    # (n_draws, n_materials), of the posterior, for predictions; None: not drawn
    draws: FloatArray | None = None
    mirrors: tuple[MirrorTrial, ...] = ()  # one a symmetry
    starts: Starts | None = None  # where random starts were tried
    moved: tuple[str, ...] = ()  # of a fit that did not converge: what the last round moved most
    # (n_materials,), sd in the logit by which term were left out, see `sd_without_term`
    costs: Mapping[str, FloatArray] = field(default_factory=dict)
    decay: DecayRate | None = None  # its step in absorption, (n_materials,)
    # as `costs`, of the area-weighted mean absorption, not in the logit
    mean_costs: Mapping[str, float] = field(default_factory=dict)
    # by parameter, (2, n_files): decay of each file's windows in s, measured and as fitted, where
    # pressures were fitted
    window_decays_s: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def converged(self) -> bool:
        """Whether the fit met its test of convergence."""
        return self.ending.converged


class FittedBand(NamedTuple):
    """A band with its Gaussian estimate, and the fit from which better intervals can be found."""

    estimate: BandEstimate
    objective: Objective | None = None  # None, as the fit, where only the prior is known
    fit: BandFit | None = None
    steps: FloatArray | None = None  # (n_free, n_errors), of errors that its windows share


Refine: TypeAlias = Callable[[FittedBand], BandEstimate]


class AbsorptionIntervals(NamedTuple):
    """Absorption of every material in one band with its 95 % interval."""

    absorption: FloatArray  # (n_materials,), and so the next two
    lower95: FloatArray
    upper95: FloatArray


def absorption_intervals(
    parameters: Parameters, vector: FloatArray, covariance: FloatArray, chi2_reduced: float
) -> AbsorptionIntervals:
    """Return symmetric intervals of logit absorption, mapped to absorption.

    These are local, Gaussian intervals: they know nothing of a second minimum, and near absorption
    0 or 1 their true coverage is not 95 %. A material of which the data determine nothing, even if
    all others were known, has the interval of the prior that was stated, 0 to 1 if none was.

    Shapes: `vector` (n_free,), `covariance` (n_free, n_free), misfit included.
    """
    block, own = absorption_of(parameters), _absorption_entries(parameters)
    sd, free = np.zeros((2, len(block.labels)))
    sd[block.fitted] = np.sqrt(np.diag(covariance)[own])
    free[block.fitted] = vector[own]
    absorption = physical_values(parameters, vector)[0]["absorption"]
    information = np.diag(np.linalg.inv(covariance))[own] * max(chi2_reduced, 1.0)
    uninformed = _is_uninformed(block, information)
    # a misfit says nothing against what was stated
    sd = np.where(uninformed, block.prior_sd, sd)
    lower, upper = (
        np.asarray(np.where(block.fitted, to_physical(block, free + z * sd)[0], absorption))
        for z in (-Z95, Z95)
    )
    shared_sd = np.array(block.prior_sd)
    shared_sd[block.fitted] = np.sqrt(shared_variance(prior_covariance(block)))
    uninformed &= is_default_prior(block.prior_mean, shared_sd)
    lower, upper = np.where(uninformed, 0.0, lower), np.where(uninformed, 1.0, upper)
    leader = leaders(block)
    return AbsorptionIntervals(absorption, lower[leader], upper[leader])


def _absorption_entries(parameters: Parameters) -> slice:
    """Return where the fitted absorptions stand in a free vector."""
    first = position_of(parameters, "absorption")
    return slice(first, first + int(np.count_nonzero(absorption_of(parameters).fitted)))


def _is_uninformed(block: Block, information: FloatArray) -> BoolArray:
    """Whether nearly all information about an absorption, given the others, is the prior's.

    And about all whose prior it shares: data on one wall of a product inform of the others.
    """
    covariance = prior_covariance(block)
    alone = of_prior = 1.0 / np.diag(covariance)
    if block.correlation is not None:
        of_prior = np.diag(np.linalg.inv(covariance))
    is_low = information - of_prior - _INFORMATION_SHARE * alone <= 0.0
    out = np.zeros(len(block.labels), dtype=np.bool_)
    out[block.fitted] = ~np.any((covariance != 0.0) & ~is_low, axis=1)
    return out


def answer_steps(
    objective: Objective, fit: BandFit, jacobian: FloatArray, errors: FloatArray
) -> FloatArray:
    """Return how far the answer moves if what is expected of the data is wrong by given errors.

    To first order ``H^-1 J^T W u`` for an error u, with H the information, J the Jacobian and W the
    weights of the data.

    Shape (n_free, n_errors). Shapes: `jacobian` (n_data, n_free), `errors` (n, n_errors).
    """
    n = errors.shape[0]
    weight = 1.0 / (objective.correlation_length()[:n] * fit.variance[:n])
    pull = jacobian[:n].T @ (weight[:, None] * errors)
    return np.asarray(np.linalg.solve(fit.information, pull))


def fit_covariance(fit: BandFit, steps: FloatArray | None = None) -> FloatArray:
    """Return the covariance of a fit's free numbers, misfit and steps of its answer included.

    Shapes: `steps` (n_free, n_errors).
    """
    covariance = np.linalg.inv(fit.information) * max(fit.chi2_reduced, 1.0)
    # these errors are as large as they are: a misfit does not multiply them
    return np.asarray(covariance if steps is None else covariance + steps @ steps.T)


def weighted_mean_gradient(
    parameters: Parameters, vector: FloatArray, weights: FloatArray
) -> FloatArray:
    """Return the derivative of a weighted mean of the absorptions by the free numbers, (n_free,).

    0 by gains, geometry and directivity. `weights`, (n_materials,), have the sum 1.
    """
    _, slopes = physical_values(parameters, vector)
    block = absorption_of(parameters)
    whole = np.bincount(leaders(block), weights * slopes["absorption"], len(block.labels))
    gradient: FloatArray = np.zeros(vector.size)
    gradient[_absorption_entries(parameters)] = whole[block.fitted]
    return gradient


def costs_of_terms(
    objective: Objective,
    fit: BandFit,
    jacobian: FloatArray,
    shared: Mapping[str, FloatArray],
    areas_m2: FloatArray,
) -> tuple[dict[str, FloatArray], dict[str, float]]:
    """Return `sd_without_term` of a fit, (n_free,), and of the mean absorption of the room.

    Gains and other blocks of unknowns are among what is known.

    Shapes: `jacobian` (n_data, n_free), `shared` (n, n_errors), `areas_m2` (n_materials,).
    """
    parameters = objective.parameters
    _, rows = prior_residuals(parameters, fit.vector)
    ends = np.cumsum([0, *(int(np.count_nonzero(b.fitted)) for b in parameters.blocks)])
    known = {
        b.name: np.arange(first, last)
        for b, first, last in zip(parameters.blocks, ends[:-1], ends[1:], strict=True)
        if b.name != "absorption" and last > first
    }
    found = sd_without_term(
        jacobian,
        rows.T @ rows,
        objective.variance_parts(fit.vector),
        shared,
        objective.correlation_length(),
        known,
        max(fit.chi2_reduced, 1.0),
        weighted_mean_gradient(parameters, fit.vector, areas_m2 / areas_m2.sum()),
    )
    return {k: sd[:-1] for k, sd in found.items()}, {k: float(sd[-1]) for k, sd in found.items()}


def sd_without_term(
    jacobian: FloatArray,
    prior: FloatArray,
    parts: Mapping[str, FloatArray],
    shared: Mapping[str, FloatArray],
    neighbours: FloatArray,
    known: Mapping[str, IntArray],
    misfit: float,
    along: FloatArray,
) -> dict[str, FloatArray]:
    """Return how well unknowns are known with all terms of the uncertainty, and without each.

    The covariance is ``misfit (J^T W J + P)^-1`` and the outer products of the answer's shifts by
    shared errors, with ``1 / W`` the sum of the parts times the number of neighbours: linear, at
    the answer. Without a term the weights are those that suit the others.

    By what is left out, "" for nothing, "neighbours", "misfit" and "prior" among it; 0 of what is
    taken for known, infinite where without the prior nothing is determined. The last entry is that
    of the sum of all unknowns weighed by `along`. `shared`: one standard deviation a column.
    `known`: unknowns that may be taken for known.

    Shape (n_free + 1,). Shapes: `jacobian` (n_data, n_free), `prior` (n_free, n_free), `parts`
    (n_data,), `shared` (n, n_errors), `neighbours` (n_data,), `along` (n_free,).
    """
    others = np.concatenate([*known.values(), []])
    wanted = np.vstack((np.eye(len(prior)), along))

    def sds(without: str) -> FloatArray:
        kept = [part for name, part in parts.items() if name != without]
        least = 1e-12 * np.sum(list(parts.values()), axis=0)
        weight = 1.0 / np.maximum(np.sum(kept, axis=0), least)
        weight /= 1.0 if without == "neighbours" else neighbours
        free = np.setdiff1d(np.arange(len(prior)), known.get(without, []))
        rows, own = jacobian[:, free], wanted[:, free]  # zeros of what is taken for known
        information = rows.T @ (weight[:, None] * rows)
        stated = np.isin(free, others) if without == "prior" else np.ones(free.size, np.bool_)
        information += prior[np.ix_(free, free)] * np.outer(stated, stated)
        if not free.size:
            return np.zeros(len(wanted))
        size, directions = np.linalg.eigh(information)
        if size[0] <= 1e-12 * size[-1]:
            return np.where(np.any(own != 0.0, axis=1), np.inf, 0.0)
        inverse = (directions / size) @ directions.T
        variance = np.sum((own @ inverse) * own, axis=1) * (1.0 if without == "misfit" else misfit)
        for name, errors in shared.items():
            if name != without:
                n = len(errors)  # which may be many columns: no copy of them
                steps = inverse @ ((rows[:n].T * weight[:n]) @ errors)
                variance = variance + np.sum((own @ steps) ** 2, axis=1)
        return np.asarray(np.sqrt(variance))

    names = ("", *parts, *shared, *known, "neighbours", "misfit", "prior")
    return {name: sds(name) for name in dict.fromkeys(names)}


def band_estimate(
    parameters: Parameters, fit: BandFit, model: str, shared: SharedErrors | None = None
) -> BandEstimate:
    """Return one band's absorption of each material, errors that its windows share included."""
    covariance = fit_covariance(fit, None if shared is None else shared.steps)
    found = absorption_intervals(parameters, fit.vector, covariance, fit.chi2_reduced)
    block, own = absorption_of(parameters), _absorption_entries(parameters)
    leader, fitted = leaders(block), np.flatnonzero(block.fitted)
    whole: FloatArray = np.zeros((leader.size, leader.size))
    whole[np.ix_(fitted, fitted)] = covariance[own, own]

    def of_materials(values: FloatArray) -> FloatArray:
        """Return what belongs to fitted entries for all materials, 0 where fixed."""
        every = np.zeros(leader.size)
        every[fitted] = values[own]
        return every[leader]

    decay, costs, mean_costs = None, {}, dict[str, float]()
    if shared is not None:
        slope = physical_values(parameters, fit.vector)[1]["absorption"]
        decay = shared.decay._replace(step=slope * of_materials(shared.decay.step))
        costs = {name: of_materials(sd) for name, sd in shared.costs.items()}
        mean_costs = dict(shared.mean_costs)
    directivity = None
    for sources in (b for b in parameters.blocks if b.name == DIRECTIVITY):
        first = position_of(parameters, DIRECTIVITY)
        at = slice(first, first + len(sources.labels))
        directivity = fit.vector[at], covariance[at, at]
    return BandEstimate(
        *found,
        to_free(block, found.absorption),
        whole[np.ix_(leader, leader)],
        fit.chi2_reduced,
        fit.cost,
        fit.evaluations,
        fit.ending,
        model,
        directivity,
        kinds=_kinds(found.lower95, found.upper95, block.fitted[leader]),
        moved=() if fit.converged else _moved(parameters, fit),
        costs=costs,
        decay=decay,
        mean_costs=mean_costs,
    )


def _moved(parameters: Parameters, fit: BandFit) -> tuple[str, ...]:
    """Return what the last round moved by a tenth of its standard deviation, most first, by name.

    Absorption and gains from value to value; geometry and directivity from one number of prior
    standard deviations to another.
    """
    if fit.previous is None:
        return ()
    sds = np.abs(fit.vector - fit.previous) / np.sqrt(np.diag(np.linalg.inv(fit.information)))
    before, after = (physical_values(parameters, v)[0] for v in (fit.previous, fit.vector))
    entries = [(b, i) for b in parameters.blocks for i in np.flatnonzero(b.fitted)]
    return tuple(
        f"{b.name} of {b.labels[i]} from {before[b.name][i]:.3g} to {after[b.name][i]:.3g}"
        for n in np.argsort(-sds)[:_MOST_MOVED]
        if sds[n] > 0.0
        for b, i in (entries[n],)
    )


def _kinds(lower: FloatArray, upper: FloatArray, fitted: BoolArray) -> tuple[str, ...]:
    unspecified = (lower == 0.0) & (upper == 1.0)
    return tuple(
        "given" if not own else "none" if nothing else "gaussian"
        for own, nothing in zip(fitted, unspecified, strict=True)
    )


def prior_absorptions(
    priors: tuple[MaterialPrior, ...], band: int, n_draws: int, rng: np.random.Generator
) -> FloatArray:
    """Return draws of absorption from the priors alone, shape (n_draws, n_materials)."""
    mean, covariance = prior_logit_law(priors)
    noise = rng.standard_normal((len(priors), n_draws))
    own = np.array([i for i, k in enumerate(priors) if k.tied_to is None])
    drawn: FloatArray = np.zeros((n_draws, len(priors)))
    root = np.linalg.cholesky(covariance[band][np.ix_(own, own)])
    drawn[:, own] = (mean[own, band, None] + root @ noise[own]).T
    for i, k in enumerate(priors):
        free = k.lower + (k.upper - k.lower) * expit(drawn[:, i])
        drawn[:, i] = free if k.known is None else k.known[band]
    return drawn[:, leaders_of(priors)]


def leaders_of(priors: tuple[MaterialPrior, ...]) -> IntArray:
    """Return the material whose absorption each one has, another than itself where it is tied."""
    names = [k.name for k in priors]
    return np.array([names.index(k.tied_to or k.name) for k in priors])


def prior_only_band(priors: tuple[MaterialPrior, ...], band: int) -> BandEstimate:
    """Return the answer of a band without data: the prior, 0 to 1 where none was stated."""
    mean, law = prior_logit_law(priors)
    stated = are_specified(priors)
    priors = tuple(priors[i] for i in leaders_of(priors))
    fixed = np.array([k.known is not None for k in priors])
    known = np.array([np.nan if k.known is None else k.known[band] for k in priors])
    low = np.array([k.lower for k in priors])
    width = np.array([k.upper for k in priors]) - low
    covariance = np.where(fixed[:, None] | fixed, 0.0, law[band])
    reach = Z95 * np.sqrt(np.diag(covariance))
    free = mean[:, band]
    absorption, least, most = (low + width * expit(free + by) for by in (0.0, -reach, reach))
    lower = np.where(fixed, known, np.where(stated, least, 0.0))
    upper = np.where(fixed, known, np.where(stated, most, 1.0))
    absorption = np.where(fixed, known, absorption)
    kinds = _kinds(lower, upper, ~fixed)
    none = 0.0, 0.0, 0, Ending.CONVERGED
    return BandEstimate(absorption, lower, upper, free, covariance, *none, "prior", kinds=kinds)
