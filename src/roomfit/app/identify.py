"""Use case: the absorption of a measured room."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from roomfit.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.app.certifying import certificate_findings, check_certifiable
from roomfit.app.combinations import determined, inseparable_findings
from roomfit.app.comparing import compare_all
from roomfit.app.directing.bands import fitted_directivities
from roomfit.app.fit_doubts import description_findings, fit_findings, schroeder_findings
from roomfit.app.fitting import BandAnswer
from roomfit.app.folder_pictures import write_pictures
from roomfit.app.gathering import Gathered, campaign_scene, gather, median_decay_s
from roomfit.app.mirrors import mirror_findings, mirror_symmetries
from roomfit.app.priors import prior_findings, prior_intervals
from roomfit.app.problems import (
    left_out_findings,
    untold_band_findings,
    untold_position_findings,
)
from roomfit.app.progress import part
from roomfit.app.reasons import interval_words, method_chosen, reasons, sampling_findings
from roomfit.app.refining import Refinement
from roomfit.app.smoothing import smoothed
from roomfit.app.solving import Solved, solve
from roomfit.app.starts import starts_findings
from roomfit.app.tracing import TracedCampaign, redirected, trace_campaign
from roomfit.files.cache import Cache, cache_of
from roomfit.files.campaign.campaign import Campaign, input_files, read_campaign
from roomfit.files.campaign.materials import material_knowledge
from roomfit.files.results import input_digests, write_result
from roomfit.files.rooms.read import read_room
from roomfit.files.store import (
    check_output_folder,
    whole_output_folder,
    write_text_atomically,
)
from roomfit.findings import Finding
from roomfit.geometry.measures import surface_area_m2, volume_m3
from roomfit.identification.start import eyring_absorption
from roomfit.materials.knowledge import MaterialKnowledge
from roomfit.scene.room import material_areas_m2
from roomfit.scene.scene import Scene
from roomfit.typing import FloatArray, Progress
from roomfit.uncertainty.answer import Answer
from roomfit.uncertainty.posterior import plain_logit_covariance
from roomfit.uncertainty.sampling import check_sampler

# Something about the room is not as told: what is found of any wall makes up for it.
_NOTHING_IDENTIFIABLE = ("outline-disagrees", "description-doubtful")
# What an earlier run may have left in a folder that is written over.
OWN_FILES = (
    *("result.json", "absorption.csv", "absorption.png", "report.html"),
    *("identifiable.png", "profiles.png", "corner_[0-9]*_hz.png", "decay_[0-9]*.png"),
)


def identify_to_folder(
    campaign_file: Path,
    out: Path,
    *,
    overwrite: bool = False,
    keep: bool = True,
    progress: Progress | None = None,
) -> Answer:
    """Identify a campaign and write result.json, tables, pictures and report into a folder.

    Nothing is written before everything is known, and then all of it or nothing.

    Parameters
    ----------
    campaign_file, out : Path
    overwrite : bool
        Write into a folder that is not empty.
    keep : bool
        Keep the trace in the output folder, so that a run that was stopped goes on from there.
    progress : callable, optional

    Raises
    ------
    InputError
        Something in the campaign, the room, a response or the output folder is not as needed.
    CannotTell
        The data cannot be fitted at all.
    StoreError
        The disk refuses.
    """
    from roomfit.report.html.page import report_html

    # refused now rather than after minutes of work; made only when there is something to put in
    check_output_folder(out, overwrite=overwrite)
    campaign = read_campaign(campaign_file)
    cache = cache_of(out) if keep else None
    answer = identify(campaign, cache=cache, progress=part(progress, 0.0, 0.95))
    inputs = input_files(campaign)
    room, _ = read_room(campaign.room)
    page = report_html(
        answer,
        campaign_scene(campaign, room),
        title=f"Absorption: {campaign_file.stem}",
        campaign=campaign_file.name,
        inputs_sha256=input_digests(inputs),
    )
    with whole_output_folder(out, overwrite=overwrite, own=OWN_FILES) as folder:
        write_result(folder, answer, inputs)
        write_text_atomically(folder / "report.html", page)
        write_pictures(folder, answer, part(progress, 0.95, 1.0))
    return answer


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
    knowledge = material_knowledge(campaign, room.materials)
    gathered = gather(campaign, room)
    decay_s = median_decay_s(gathered, campaign.bands.centres_hz)
    start = _eyring_start(gathered.scene, campaign, decay_s)
    traced = trace_campaign(campaign, gathered, knowledge, start, cache, part(progress, 0.02, 0.45))
    solved = solve(
        *(campaign, gathered, knowledge, traced.paths, traced.factors, traced.binned, start),
        traced.far_images,
        traced.fit_until_s,
        traced.again,
        _refinement(campaign, gathered, knowledge),
        part(progress, 0.45, 0.98),
    )
    if solved.directivities:
        traced = redirected(campaign, gathered.scene, traced, solved.directivities)
    answers = solved.answers
    if campaign.smoothness_per_octave is not None:
        answers = smoothed(
            *(answers, knowledge, campaign.bands, campaign.smoothness_per_octave),
            areas_m2=material_areas_m2(room),
        )
    findings = (
        *room_findings,
        *gathered.findings,
        *left_out_findings(campaign.bands, gathered.responses),
        *traced.findings,
        *untold_position_findings(gathered.scene),
        *untold_band_findings(campaign.bands, [a.model != "prior" for a in answers]),
        *solved.findings,
        *fit_findings(campaign.bands, answers),
        *description_findings(answers),
        *certificate_findings(campaign.bands, [a.certificate for a in answers]),
        *starts_findings(campaign.bands, room.materials, [a.starts for a in answers]),
        *sampling_findings(campaign.bands, answers),
        *prior_findings(campaign.bands, knowledge, answers),
        *schroeder_findings(campaign.bands, decay_s, volume_m3(room.mesh)),
    )
    return _answer(
        campaign, gathered, traced, replace(solved, answers=answers), findings, began, knowledge
    )


def _answer(
    campaign: Campaign,
    gathered: Gathered,
    traced: TracedCampaign,
    solved: Solved,
    findings: tuple[Finding, ...],
    began: float,
    knowledge: tuple[MaterialKnowledge, ...],
) -> Answer:
    """Put the bands side by side and predict every pair with what they say."""
    scene, found = gathered.scene, solved.answers
    absorption = np.stack([b.absorption for b in found], axis=1)
    identifiable = np.stack([b.identifiable for b in found], axis=1)
    if any(f.code in _NOTHING_IDENTIFIABLE for f in findings):
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
    prior = _logit_prior(knowledge)
    told = determined(
        *(scene.room.materials, absorption, covariance, prior, areas, campaign.seed),
        [b.samples for b in found],
    )
    models = tuple(b.model for b in found)
    inseparable = inseparable_findings(
        scene.room.materials, campaign.bands.centres_hz, identifiable, told.combinations
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


def _refinement(
    campaign: Campaign, gathered: Gathered, knowledge: tuple[MaterialKnowledge, ...]
) -> Refinement:
    """Return what is done to every band after its fit; the paper's searches end where they end."""
    intervals: Literal["gaussian", "profile", "posterior"] = "profile"
    if campaign.method in ("simplex", "annealing"):
        intervals = "gaussian"
    elif campaign.method == "posterior":
        intervals = "posterior"
    return Refinement(
        *(intervals, material_areas_m2(gathered.scene.room), campaign.seed),
        tuple(s.exchange for s in mirror_symmetries(gathered, knowledge)),
    )


def _model_of(models: tuple[str, ...]) -> str:
    """Return the most that any band's model knew."""
    return next((m for m in ("coherent", "energy", "values") if m in models), "prior")


def _logit_prior(knowledge: tuple[MaterialKnowledge, ...]) -> FloatArray:
    """Return mean and spread of logit absorption beforehand, of its leader where one is tied."""
    by_name = {k.name: k for k in knowledge}
    leaders = [by_name[k.tied_to or k.name] for k in knowledge]
    return np.array([[k.prior_logit_mean for k in leaders], [k.prior_logit_sd for k in leaders]])


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
