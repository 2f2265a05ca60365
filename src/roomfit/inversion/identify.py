"""Use case: the absorption of a measured room.

The answers of all bands side by side, with what they say together.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Literal

import numpy as np

from roomfit._numba import one_blas_thread
from roomfit.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.cache import Cache
from roomfit.eyring import eyring_absorption
from roomfit.findings import Finding
from roomfit.geometry.mesh import surface_area_m2, volume_m3
from roomfit.inversion.bands import starts_findings
from roomfit.inversion.compare import compare_all
from roomfit.inversion.directivity import fitted_directivities
from roomfit.inversion.measurements import Measurements, collect_measurements, median_decay_s
from roomfit.inversion.model_checks import (
    check_certifiable,
    description_findings,
    fit_findings,
    interval_words,
    method_chosen,
    prior_findings,
    prior_intervals,
    reasons,
    sampling_findings,
    schroeder_findings,
)
from roomfit.inversion.paths import TracedCampaign, redirected, trace_campaign
from roomfit.inversion.solve import BandFits, solve
from roomfit.inversion.symmetry import mirror_findings, mirror_symmetries
from roomfit.io.campaign import Campaign
from roomfit.io.materials import material_priors
from roomfit.io.rooms import read_room
from roomfit.materials.priors import MaterialPrior, are_specified, prior_logits
from roomfit.objective.observation import (
    left_out_findings,
    prior_only_band_findings,
    unspecified_position_findings,
)
from roomfit.results import Answer
from roomfit.scene import Scene, material_areas_m2
from roomfit.solvers.certificate import certificate_findings
from roomfit.typing import FloatArray, Progress, part
from roomfit.uncertainty.combinations import determined, inseparable_findings
from roomfit.uncertainty.gaussian import BandAnswer
from roomfit.uncertainty.intervals import Refinement
from roomfit.uncertainty.posterior import plain_logit_covariance
from roomfit.uncertainty.sampling import check_sampler
from roomfit.uncertainty.smoothing import smoothed


def combine(
    campaign: Campaign,
    measurements: Measurements,
    traced: TracedCampaign,
    band_fits: BandFits,
    findings: tuple[Finding, ...],
    began: float,
    priors: tuple[MaterialPrior, ...],
) -> Answer:
    """Put the bands side by side and predict every pair with what they say.

    Parameters
    ----------
    findings : tuple of Finding
        All that is doubtful before the bands are seen together.
    began : float
        Of `time.perf_counter`.
    """
    scene, found = measurements.scene, band_fits.answers
    absorption = np.stack([b.absorption for b in found], axis=1)
    identifiable = np.stack([b.identifiable for b in found], axis=1)
    misspecified = any(f.code.voids_identifiability for f in findings)
    if misspecified:
        identifiable &= np.array([[k.known is not None] for k in priors])
    lower, upper = (
        np.stack([getattr(b, n) for b in found], axis=1) for n in ("lower95", "upper95")
    )
    ambiguous, mirrors = mirror_findings(
        *(measurements, campaign.bands, priors, absorption, lower, upper),
        [b.mirrors for b in found],
    )
    identifiable &= ~ambiguous
    areas = material_areas_m2(scene.room)
    covariance = _logit_covariance(found, absorption, priors)
    prior = prior_logits(priors)
    determined_groups = determined(
        *(scene.room.materials, absorption, covariance, prior, areas, campaign.seed),
        [b.samples for b in found],
        are_specified(priors),
    )
    models = tuple(b.model for b in found)
    inseparable = (
        ()
        if misspecified
        else inseparable_findings(
            scene.room.materials,
            campaign.bands.centres_hz,
            identifiable,
            determined_groups.combinations,
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
            [(c[0].value, c[0].lower95, c[0].upper95) for c in determined_groups.combinations]
        ).T,
        chi2_reduced=np.array([b.chi2_reduced for b in found]),
        cost=float(sum(b.cost for b in found)),
        evaluations=sum(b.evaluations for b in found),
        converged=np.array([b.converged for b in found]),
        pairs=compare_all(campaign, measurements, traced.binned, absorption),
        findings=(*findings, *mirrors, *inseparable),
        method=method_chosen(campaign.method),
        model=_model_of(models),
        interval_kind=interval_words(found),
        speed_of_sound_m_s=speed_of_sound_m_s(scene.air),
        seed=campaign.seed,
        seconds=time.perf_counter() - began,
        logit_covariance=covariance,
        logit_prior=prior,
        prior_specified=are_specified(priors),
        combinations=determined_groups.combinations,
        sentences=determined_groups.sentences,
        shares=determined_groups.shares,
        interval_kinds=tuple(b.kinds for b in found),
        profiles=tuple(b.profiles for b in found),
        samples=tuple(b.samples for b in found),
        sampling=tuple(b.sampling for b in found),
        prior=prior_intervals(priors),
        reasons=reasons(campaign.method, campaign.bands, found),
        models=models,
        scattering=traced.scattering,
        geometry=band_fits.geometry,
        directivities=fitted_directivities(band_fits.directivities),
        certificates=tuple(b.certificate for b in found),
    )


def _model_of(models: tuple[str, ...]) -> str:
    """Return the most that any band's model knew."""
    return next((m for m in ("coherent", "energy", "values") if m in models), "prior")


def _logit_covariance(
    found: tuple[BandAnswer, ...], absorption: FloatArray, priors: tuple[MaterialPrior, ...]
) -> FloatArray:
    """Return the covariance of logit absorption in every band, whatever the bounds of the fit."""
    names = [k.name for k in priors]
    leaders = [names.index(k.tied_to or k.name) for k in priors]
    return plain_logit_covariance(
        np.stack([b.logit_covariance for b in found]),
        absorption,
        np.array([k.lower for k in priors])[leaders],
        np.array([k.upper for k in priors])[leaders],
    )


@one_blas_thread
def identify(
    campaign: Campaign, *, cache: Cache | None = None, progress: Progress | None = None
) -> Answer:
    """Return the absorption of every material of a measured room in every band.

    Reads the room and what was measured, traces, fits every band, and predicts every pair.

    Parameters
    ----------
    campaign : Campaign
    cache : Cache, optional
        Where a trace is kept, and found again by a run that was stopped.
    progress : callable, optional

    Raises
    ------
    InputError, CannotTell
        See `identify_to_folder`.
    """
    began = time.perf_counter()
    check_certifiable(campaign)
    if campaign.method == "posterior":
        check_sampler()
    room, room_findings = read_room(campaign.room)
    priors = material_priors(campaign, room.materials)
    measurements = collect_measurements(campaign, room)
    decay_s = median_decay_s(measurements, campaign.bands.centres_hz)
    start = _eyring_start(measurements.scene, campaign, decay_s)
    traced = trace_campaign(
        campaign, measurements, priors, start, cache, part(progress, 0.02, 0.45)
    )
    band_fits = solve(
        *(campaign, measurements, priors, traced.paths, traced.factors, traced.binned, start),
        traced.far_images,
        traced.fit_until_s,
        traced.again,
        _refinement(campaign, measurements, priors),
        part(progress, 0.45, 0.98),
    )
    if band_fits.directivities:
        traced = redirected(campaign, measurements.scene, traced, band_fits.directivities)
    answers = band_fits.answers
    if campaign.smoothness_per_octave is not None:
        answers = smoothed(
            *(answers, priors, campaign.bands, campaign.smoothness_per_octave),
            areas_m2=material_areas_m2(room),
        )
    findings = (
        *room_findings,
        *measurements.findings,
        *left_out_findings(campaign.bands, measurements.responses),
        *traced.findings,
        *unspecified_position_findings(measurements.scene),
        *prior_only_band_findings(campaign.bands, [a.model != "prior" for a in answers]),
        *band_fits.findings,
        *fit_findings(campaign.bands, answers),
        *description_findings(answers),
        *certificate_findings(campaign.bands, [a.certificate for a in answers]),
        *starts_findings(campaign.bands, room.materials, [a.starts for a in answers]),
        *sampling_findings(campaign.bands, answers),
        *prior_findings(campaign.bands, priors, answers),
        *schroeder_findings(campaign.bands, decay_s, volume_m3(room.mesh)),
    )
    return combine(
        campaign, measurements, traced, replace(band_fits, answers=answers), findings, began, priors
    )


def _refinement(
    campaign: Campaign, measurements: Measurements, priors: tuple[MaterialPrior, ...]
) -> Refinement:
    """Return what is done to every band after its fit; the paper's searches end where they end."""
    intervals: Literal["gaussian", "profile", "posterior"] = "profile"
    if campaign.method in ("simplex", "annealing"):
        intervals = "gaussian"
    elif campaign.method == "posterior":
        intervals = "posterior"
    return Refinement(
        *(intervals, material_areas_m2(measurements.scene.room), campaign.seed),
        tuple(s.exchange for s in mirror_symmetries(measurements, priors)),
    )


def _eyring_start(scene: Scene, campaign: Campaign, decay_s: FloatArray) -> FloatArray:
    """Return one absorption for all walls in every band, from the measured decays."""
    mesh = scene.room.mesh
    attenuation = attenuation_per_m(scene.air, campaign.bands)
    starts = [
        eyring_absorption(
            6.0 * np.log(10.0) / t if np.isfinite(t) else 0.0,
            volume_m3(mesh),
            surface_area_m2(mesh),
            speed_of_sound_m_s(scene.air),
            float(m),
        )
        for t, m in zip(decay_s, attenuation, strict=True)
    ]
    return np.array(starts)
