"""A room traced as far as its decay is to be predicted, with or without a measurement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roomfit.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.app.binning import BinnedPaths, bin_paths
from roomfit.app.cached_trace import cached_trace
from roomfit.app.comparing import predicted_curve
from roomfit.app.planning import plan_trace
from roomfit.app.progress import part
from roomfit.app.weighting import band_factors, told_scattering
from roomfit.bands import Bands
from roomfit.files.cache import Cache
from roomfit.files.campaign.campaign import Campaign
from roomfit.files.campaign.directivity import campaign_directivities
from roomfit.findings import Finding
from roomfit.geometry.measures import surface_area_m2, volume_m3
from roomfit.materials.knowledge import MaterialKnowledge
from roomfit.response.directivity import Directivity
from roomfit.scene.room import material_areas_m2
from roomfit.scene.scene import Scene, distances_m
from roomfit.tracing.settings import TraceSettings
from roomfit.typing import FloatArray, Progress

# T30 is read down to 35 dB below the beginning.
_NEEDED_DB = 36.0
_ATTEMPTS = 4
_LONGER = 1.5
_LONGEST_S = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class FollowedDecay:
    """Paths in bins, with what they were traced and weighed by and what to know about them.

    Attributes
    ----------
    binned : BinnedPaths
    settings : TraceSettings
    weighing : tuple
        Scattering of each material in each band, and the directivity of each source.
    findings : tuple of Finding
    """

    binned: BinnedPaths
    settings: TraceSettings
    weighing: tuple[FloatArray, tuple[Directivity | None, ...]]
    findings: tuple[Finding, ...]


def follow_decay(
    campaign: Campaign,
    scene: Scene,
    bands: Bands,
    knowledge: tuple[MaterialKnowledge, ...],
    absorption: FloatArray,
    measured_decay_s: float,
    cache: Cache | None,
    progress: Progress | None,
) -> FollowedDecay:
    """Trace until every band of every pair has fallen by 36 dB, in up to four attempts.

    How long is estimated from Eyring's formula and the measured decay, the longer of both; where
    walls are unlike, sound between the hard ones lasts longer still, and the trace is repeated.

    Parameters
    ----------
    campaign : Campaign
        Tells the directivity of sources, and the seed.
    knowledge : tuple of MaterialKnowledge
        In these bands; tells how walls scatter.
    absorption : float array, shape (n_materials, n_bands)
    measured_decay_s : float
        Longest measured reverberation time, 0 where none is known.
    """
    longest_s = max(measured_decay_s, float(eyring_time_s(scene, bands, absorption).max()))
    found: list[Finding] = []
    for attempt in range(_ATTEMPTS):
        plan = plan_trace(scene, knowledge, min(longest_s, _LONGEST_S), 0.0, campaign.seed)
        done = part(progress, attempt / _ATTEMPTS, (attempt + 1) / _ATTEMPTS)
        traced = cached_trace(scene, plan.settings, plan.scattering, cache, done)
        found += traced.findings
        paths = traced.value.paths
        scattering = told_scattering(knowledge, plan.scattering.coefficients, len(bands))
        factors, worn = band_factors(campaign, scene, bands, paths, scattering)
        binned = bin_paths(scene, bands, paths, plan.settings.duration_s, factors)
        short = _not_followed(scene, bands, binned, absorption)
        if not short or longest_s >= _LONGEST_S:
            break
        longest_s *= _LONGER
    if progress is not None:
        progress(1.0)
    return FollowedDecay(
        binned,
        plan.settings,
        (scattering, campaign_directivities(campaign, scene, bands)),
        (*plan.findings, *traced.value.findings, *found, *worn, *_short_finding(bands, short)),
    )


def eyring_time_s(scene: Scene, bands: Bands, absorption: FloatArray) -> FloatArray:
    """Return the reverberation time of a diffuse field in every band, shape (n_bands,).

    References
    ----------
    .. [1] C. F. Eyring, "Reverberation time in 'dead' rooms", J. Acoust. Soc. Am. 1, 217-241
           (1930); with the attenuation of the air.
    """
    mesh = scene.room.mesh
    areas = material_areas_m2(scene.room)
    mean = np.clip(areas @ absorption / areas.sum(), 1e-4, 0.999)
    lost_m2 = -surface_area_m2(mesh) * np.log1p(-mean)
    lost_m2 += 4.0 * volume_m3(mesh) * attenuation_per_m(scene.air, bands)
    return np.asarray(
        24.0 * np.log(10.0) * volume_m3(mesh) / (speed_of_sound_m_s(scene.air) * lost_m2)
    )


def _not_followed(
    scene: Scene, bands: Bands, binned: BinnedPaths, absorption: FloatArray
) -> Sequence[int]:
    attenuation = attenuation_per_m(scene.air, bands)
    direct_s = distances_m(scene) / speed_of_sound_m_s(scene.air)
    usable_db = np.array(
        [
            predicted_curve(bands, binned, i, absorption, attenuation, float(t)).usable_db
            for i, t in enumerate(direct_s)
        ]
    )
    return [int(j) for j in np.flatnonzero(usable_db.min(axis=0) < _NEEDED_DB)]


def _short_finding(bands: Bands, short: Sequence[int]) -> tuple[Finding, ...]:
    if not short:
        return ()
    centres = [float(bands.centres_hz[j]) for j in short]
    return (
        Finding(
            "decay-not-followed",
            "warning",
            f"The trace does not follow the decay over 35 dB at "
            f"{', '.join(f'{f:g}' for f in centres)} Hz: T30 is not predicted there. Some walls "
            "swallow next to nothing.",
            {"bands_hz": centres},
        ),
    )
