"""What is known of the absorption before a design, as the choice of places needs it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit, ndtri

from roomfit.app.predicting.scene import predicted_bands, room_posterior, scattering_known
from roomfit.app.problems import absorption_block
from roomfit.bands import Bands
from roomfit.files.campaign.campaign import Campaign
from roomfit.files.campaign.materials import material_knowledge
from roomfit.findings import Finding
from roomfit.materials.knowledge import MaterialKnowledge, in_bands
from roomfit.objective.parameters import leaders
from roomfit.placement.information import Unknowns
from roomfit.typing import FloatArray, IntArray
from roomfit.uncertainty.posterior import AbsorptionPosterior, logit

# Of a variance in logit: nothing is known better than to a millionth.
_LEAST_VARIANCE = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What is known beforehand.

    Attributes
    ----------
    bands : Bands
    knowledge : tuple of MaterialKnowledge
    unknowns : Unknowns
    typical : float array, shape (n_materials, n_bands)
        Middle of what is known.
    draws : float array, shape (n_draws, n_materials, n_bands)
    findings : tuple of Finding
    """

    bands: Bands
    knowledge: tuple[MaterialKnowledge, ...]
    unknowns: Unknowns
    typical: FloatArray
    draws: FloatArray
    findings: tuple[Finding, ...] = ()


def known_by_priors(campaign: Campaign, materials: tuple[str, ...]) -> Known:
    """Return what the campaign tells of every material, or else the broad prior.

    The draws are a Latin hypercube of the priors, each band's its own: every absorption takes
    values spread evenly over its prior.
    """
    knowledge = material_knowledge(campaign, materials)
    number, leader = _numbers(knowledge)
    mean = np.stack([k.prior_logit_mean for k in knowledge])[leader]
    sd = np.stack([k.prior_logit_sd for k in knowledge])[leader]
    n, rng = campaign.design.draws, np.random.default_rng(campaign.seed)
    strata = rng.permuted(np.broadcast_to(np.arange(n), (*mean.shape, n)), axis=-1)
    drawn: FloatArray = mean + sd * np.moveaxis(ndtri((strata + 0.5) / n), -1, 0)
    free = np.flatnonzero(_is_free(number, leader))
    prior: FloatArray = np.stack([np.diag(row) for row in sd[free].T ** -2.0])
    return Known(
        campaign.bands,
        knowledge,
        _unknowns(knowledge, number, free, drawn, np.tile(prior, (n, 1, 1, 1))),
        _absorption(knowledge, mean[None], leader)[0],
        _absorption(knowledge, drawn, leader),
    )


def known_by_fit(
    campaign: Campaign, materials: tuple[str, ...], found: AbsorptionPosterior
) -> Known:
    """Return what a finished fit tells of every material, in the bands that it has.

    Bounds are left to the fit: intervals afterwards are those of plain logit absorption, as the
    result's covariance is.

    Raises
    ------
    InputError
        The result and the campaign have no band in common, or a material's absorption is nowhere
        told.
    """
    bands, findings = predicted_bands(campaign, found.bands)
    places = np.flatnonzero(np.isin(campaign.bands.centres_hz, bands.centres_hz))
    told = in_bands(material_knowledge(campaign, materials), places)
    knowledge = scattering_known(told, bands, found)
    posterior = room_posterior(campaign, knowledge, bands, found)
    variance = np.diagonal(posterior.logit_covariance, axis1=1, axis2=2).T
    knowledge = tuple(
        replace(
            k,
            lower=0.0,
            upper=1.0,
            known=a if k.tied_to is None and np.all(v <= _LEAST_VARIANCE) else k.known,
        )
        for k, a, v in zip(knowledge, posterior.absorption, variance, strict=True)
    )
    number, leader = _numbers(knowledge)
    free = np.flatnonzero(_is_free(number, leader))
    covariance = posterior.logit_covariance[:, free[:, None], free]
    inverse = np.linalg.inv(covariance + _LEAST_VARIANCE * np.eye(free.size))
    information: FloatArray = np.asarray(0.5 * (inverse + np.swapaxes(inverse, 1, 2)))
    at = logit(posterior.absorption)[None]
    return Known(
        bands,
        knowledge,
        _unknowns(knowledge, number, free, at, information[None]),
        posterior.absorption,
        _absorption(knowledge, at, leader),
        findings,
    )


def _numbers(knowledge: tuple[MaterialKnowledge, ...]) -> tuple[IntArray, IntArray]:
    """Return the number of each material's unknown, -1 where it is known, and its leader."""
    block = absorption_block(knowledge, 0, 0.2)
    leader = leaders(block)
    count = np.cumsum(block.fitted) - 1
    return np.where(block.fitted[leader], count[leader], -1), np.asarray(leader)


def _is_free(number: IntArray, leader: IntArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    return np.asarray((number >= 0) & (leader == np.arange(leader.size)))


def _unknowns(
    knowledge: tuple[MaterialKnowledge, ...],
    number: IntArray,
    free: IntArray,
    drawn: FloatArray,
    information: FloatArray,
) -> Unknowns:
    return Unknowns(
        tuple(k.name for k in knowledge),
        number,
        np.swapaxes(drawn[:, free], 1, 2),
        information,
        np.array([knowledge[i].lower for i in free]),
        np.array([knowledge[i].upper for i in free]),
    )


def _absorption(
    knowledge: tuple[MaterialKnowledge, ...], free: FloatArray, leader: IntArray
) -> FloatArray:
    """Return absorption of free numbers, known ones as they are, both (n_draws, n_materials, m)."""
    low = np.array([k.lower for k in knowledge])[leader, None]
    high = np.array([k.upper for k in knowledge])[leader, None]
    out = low + (high - low) * expit(free)
    for i, of in enumerate(leader):
        known = knowledge[of].known
        if known is not None:
            out[:, i] = known
    return np.asarray(out)
