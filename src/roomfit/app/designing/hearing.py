"""All candidates traced, source by source, and what each of them would tell."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from roomfit.air import speed_of_sound_m_s
from roomfit.app.designing.information import DesignTrace, Foreseen, information_of_pairs
from roomfit.app.designing.knowing import Known
from roomfit.app.planning import TracePlan, plan_trace
from roomfit.app.predicting.trace import eyring_time_s
from roomfit.app.progress import part
from roomfit.app.solving import fits_pressures, relative_speed_sd
from roomfit.app.weighting import band_factors, told_scattering
from roomfit.files.campaign.campaign import Campaign
from roomfit.findings import Finding
from roomfit.geometry.measures import volume_m3
from roomfit.scene.scene import Scene
from roomfit.tracing.join import trace
from roomfit.tracing.settings import TraceSettings
from roomfit.typing import FloatArray, IntArray, Progress

# Rays caught by all receivers of one source: more would fill memory for nothing.
_MOST_CAUGHT = 4e6
_FEWEST_RAYS = 2_000
# The part of the time that tracing takes.
_TRACING = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class HeardCandidates:
    """What all candidates would tell.

    Attributes
    ----------
    matrices : float array, shape (n_pairs, n_draws, n_bands, n + 1, n + 1)
        See `information_of_pairs`.
    coherent : bool
        Whether by pressures of image sources.
    findings : tuple of Finding
    """

    matrices: FloatArray
    coherent: bool
    findings: tuple[Finding, ...]


def heard_candidates(
    campaign: Campaign, scene: Scene, known: Known, n_pairs: int, progress: Progress | None
) -> HeardCandidates:
    """Trace the candidates of every source at once and return what each of them would tell.

    Parameters
    ----------
    scene : Scene
        With all pairs.
    n_pairs : int
        How many will have been measured in the end.
    """
    plan = _plan(campaign, scene, known)
    foreseen = _foreseen(campaign, known, plan, n_pairs)
    findings = list(plan.findings)
    found: list[FloatArray] = []
    places: list[IntArray] = []
    sources = np.unique(scene.pairs[:, 0])
    for number, source in enumerate(sources):
        at = np.flatnonzero(scene.pairs[:, 0] == source)
        own = replace(scene, pairs=scene.pairs[at])
        done = part(progress, number / sources.size, (number + 1) / sources.size)
        traced, doubts = _traced(campaign, own, known, plan, part(done, 0.0, _TRACING))
        findings += [f for f in doubts if f.code not in {g.code for g in findings}]
        found.append(
            information_of_pairs(
                *(own, traced, foreseen, known.typical, known.draws), part(done, _TRACING, 1.0)
            )
        )
        places.append(at)
    # back from the order of the sources to that of the pairs
    matrices = np.concatenate(found)[np.argsort(np.concatenate(places))]
    return HeardCandidates(matrices, foreseen.coherent, tuple(findings))


def _plan(campaign: Campaign, scene: Scene, known: Known) -> TracePlan:
    """Choose how to trace: as for a fit, for as long as decays will be heard."""
    decay_s = float(eyring_time_s(scene, known.bands, known.typical).max())
    # how far image sources can be had costs several searches for them: one source stands for all
    first = replace(scene, pairs=scene.pairs[scene.pairs[:, 0] == scene.pairs[0, 0]])
    heard_s = decay_s * campaign.design.decay_range_db / 60.0
    plan = plan_trace(
        *(first, known.knowledge, decay_s, heard_s, campaign.seed),
        coherent=fits_pressures(campaign),
    )
    return replace(plan, settings=_with_fewer_rays(plan.settings, scene))


def _with_fewer_rays(settings: TraceSettings, scene: Scene) -> TraceSettings:
    """Return settings under which the receivers of one source catch some million rays at most.

    A ray of length l crosses a sphere of radius r in a volume V ``pi r**2 l / V`` times on average.
    """
    length_m = settings.duration_s * speed_of_sound_m_s(scene.air)
    crossings = np.pi * settings.receiver_radius_m**2 * length_m / volume_m3(scene.room.mesh)
    most = int(np.bincount(scene.pairs[:, 0]).max())
    affordable = int(_MOST_CAUGHT / (crossings * most))
    return replace(settings, n_rays=min(settings.n_rays, max(affordable, _FEWEST_RAYS)))


def _foreseen(campaign: Campaign, known: Known, plan: TracePlan, n_pairs: int) -> Foreseen:
    return Foreseen(
        known.bands,
        known.knowledge,
        fits_pressures(campaign) and (plan.far_images or campaign.model == "coherent"),
        n_pairs,
        campaign.design.decay_range_db,
        campaign.design.position_sd,
        campaign.wall_delays,
        campaign.positions != "fixed",
        relative_speed_sd(campaign),
    )


def _traced(
    campaign: Campaign, own: Scene, known: Known, plan: TracePlan, progress: Progress | None
) -> tuple[DesignTrace, tuple[Finding, ...]]:
    """Trace the pairs of one source, and weigh their paths in every band."""
    traced = trace(own, plan.settings, plan.scattering, progress)
    scattering = told_scattering(known.knowledge, plan.scattering.coefficients, len(known.bands))
    factors, worn = band_factors(campaign, own, known.bands, traced.paths, scattering)
    # a candidate near a wall is no doubt about anything
    doubts = [f for f in traced.findings if f.code != "receiver-sphere-shrunk"]
    return DesignTrace(traced.paths, factors, plan.settings.duration_s), (*doubts, *worn)
