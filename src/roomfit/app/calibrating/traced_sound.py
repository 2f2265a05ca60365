"""Responses of any room from a trace of its own: image sources as pressures, rays as noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roomfit.air import attenuation_per_m
from roomfit.app.calibrating.plan import CalibrationPlan
from roomfit.app.calibrating.truth import Truth
from roomfit.app.planning import N_RAYS, plan_trace
from roomfit.app.weighting import band_factors
from roomfit.response.directivity import FirstOrderBands
from roomfit.scene.scene import Scene
from roomfit.testproblems.pressure_box import octave_shares
from roomfit.testproblems.scattering_box import modulated_noise
from roomfit.tracing.join import trace
from roomfit.tracing.paths import Paths, hits
from roomfit.typing import BoolArray, FloatArray

_BIN_S = 0.5e-3
_OVERSAMPLING = 8
_NOTHING = 1e-30
# Energies are 1/(4 pi r^2) where the square of the pressure is 1/(4 pi r)^2.
_PRESSURE_SQUARED = 1.0 / (4.0 * np.pi)


def traced_pressures(
    plan: CalibrationPlan,
    truth: Truth,
    pairs: tuple[tuple[str, str], ...],
    duration_s: float,
    rate_hz: float,
    rng: np.random.Generator,
) -> dict[tuple[str, str], FloatArray]:
    """Return the pressure of every pair after an impulse at time 0.

    Image sources are followed as far as the fit's own, with another enumeration for moved points;
    rays are others, and three times as many. What rays bring is Gaussian noise with their energy.
    """
    scene = _true_scene(plan, truth, pairs)
    knowledge = tuple(
        replace(k, scattering=row, fit_scattering=False)
        for k, row in zip(plan.knowledge, truth.scattering, strict=True)
    )
    seed = int(rng.integers(2**62))
    planned = plan_trace(scene, knowledge, 0.0, duration_s, seed, coherent=True)
    n_rays = 0 if planned.settings.n_rays == 0 else N_RAYS
    settings = replace(planned.settings, n_rays=n_rays, duration_s=duration_s)
    paths = trace(scene, settings, planned.scattering).paths
    bands = plan.campaign.bands
    told = {name: FirstOrderBands(np.tile(b, (len(bands), 1))) for name, b in truth.b.items()}
    directed = replace(plan.campaign, directivities={**plan.campaign.directivities, **told})
    factors, _ = band_factors(directed, scene, bands, paths, truth.scattering)
    energy = _energies(plan, truth, paths, factors)
    times_s = paths.length_m / truth.speed_of_sound_m_s + hits(paths) @ truth.delays_s
    images = paths.batch < 0
    found = {}
    for number, pair in enumerate(pairs):
        own = (paths.pair == number) & (times_s < duration_s)
        found[pair] = _pressure(
            plan, times_s, energy, own, images, round(duration_s * rate_hz), rate_hz, rng
        )
    return found


def _true_scene(plan: CalibrationPlan, truth: Truth, pairs: tuple[tuple[str, str], ...]) -> Scene:
    sources = [s.name for s in truth.sources]
    receivers = [r.name for r in truth.receivers]
    index = np.array([(sources.index(s), receivers.index(r)) for s, r in pairs])
    air = replace(plan.campaign.air, speed_of_sound_m_s=truth.speed_of_sound_m_s)
    return Scene(plan.room, truth.sources, truth.receivers, index, air)


def _energies(
    plan: CalibrationPlan, truth: Truth, paths: Paths, factors: FloatArray | None
) -> FloatArray:
    """Return what every path brings in every band of the grid, 1/m2, shape (n_grid, n_paths)."""
    struck = hits(paths).astype(np.float64)
    attenuation = attenuation_per_m(plan.campaign.air, plan.grid)
    out: FloatArray = np.empty((len(plan.grid), len(paths)))
    for band, near in enumerate(plan.nearest):
        left = np.log(np.maximum(1.0 - truth.absorption[:, band], _NOTHING))
        lost = struck @ left - attenuation[band] * paths.length_m
        out[band] = paths.weight_per_m2 * np.exp(lost)
        if factors is not None:
            out[band] *= factors[near]
    return out


def _pressure(
    plan: CalibrationPlan,
    times_s: FloatArray,
    energy: FloatArray,
    own: BoolArray,
    images: BoolArray,
    n_samples: int,
    rate_hz: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Return the pressure of one pair: its image paths as impulses, its rays as noise."""
    mirrored, caught = np.flatnonzero(own & images), np.flatnonzero(own & ~images)
    fine = np.round(times_s[mirrored] * rate_hz * _OVERSAMPLING).astype(np.int64)
    frequencies = np.linspace(0.0, 0.5 * rate_hz, n_samples + 1)
    shares = octave_shares(plan.grid.centres_hz, frequencies)
    spectrum = np.zeros(n_samples + 1, dtype=np.complex128)
    n_bins = int(np.ceil(n_samples / rate_hz / _BIN_S)) + 1
    bins = (times_s[caught] / _BIN_S).astype(np.int64)
    echogram = np.zeros((len(plan.grid), n_bins))
    for band, share in enumerate(shares):
        amplitude = np.sqrt(_PRESSURE_SQUARED * energy[band, mirrored])
        train = np.bincount(fine, amplitude, 2 * n_samples * _OVERSAMPLING)
        spectrum += share * np.fft.rfft(train)[: n_samples + 1]
        echogram[band] = np.bincount(bins, energy[band, caught], n_bins)
    made = np.asarray(np.fft.irfft(spectrum, 2 * n_samples)[:n_samples])
    flat = np.zeros(len(plan.grid))
    if not caught.size:
        return made
    noise = modulated_noise(echogram, _BIN_S, n_samples, rate_hz, plan.grid.centres_hz, flat, rng)
    return np.asarray(made + noise)
