"""A room traced as far as its decay is to be predicted, with or without a measurement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from roomfit.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.bands import Bands
from roomfit.cache import Cache
from roomfit.findings import Code, Finding
from roomfit.geometry.mesh import surface_area_m2, volume_m3
from roomfit.inversion.compare import predicted_curve
from roomfit.inversion.scattering import band_factors, specified_scattering
from roomfit.inversion.trace_plan import cached_trace, plan_trace
from roomfit.materials.priors import MaterialPrior, unknown_material
from roomfit.response.binned import BinnedPaths, bin_paths
from roomfit.response.directivity import Directivity, known_directivities
from roomfit.scene import Scene, distances_m, material_areas_m2
from roomfit.settings import Settings
from roomfit.tracing.paths import TraceSettings
from roomfit.typing import FloatArray, Progress, part
from roomfit.uncertainty.posterior import AbsorptionPosterior

# T30 is read from 5 to 35 dB below the start of the decay.
_NEEDED_DB = 36.0
_ATTEMPTS = 4
_LONGER = 1.5
_LONGEST_S = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class FollowedDecay:
    """Paths in bins, with what they were traced and weighed by."""

    binned: BinnedPaths
    settings: TraceSettings
    scattering: FloatArray  # (n_materials, n_bands)
    directivities: tuple[Directivity | None, ...]  # of each source
    findings: tuple[Finding, ...]


def follow_decay(
    scene: Scene,
    known: AbsorptionPosterior,
    absorption: FloatArray,
    measured_decay_s: float,
    settings: Settings,
    cache: Cache | None,
    progress: Progress | None,
) -> FollowedDecay:
    """Trace until every band of every pair has fallen by 36 dB, in up to four attempts.

    How long is estimated from Eyring's formula and the measured decay, the longer of both; where
    walls differ much, sound between the hard ones lasts longer still, and the trace is repeated.

    Parameters
    ----------
    known : AbsorptionPosterior
        Bands, scattering and directivities.
    absorption : float array, shape (n_materials, n_bands)
    measured_decay_s : float
        Longest measured reverberation time, 0 where none is known.
    """
    bands, directivities = known.bands, known.directivities or {}
    priors = _scattering_priors(known)
    longest_s = max(measured_decay_s, float(eyring_time_s(scene, bands, absorption).max()))
    found: list[Finding] = []
    for attempt in range(_ATTEMPTS):
        plan = plan_trace(scene, priors, min(longest_s, _LONGEST_S), 0.0, settings)
        done = part(progress, attempt / _ATTEMPTS, (attempt + 1) / _ATTEMPTS)
        traced = cached_trace(scene, plan.settings, plan.scattering, cache, done)
        found += traced.findings
        paths = traced.value.paths
        scattering = specified_scattering(priors, plan.scattering.coefficients, len(bands))
        factors, degenerate = band_factors(directivities, scene, bands, paths, scattering)
        binned = bin_paths(scene, bands, paths, plan.settings.duration_s, factors)
        short = _short_bands(scene, bands, binned, absorption)
        if not short or longest_s >= _LONGEST_S:
            break
        longest_s *= _LONGER
    if progress is not None:
        progress(1.0)
    return FollowedDecay(
        binned,
        plan.settings,
        scattering,
        known_directivities(directivities, scene.sources),
        (
            *plan.findings,
            *traced.value.findings,
            *found,
            *degenerate,
            *_short_finding(bands, short),
        ),
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


def _scattering_priors(known: AbsorptionPosterior) -> tuple[MaterialPrior, ...]:
    """Return priors that hold nothing but the scattering, as the plan of a trace reads them."""
    n = len(known.bands)
    rows = np.full((len(known.materials), n), np.nan)
    if known.scattering is not None:
        rows = known.scattering
    return tuple(
        replace(unknown_material(name, n), scattering=None if np.isnan(row).any() else row)
        for name, row in zip(known.materials, rows, strict=True)
    )


def _short_bands(
    scene: Scene, bands: Bands, binned: BinnedPaths, absorption: FloatArray
) -> Sequence[int]:
    """Return the bands in which the decay of some pair is not followed far enough."""
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
            Code.DECAY_NOT_FOLLOWED,
            f"The trace does not follow the decay over 35 dB at "
            f"{', '.join(f'{f:g}' for f in centres)} Hz: T30 is not predicted there. Some walls "
            "absorb next to nothing.",
            {"bands_hz": centres},
        ),
    )
