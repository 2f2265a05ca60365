"""Gaussian intervals of a band's fit, in the free numbers, carried over to absorption.

Errors that all data of a band share are added to the covariance: variances of single windows know
how far each of them may be off, and not that all are off together. Such errors hardly show in the
residuals, for the answer follows them, and they move most of all the sums that data determine best,
as the mean absorption of the room. A reduced chi-square above 1 multiplies the covariance (R. T.
Birge, Phys. Rev. 40, 207-227 (1932)).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeAlias

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
from roomfit.solver import BandFit, DecayRate, Ending
from roomfit.uncertainty.profile import Profile

WIDEST_IDENTIFIABLE = 0.2
LARGEST_CHI2_REDUCED = 2.0
# Data whose information is below this share of the prior's narrow its interval by less than 5 %.
_INFORMATION_SHARE = 0.1
# Unknowns that are named of a fit that did not converge.
_MOST_MOVED = 3


@dataclass(frozen=True, slots=True, eq=False)
class AbsorptionIntervals:
    """Absorption of every material in one band with its 95 % interval."""

    absorption: FloatArray  # (n_materials,), and so the next three
    lower95: FloatArray
    upper95: FloatArray
    covariance: FloatArray  # (n_free, n_free), of the free vector, misfit included


def absorption_intervals(
    parameters: Parameters, vector: FloatArray, information: FloatArray, chi2_reduced: float
) -> AbsorptionIntervals:
    """Return symmetric intervals of logit absorption, mapped to absorption.

    The covariance is the inverse information times max(phi, 1): a misfit widens every interval.
    These are local, Gaussian intervals: they know nothing of a second minimum, and near absorption
    0 or 1 their true coverage is not 95 %. A material of which the data determine nothing, even if
    all others were known, has the interval of the prior that was stated, 0 to 1 if none was.
    """
    covariance = np.linalg.inv(information) * max(chi2_reduced, 1.0)
    block = absorption_of(parameters)
    n = int(np.count_nonzero(block.fitted))
    first = position_of(parameters, "absorption")
    sd: FloatArray = np.zeros(len(block.labels))
    sd[block.fitted] = np.sqrt(np.diag(covariance)[first : first + n])
    free = np.zeros(len(block.labels))
    free[block.fitted] = vector[first : first + n]
    values, _ = physical_values(parameters, vector)
    absorption = values["absorption"]
    uninformed = _is_uninformed(block, np.diag(information)[first : first + n])
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
    return AbsorptionIntervals(
        absorption,
        lower[leader],
        upper[leader],
        np.asarray(covariance, dtype=np.float64),
    )


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
    first = position_of(parameters, "absorption")
    gradient[first : first + int(np.count_nonzero(block.fitted))] = whole[block.fitted]
    return gradient


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


def add_covariance(fit: BandFit, steps: FloatArray) -> BandFit:
    """Return a fit whose covariance has the outer products of steps of its answer added.

    Shapes: `steps` (n_free, n_errors).
    """
    if not np.any(steps):
        return fit
    # misfit multiplies the covariance later on; these errors are as large as they are
    more = steps @ steps.T / max(fit.chi2_reduced, 1.0)
    information = np.linalg.inv(np.linalg.inv(fit.information) + more)
    return replace(fit, information=0.5 * (information + information.T))


def costs_of_terms(
    objective: Objective,
    fit: BandFit,
    jacobian: FloatArray,
    shared: Mapping[str, FloatArray],
    areas_m2: FloatArray | None = None,
) -> dict[str, FloatArray]:
    """Return `sd_without_term` of a fit, gains and other blocks of unknowns among what is known.

    With areas, the last entry is the standard deviation of the mean absorption of the room.

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
    return sd_without_term(
        jacobian,
        rows.T @ rows,
        objective.variance_parts(fit.vector),
        shared,
        objective.correlation_length(),
        known,
        max(fit.chi2_reduced, 1.0),
        None
        if areas_m2 is None
        else weighted_mean_gradient(parameters, fit.vector, areas_m2 / areas_m2.sum()),
    )


def sd_without_term(
    jacobian: FloatArray,
    prior: FloatArray,
    parts: Mapping[str, FloatArray],
    shared: Mapping[str, FloatArray],
    neighbours: FloatArray,
    known: Mapping[str, IntArray],
    misfit: float = 1.0,
    along: FloatArray | None = None,
) -> dict[str, FloatArray]:
    """Return how well unknowns are known with all terms of the uncertainty, and without each.

    The covariance is ``misfit (J^T W J + P)^-1`` and the outer products of the answer's shifts by
    shared errors, with ``1 / W`` the sum of the parts times the number of neighbours: linear, at
    the answer. Without a term the weights are those that suit the others.

    By what is left out, "" for nothing, "neighbours", "misfit" and "prior" among it; 0 of what is
    taken for known, infinite where without the prior nothing is determined. `shared`: one standard
    deviation a column. `known`: unknowns that may be taken for known.

    Shape (n_free,). Shapes: `jacobian` (n_data, n_free), `prior` (n_free, n_free), `parts`
    (n_data,), `shared` (n, n_errors), `neighbours` (n_data,), `along` (n_free,).
    """
    others = np.concatenate([*known.values(), []])
    wanted = np.vstack((np.eye(len(prior)), *(() if along is None else (along[None],))))

    def sds(without: str) -> FloatArray:
        kept = [part for name, part in parts.items() if name != without]
        weight = 1.0 / np.maximum(
            np.sum(kept, axis=0), 1e-12 * np.sum(list(parts.values()), axis=0)
        )
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


@dataclass(frozen=True, slots=True, eq=False)
class Starts:
    """Where least squares from random starts ended."""

    number: int  # of random starts
    agreeing: int  # of them, within the interval of the best
    other: FloatArray | None  # (n_materials,), the likeliest outside of it that explains data alike
    loss: float  # by how much its log-likelihood, prior included, is lower


@dataclass(frozen=True, slots=True, eq=False)
class MirrorTrial:
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
    # data determine nothing; empty: all Gaussian
    kinds: tuple[str, ...] = ()
    profiles: tuple[Profile, ...] = ()  # of some absorptions, `entry` counting materials
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


@dataclass(frozen=True, slots=True, eq=False)
class FittedBand:
    """A band with its Gaussian estimate, and the fit from which better intervals can be found."""

    estimate: BandEstimate
    objective: Objective | None = None  # None, as the fit, where only the prior is known
    fit: BandFit | None = None


Refine: TypeAlias = Callable[[FittedBand], BandEstimate]

SharedCovariance: TypeAlias = Callable[[int, Objective, BandFit], BandFit]


def band_estimate(parameters: Parameters, fit: BandFit, model: str) -> BandEstimate:
    """Return one band's absorption of each material and of the room as a whole."""
    found = absorption_intervals(parameters, fit.vector, fit.information, fit.chi2_reduced)
    block = absorption_of(parameters)
    own: FloatArray = np.zeros((block.fitted.size, block.fitted.size))
    fitted = np.flatnonzero(block.fitted)
    first = position_of(parameters, "absorption")
    chosen = slice(first, first + fitted.size)
    own[np.ix_(fitted, fitted)] = found.covariance[chosen, chosen]
    leader = leaders(block)
    covariance = own[np.ix_(leader, leader)]
    decay = fit.decay
    if decay is not None:
        slope = physical_values(parameters, fit.vector)[1]["absorption"]
        decay = decay._replace(step=slope * _of_materials(block, decay.step[chosen]))
    return BandEstimate(
        found.absorption,
        found.lower95,
        found.upper95,
        to_free(block, found.absorption),
        covariance,
        fit.chi2_reduced,
        fit.cost,
        fit.evaluations,
        fit.ending,
        model,
        _directivity(parameters, fit.vector, found.covariance),
        kinds=_kinds(found.lower95, found.upper95, block.fitted[leader]),
        moved=() if fit.converged else _moved(parameters, fit),
        costs={name: _of_materials(block, sd[chosen]) for name, sd in fit.costs.items()},
        decay=decay,
        mean_costs=fit.mean_costs,
    )


def _of_materials(block: Block, fitted: FloatArray) -> FloatArray:
    """Return what belongs to the fitted entries of a block for all of them, 0 where fixed."""
    own = np.zeros(len(block.labels))
    own[block.fitted] = fitted
    return own[leaders(block)]


def _moved(parameters: Parameters, fit: BandFit) -> tuple[str, ...]:
    """Return what the last round moved by a tenth of its standard deviation, most first, by name.

    Absorption and gains from value to value; geometry and directivity from one number of prior
    standard deviations to another.
    """
    if fit.previous is None:
        return ()
    sds = np.abs(fit.vector - fit.previous) / np.sqrt(np.diag(np.linalg.inv(fit.information)))
    before, after = (physical_values(parameters, v)[0] for v in (fit.previous, fit.vector))
    entries = [(b.name, i) for b in parameters.blocks for i in np.flatnonzero(b.fitted)]
    labels = {b.name: b.labels for b in parameters.blocks}
    return tuple(
        f"{name} of {labels[name][i]} from {before[name][i]:.3g} to {after[name][i]:.3g}"
        for n in np.argsort(-sds)[:_MOST_MOVED]
        if sds[n] > 0.0
        for name, i in (entries[n],)
    )


def _kinds(lower: FloatArray, upper: FloatArray, fitted: BoolArray) -> tuple[str, ...]:
    unspecified = (lower == 0.0) & (upper == 1.0)
    return tuple(
        "given" if not own else "none" if nothing else "gaussian"
        for own, nothing in zip(fitted, unspecified, strict=True)
    )


def _directivity(
    parameters: Parameters, vector: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    block = next((b for b in parameters.blocks if b.name == DIRECTIVITY), None)
    if block is None:
        return None
    first = position_of(parameters, DIRECTIVITY)
    own = slice(first, first + len(block.labels))
    return vector[own], covariance[own, own]


def prior_absorptions(
    priors: tuple[MaterialPrior, ...], band: int, n_draws: int, rng: np.random.Generator
) -> FloatArray:
    """Return draws of absorption from the priors alone, shape (n_draws, n_materials)."""
    mean, covariance = prior_logit_law(priors)
    noise = rng.standard_normal((len(priors), n_draws))
    names = [k.name for k in priors]
    own = np.array([i for i, k in enumerate(priors) if k.tied_to is None])
    drawn: FloatArray = np.zeros((n_draws, len(priors)))
    root = np.linalg.cholesky(covariance[band][np.ix_(own, own)])
    drawn[:, own] = (mean[own, band, None] + root @ noise[own]).T
    for i, k in enumerate(priors):
        free = k.lower + (k.upper - k.lower) * expit(drawn[:, i])
        drawn[:, i] = free if k.known is None else k.known[band]
    return drawn[:, [names.index(k.tied_to or k.name) for k in priors]]


def prior_only_band(priors: tuple[MaterialPrior, ...], band: int) -> BandEstimate:
    """Return the answer of a band without data: the prior, 0 to 1 where none was stated."""
    mean, law = prior_logit_law(priors)
    stated = are_specified(priors)
    by_name = {k.name: k for k in priors}
    priors = tuple(by_name[k.tied_to or k.name] for k in priors)
    fixed = np.array([k.known is not None for k in priors])
    known = np.array([np.nan if k.known is None else k.known[band] for k in priors])
    free = mean[:, band]
    lower = np.array([k.lower for k in priors])
    upper = np.array([k.upper for k in priors])
    expected = lower + (upper - lower) * expit(free)
    absorption = np.where(fixed, known, expected)
    covariance = np.where(fixed[:, None] | fixed, 0.0, law[band])
    sd = np.sqrt(np.diag(covariance))
    low, high = (lower + (upper - lower) * expit(free + z * sd) for z in (-Z95, Z95))
    least = np.where(fixed, known, np.where(stated, low, 0.0))
    most = np.where(fixed, known, np.where(stated, high, 1.0))
    return BandEstimate(
        absorption,
        least,
        most,
        free,
        covariance,
        0.0,
        0.0,
        0,
        Ending.CONVERGED,
        "prior",
        kinds=_kinds(least, most, ~fixed),
    )
