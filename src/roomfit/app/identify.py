"""Use case: the absorption of a measured room."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from roomfit.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.app.assembling import assembled
from roomfit.app.certainty.certifying import certificate_findings, check_certifiable
from roomfit.app.certainty.fit_doubts import description_findings, fit_findings, schroeder_findings
from roomfit.app.certainty.mirrors import mirror_symmetries
from roomfit.app.certainty.priors import prior_findings
from roomfit.app.certainty.reasons import sampling_findings
from roomfit.app.certainty.refining import Refinement
from roomfit.app.certainty.starts import starts_findings
from roomfit.app.folder_pictures import write_pictures
from roomfit.app.gathering import Gathered, campaign_scene, gather, median_decay_s
from roomfit.app.problems import (
    left_out_findings,
    untold_band_findings,
    untold_position_findings,
)
from roomfit.app.progress import part
from roomfit.app.smoothing import smoothed
from roomfit.app.solving import solve
from roomfit.app.tracing import redirected, trace_campaign
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
from roomfit.geometry.measures import surface_area_m2, volume_m3
from roomfit.identification.start import eyring_absorption
from roomfit.materials.knowledge import MaterialKnowledge
from roomfit.scene.room import material_areas_m2
from roomfit.scene.scene import Scene
from roomfit.threads import one_blas_thread
from roomfit.typing import FloatArray, Progress
from roomfit.uncertainty.answer import Answer
from roomfit.uncertainty.sampling import check_sampler

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
    return assembled(
        campaign, gathered, traced, replace(solved, answers=answers), findings, began, knowledge
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
