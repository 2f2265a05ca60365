"""What is known of the absorption before a design, as the choice of positions needs it."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from roomfit.base.bands import Bands
from roomfit.base.errors import InputError
from roomfit.base.logit import expit, logit
from roomfit.base.typing import FloatArray, IntArray
from roomfit.materials.priors import MaterialPrior, prior_logit_law
from roomfit.model.observation import absorption_block
from roomfit.model.parameters import leaders
from roomfit.uncertainty.posterior import AbsorptionPosterior

# Of a variance in logit: nothing is known better than to a millionth.
_LEAST_VARIANCE = 1e-12


class Unknowns(NamedTuple):
    """The absorptions that are to be found, and what is known of them before the choice.

    All for several draws of the absorption, since the information of a measurement depends on the
    absorption that is not known yet.
    """

    # (n_materials,), which of the n unknowns is each material's absorption; -1 where it is known.
    # Materials that share an absorption share a number.
    number: IntArray
    # (n_draws, n_bands, n): log(s / (1 - s)), s the share of the way from lower to upper bound
    logit: FloatArray
    information: FloatArray  # (n_draws, n_bands, n, n), that exists already: positive definite
    lower: FloatArray  # (n,), bound of each absorption
    upper: FloatArray  # (n,)


class PriorInformation(NamedTuple):
    """What is known before the measurements that are to be chosen."""

    bands: Bands
    priors: tuple[MaterialPrior, ...]
    unknowns: Unknowns
    typical: FloatArray  # (n_materials, n_bands), the middle of the prior
    draws: FloatArray  # (n_draws, n_materials, n_bands)


def information_from_priors(
    priors: tuple[MaterialPrior, ...], bands: Bands, n: int, rng: np.random.Generator
) -> PriorInformation:
    """Return the prior of every material, with n draws.

    The draws are a Latin hypercube of the priors, each band's its own: every absorption takes
    values spread evenly over its prior.
    """
    number, leader, free = _numbers(priors)
    mean, covariance = prior_logit_law(priors)
    own = np.flatnonzero(leader == np.arange(leader.size))
    roots = np.linalg.cholesky(covariance[:, own[:, None], own])
    strata = rng.permuted(np.broadcast_to(np.arange(n), (*mean.shape, n)), axis=-1)
    even = np.moveaxis(ndtri((strata + 0.5) / n), -1, 0)
    drawn: FloatArray = np.tile(mean, (n, 1, 1))
    drawn[:, own] += np.einsum("bij,njb->nib", roots, even[:, own])
    drawn = drawn[:, leader]
    prior = np.linalg.inv(covariance[:, free[:, None], free])
    return PriorInformation(
        bands,
        priors,
        _unknowns(priors, number, free, drawn, np.tile(prior, (n, 1, 1, 1))),
        _absorption(priors, mean[None], leader)[0],
        _absorption(priors, drawn, leader),
    )


def information_from_fit(
    specified: tuple[MaterialPrior, ...], found: AbsorptionPosterior
) -> PriorInformation:
    """Return what a finished fit says of every material, in its bands.

    Bounds are left to the fit: intervals afterwards are those of plain logit absorption, as the
    result's covariance is.
    Ties and delays of walls are taken from what is specified, in the bands of the fit.
    """
    variance = np.diagonal(found.logit_covariance, axis1=1, axis2=2).T
    priors = tuple(
        replace(
            k,
            lower=0.0,
            upper=1.0,
            known=a if k.tied_to is None and np.all(v <= _LEAST_VARIANCE) else k.known,
        )
        for k, a, v in zip(specified, found.absorption, variance, strict=True)
    )
    if found.scattering is not None:
        priors = tuple(
            replace(k, scattering=None if np.isnan(row).any() else row)
            for k, row in zip(priors, found.scattering, strict=True)
        )
    number, leader, free = _numbers(priors)
    covariance = found.logit_covariance[:, free[:, None], free]
    inverse = np.linalg.inv(covariance + _LEAST_VARIANCE * np.eye(free.size))
    information: FloatArray = np.asarray(0.5 * (inverse + np.swapaxes(inverse, 1, 2)))
    at = logit(found.absorption)[None]
    return PriorInformation(
        found.bands,
        priors,
        _unknowns(priors, number, free, at, information[None]),
        found.absorption,
        _absorption(priors, at, leader),
    )


def _numbers(priors: tuple[MaterialPrior, ...]) -> tuple[IntArray, IntArray, IntArray]:
    """Return each material's unknown, -1 where it is known, its leader, and which are free."""
    block = absorption_block(priors, 0, 0.2)
    leader = leaders(block)
    count = np.cumsum(block.fitted) - 1
    number = np.where(block.fitted[leader], count[leader], -1)
    free = np.flatnonzero((number >= 0) & (leader == np.arange(leader.size)))
    return number, np.asarray(leader), free


def _unknowns(
    priors: tuple[MaterialPrior, ...],
    number: IntArray,
    free: IntArray,
    drawn: FloatArray,
    information: FloatArray,
) -> Unknowns:
    if not free.size:
        found = "every material's absorption is given"
        needed = "one material at least whose absorption is fitted"
        hint = "remove absorption = [...] where it is not sure"
        raise InputError("no absorption is left to be found", found=found, needed=needed, hint=hint)
    return Unknowns(
        number,
        np.swapaxes(drawn[:, free], 1, 2),
        information,
        np.array([priors[i].lower for i in free]),
        np.array([priors[i].upper for i in free]),
    )


def _absorption(
    priors: tuple[MaterialPrior, ...], free: FloatArray, leader: IntArray
) -> FloatArray:
    """Return absorption of free numbers, known ones as they are, both (n_draws, n_materials, m)."""
    low = np.array([k.lower for k in priors])[leader, None]
    high = np.array([k.upper for k in priors])[leader, None]
    out = low + (high - low) * expit(free)
    for i, of in enumerate(leader):
        known = priors[of].known
        if known is not None:
            out[:, i] = known
    return np.asarray(out)
