"""Use case: the absorption of a measured room."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from roomfit.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.app.comparing import compare_pairs
from roomfit.app.fitting import (
    BandAnswer,
    fit_bands,
    fit_findings,
    schroeder_findings,
)
from roomfit.app.measuring import MeasuredPair, measure
from roomfit.app.planning import plan_trace
from roomfit.app.problems import (
    BinnedPaths,
    band_problems,
    bin_paths,
    left_out_findings,
    untold_band_findings,
    untold_position_findings,
)
from roomfit.app.progress import part
from roomfit.files.campaign.campaign import (
    Campaign,
    input_files,
    read_campaign,
)
from roomfit.files.campaign.materials import material_knowledge
from roomfit.files.results import write_result
from roomfit.files.rooms.read import read_room
from roomfit.files.store import (
    check_output_folder,
    whole_output_folder,
    write_bytes_atomically,
)
from roomfit.findings import Finding
from roomfit.geometry.faults import refuse
from roomfit.geometry.measures import surface_area_m2, volume_m3
from roomfit.identification.start import eyring_absorption
from roomfit.materials.knowledge import MaterialKnowledge
from roomfit.scene.positions import position_findings
from roomfit.scene.room import Room, material_areas_m2
from roomfit.scene.scene import Scene
from roomfit.signals.room_parameters import ParameterName
from roomfit.tracing.join import trace
from roomfit.typing import FloatArray, Progress
from roomfit.uncertainty.answer import Answer
from roomfit.uncertainty.posterior_draws import plain_logit_covariance

INTERVAL_KIND = "Gaussian, local"


def identify_to_folder(
    campaign_file: Path, out: Path, *, overwrite: bool = False, progress: Progress | None = None
) -> Answer:
    """Identify a campaign and write result.json, absorption.csv and pictures into a folder.

    Nothing is written before everything is known, and then all of it or nothing.

    Raises
    ------
    InputError
        Something in the campaign, the room, a response or the output folder is not as needed.
    CannotTell
        The data cannot be fitted at all.
    StoreError
        The disk refuses.
    """
    from roomfit.report.answer_pictures import absorption_figure, decay_figure
    from roomfit.report.pictures import png

    # refused now rather than after minutes of work; made only when there is something to put in
    check_output_folder(out, overwrite=overwrite)
    campaign = read_campaign(campaign_file)
    answer = identify(campaign, progress=part(progress, 0.0, 0.95))
    with whole_output_folder(out, overwrite=overwrite) as folder:
        write_result(folder, answer, input_files(campaign))
        write_bytes_atomically(folder / "absorption.png", png(absorption_figure(answer)))
        for number, pair in enumerate(answer.pairs, start=1):
            name = f"decay_{number:02d}_{_in_file_name(pair.source)}_{_in_file_name(pair.receiver)}"
            write_bytes_atomically(folder / f"{name}.png", png(decay_figure(answer, pair)))
            if progress is not None:
                progress(0.95 + 0.05 * number / len(answer.pairs))
    return answer


def identify(campaign: Campaign, *, progress: Progress | None = None) -> Answer:
    """Return the absorption of every material of a measured room in every band.

    Reads the room and the responses, traces once, fits every band, and predicts every pair.

    Raises
    ------
    InputError, CannotTell
        See `identify_to_folder`.
    """
    began = time.perf_counter()
    room, room_findings = read_room(campaign.room)
    knowledge = material_knowledge(campaign, room.materials)
    scene = campaign_scene(campaign, room)
    measured, measured_findings = measure(campaign, scene)
    slowest_s, latest_s = _time_scales(measured)
    plan = plan_trace(scene, knowledge, slowest_s, latest_s, campaign.seed)
    traced = trace(scene, plan.settings, plan.scattering, part(progress, 0.02, 0.5))
    binned = bin_paths(scene, campaign.bands, traced.paths, plan.settings.duration_s)
    decay_s = _median_decay_s(measured)
    start = _eyring_start(scene, campaign, decay_s)
    problems = band_problems(scene, campaign.bands, knowledge, measured, binned, start)
    answers = fit_bands(
        problems,
        knowledge,
        material_areas_m2(room),
        campaign.method,
        campaign.seed,
        part(progress, 0.5, 0.98),
    )
    untold = untold_band_findings(campaign.bands, [a.model != "prior" for a in answers])
    findings = (
        *room_findings,
        *measured_findings,
        *left_out_findings(campaign.bands, measured),
        *plan.findings,
        *untold_position_findings(scene),
        *traced.findings,
        *untold,
        *fit_findings(campaign.bands, answers),
        *schroeder_findings(campaign.bands, decay_s, volume_m3(room.mesh)),
    )
    return _answer(campaign, scene, measured, binned, answers, findings, began, knowledge)


def _answer(
    campaign: Campaign,
    scene: Scene,
    measured: tuple[MeasuredPair, ...],
    binned: BinnedPaths,
    found: tuple[BandAnswer, ...],
    findings: tuple[Finding, ...],
    began: float,
    knowledge: tuple[MaterialKnowledge, ...],
) -> Answer:
    """Put the bands side by side and predict every pair with what they say."""
    absorption = np.stack([b.absorption for b in found], axis=1)
    attenuation = attenuation_per_m(scene.air, campaign.bands)
    return Answer(
        bands=campaign.bands,
        materials=scene.room.materials,
        areas_m2=material_areas_m2(scene.room),
        absorption=absorption,
        lower95=np.stack([b.lower95 for b in found], axis=1),
        upper95=np.stack([b.upper95 for b in found], axis=1),
        identifiable=np.stack([b.identifiable for b in found], axis=1),
        mean_absorption=np.array([b.mean for b in found]).T,
        phi=np.array([b.phi for b in found]),
        cost=float(sum(b.cost for b in found)),
        evaluations=sum(b.evaluations for b in found),
        converged=np.array([b.converged for b in found]),
        pairs=compare_pairs(campaign.bands, binned, measured, absorption, attenuation),
        findings=findings,
        method="least-squares" if campaign.method == "auto" else campaign.method,
        model="energy",
        interval_kind=INTERVAL_KIND,
        speed_of_sound_m_s=speed_of_sound_m_s(scene.air),
        seed=campaign.seed,
        seconds=time.perf_counter() - began,
        logit_covariance=_logit_covariance(found, absorption, knowledge),
    )


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


def campaign_scene(campaign: Campaign, room: Room) -> Scene:
    """Return the scene of a campaign: each pair once, however often it was measured.

    Raises
    ------
    InputError
        A source or a receiver stands outside the room, in a wall, or upon another.
    """
    pairs = list(dict.fromkeys((m.source, m.receiver) for m in campaign.measurements))
    used_sources, used_receivers = ({pair[i] for pair in pairs} for i in (0, 1))
    sources = tuple(s for s in campaign.sources if s.name in used_sources)
    receivers = tuple(r for r in campaign.receivers if r.name in used_receivers)
    refuse(position_findings(room, sources, receivers))
    source_at = {s.name: i for i, s in enumerate(sources)}
    receiver_at = {r.name: i for i, r in enumerate(receivers)}
    indices = np.array([(source_at[s], receiver_at[r]) for s, r in pairs])
    return Scene(room, sources, receivers, indices, campaign.air)


def _in_file_name(name: str) -> str:
    """Return a name without what a path gives a meaning to."""
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in name)[:60]


def _time_scales(measured: tuple[MeasuredPair, ...]) -> tuple[float, float]:
    """Return the longest decay time of any band, and where the last usable window ends, in s.

    What is kept for validation has no say, so that it cannot change the answer.
    """
    fitted = [m for m in measured if m.file.use == "fit"]
    longest = 0.0
    for m in fitted:
        for name in ("T20_s", "EDT_s"):
            values = m.parameters.of(name)
            known = values[np.isfinite(values)]
            if known.size:
                longest = max(longest, float(known.max()))
                break
    # a decay that nothing could evaluate still ends where it drowns
    latest = max(float(m.noise.usable_end_s.max()) for m in fitted)
    return longest, min(latest, longest) if longest > 0.0 else latest


def _median_decay_s(measured: tuple[MeasuredPair, ...]) -> FloatArray:
    """Return the median reverberation time over the fitted pairs, NaN where none is known.

    Of T20, or of EDT in a band where no pair has the range for T20; shape (n_bands,).
    """
    fitted = [m.parameters for m in measured if m.file.use == "fit"]
    found: FloatArray = np.full(len(fitted[0].bands), np.nan)
    names: tuple[ParameterName, ...] = ("EDT_s", "T20_s")
    for name in names:
        for band, values in enumerate(np.array([p.of(name) for p in fitted]).T):
            if np.any(np.isfinite(values)):
                found[band] = np.median(values[np.isfinite(values)])
    return found


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
