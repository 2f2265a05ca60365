"""The answers of all bands side by side, with what they say together."""

from __future__ import annotations

import time

import numpy as np

from roomfit.air import speed_of_sound_m_s
from roomfit.app.certainty.combinations import determined, inseparable_findings
from roomfit.app.certainty.mirrors import mirror_findings
from roomfit.app.certainty.priors import prior_intervals
from roomfit.app.certainty.reasons import interval_words, method_chosen, reasons
from roomfit.app.comparing import compare_all
from roomfit.app.directing.bands import fitted_directivities
from roomfit.app.fitting import BandAnswer
from roomfit.app.gathering import Gathered
from roomfit.app.solving import Solved
from roomfit.app.tracing import TracedCampaign
from roomfit.files.campaign.campaign import Campaign
from roomfit.findings import Finding
from roomfit.materials.knowledge import MaterialKnowledge, prior_logits
from roomfit.scene.room import material_areas_m2
from roomfit.typing import FloatArray
from roomfit.uncertainty.answer import Answer
from roomfit.uncertainty.posterior import plain_logit_covariance

# Something about the room is not as told: what is found of any wall makes up for it.
_NOTHING_IDENTIFIABLE = (
    "outline-disagrees",
    "description-doubtful",
    "walls-delay",
    "places-move",
    "source-directs",
    "scattering-suspected",
)


def assembled(
    campaign: Campaign,
    gathered: Gathered,
    traced: TracedCampaign,
    solved: Solved,
    findings: tuple[Finding, ...],
    began: float,
    knowledge: tuple[MaterialKnowledge, ...],
) -> Answer:
    """Put the bands side by side and predict every pair with what they say.

    Parameters
    ----------
    findings : tuple of Finding
        All that is doubtful before the bands are seen together.
    began : float
        Of `time.perf_counter`.
    """
    scene, found = gathered.scene, solved.answers
    absorption = np.stack([b.absorption for b in found], axis=1)
    identifiable = np.stack([b.identifiable for b in found], axis=1)
    told_wrong = any(f.code in _NOTHING_IDENTIFIABLE for f in findings)
    if told_wrong:
        identifiable &= np.array([[k.known is not None] for k in knowledge])
    lower, upper = (
        np.stack([getattr(b, n) for b in found], axis=1) for n in ("lower95", "upper95")
    )
    ambiguous, mirrors = mirror_findings(
        *(gathered, campaign.bands, knowledge, absorption, lower, upper),
        [b.mirrors for b in found],
    )
    identifiable &= ~ambiguous
    areas = material_areas_m2(scene.room)
    covariance = _logit_covariance(found, absorption, knowledge)
    prior = prior_logits(knowledge)
    told = determined(
        *(scene.room.materials, absorption, covariance, prior, areas, campaign.seed),
        [b.samples for b in found],
    )
    models = tuple(b.model for b in found)
    inseparable = (
        ()
        if told_wrong
        else inseparable_findings(
            scene.room.materials, campaign.bands.centres_hz, identifiable, told.combinations
        )
    )
    return Answer(
        bands=campaign.bands,
        materials=scene.room.materials,
        areas_m2=areas,
        absorption=absorption,
        lower95=lower,
        upper95=upper,
        identifiable=identifiable,
        # the first combination of a band is the mean over the whole room
        mean_absorption=np.array(
            [(c[0].value, c[0].lower95, c[0].upper95) for c in told.combinations]
        ).T,
        phi=np.array([b.phi for b in found]),
        cost=float(sum(b.cost for b in found)),
        evaluations=sum(b.evaluations for b in found),
        converged=np.array([b.converged for b in found]),
        pairs=compare_all(campaign, gathered, traced.binned, absorption),
        findings=(*findings, *mirrors, *inseparable),
        method=method_chosen(campaign.method),
        model=_model_of(models),
        interval_kind=interval_words(found),
        speed_of_sound_m_s=speed_of_sound_m_s(scene.air),
        seed=campaign.seed,
        seconds=time.perf_counter() - began,
        logit_covariance=covariance,
        logit_prior=prior,
        combinations=told.combinations,
        sentences=told.sentences,
        shares=told.shares,
        interval_kinds=tuple(b.kinds for b in found),
        profiles=tuple(b.profiles for b in found),
        samples=tuple(b.samples for b in found),
        sampling=tuple(b.sampling for b in found),
        prior=prior_intervals(knowledge),
        reasons=reasons(campaign.method, campaign.bands, found),
        models=models,
        scattering=traced.scattering,
        geometry=solved.geometry,
        directivities=fitted_directivities(solved.directivities),
        certificates=tuple(b.certificate for b in found),
    )


def _model_of(models: tuple[str, ...]) -> str:
    """Return the most that any band's model knew."""
    return next((m for m in ("coherent", "energy", "values") if m in models), "prior")


def _logit_covariance(
    found: tuple[BandAnswer, ...], absorption: FloatArray, knowledge: tuple[MaterialKnowledge, ...]
) -> FloatArray:
    """Return the covariance of logit absorption in every band, whatever the bounds of the fit."""
    names = [k.name for k in knowledge]
    leaders = [names.index(k.tied_to or k.name) for k in knowledge]
    return plain_logit_covariance(
        np.stack([b.logit_covariance for b in found]),
        absorption,
        np.array([k.lower for k in knowledge])[leaders],
        np.array([k.upper for k in knowledge])[leaders],
    )
