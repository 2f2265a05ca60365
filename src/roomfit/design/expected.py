"""Objectives of measurements not yet made: with the windows, noise and unknowns of a fit.

A pair's windows and noise are those that the fit would have. What sets arrival times is a pair's
own, in multiples of its prior standard deviations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from roomfit.base.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import Bands
from roomfit.base.findings import Code, Finding
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.fit.scattering import band_factors, specified_scattering
from roomfit.fit.solve import prior_speed_sd
from roomfit.fit.trace_plan import TracePlan, fits_pressures, plan_trace
from roomfit.fit.traced_room import scene_decay_s
from roomfit.materials.priors import MaterialPrior
from roomfit.model.binned import BinnedPaths, bin_paths, in_band
from roomfit.model.energy import (
    EnergyTerm,
    Observation,
    fine_edges_s,
    first_windows,
    in_air,
)
from roomfit.model.observation import absorption_block
from roomfit.model.parameters import (
    Block,
    Geometry,
    Parameters,
    geometry_block,
    whole_covariance,
)
from roomfit.model.patterns import Directivities
from roomfit.model.problem import Objective
from roomfit.model.weighing import EnergyRows, first_rows, weigh
from roomfit.model.windows import window_edges_s
from roomfit.pressures.data_term import (
    DELAY_SD_S,
    RINGING_PERIODS,
    CoherentTerm,
    coherent_term,
    with_coherence,
)
from roomfit.pressures.response import image_paths, images_of
from roomfit.pressures.sequential import FIT_END_S
from roomfit.room.mesh import volume_m3
from roomfit.room.scene import Scene, distances_m, select_pairs
from roomfit.settings import Settings
from roomfit.signals.filters import (
    SpreadingKernel,
    spreading_kernel,
    spreading_matrix,
    spreading_reach_s,
    spreading_slopes_per_s,
    statistical_bandwidth_hz,
)
from roomfit.signals.measurement import LATENCY_SD_S
from roomfit.tracing.paths import Paths, TraceSettings, concatenate, paths_of_pairs, select
from roomfit.tracing.trace import trace

# As in a fit: a window is used down to where the decay stands 4 dB above the noise.
_CLEAR_OF_NOISE = 2.5
# The time constant of the late decay is read from 5 dB below the whole energy on.
_FROM_DB = 5.0
# Windows as short as the fit's: of energies, and of pressures.
_ENERGY_PERIODS, _PRESSURE_PERIODS = 1.5, 0.75
# What a fit of pressures assumes first of the model's errors: see `roomfit.pressures.sequential`.
_PRESSURE_MODEL_ERROR, _PRESSURE_RINGING_ERROR = 0.1, 0.0
# Rays caught by all receivers of one source: more would fill memory for nothing.
_MOST_CAUGHT = 4e6
_FEWEST_RAYS = 2_000
# Of a pair: a window late in the decay has a thousand or more.
_LATE_IMAGES = 100_000


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedFit:
    """How measurements of the pairs of a scene will be made and fitted."""

    scene: Scene  # with all pairs
    bands: Bands
    priors: tuple[MaterialPrior, ...]
    typical: (
        FloatArray  # (n_materials, n_bands), absorption by which windows and noise are laid out
    )
    decay_range_db: float  # how far a decay will be observed above the noise
    position_sd_m: float  # of every coordinate of source and receiver
    directivities: Directivities
    plan: TracePlan
    coherent: bool  # whether pressures of image sources will be added, or energies only
    geometry: Geometry  # what sets one pair's arrival times, each pair's its own

    @property
    def shared(self) -> BoolArray:
        """Which fitted entries of the geometry all pairs have in common, shape (n_geometry,)."""
        labels = self.geometry.labels
        common = np.array([label == "speed" or label.startswith("delay") for label in labels])
        return np.asarray(common[self.geometry.fitted & (self.geometry.sd > 0.0)])

    def groups(self) -> tuple[list[IntArray], Callable[[IntArray], TracedGroup]]:
        """Return groups of pairs that are traced together, and what traces one of them.

        Rays serve all receivers of a source; without rays every pair is a group by itself.
        """
        fineness, late = _late_images(self)
        names = self.scene.pairs[:, 0] if late is None else np.arange(len(self.scene.pairs))

        def traced(at: IntArray) -> TracedGroup:
            own = select_pairs(self.scene, at)
            found = trace(own, fineness, self.plan.scattering)
            paths = found.paths if late is None else concatenate((found.paths, late))
            sampled = self.plan.scattering.coefficients
            scattering = specified_scattering(self.priors, sampled, len(self.bands))
            factors, degenerate = band_factors(
                self.directivities, own, self.bands, paths, scattering
            )
            # a candidate near a wall is no doubt about anything
            doubts = [f for f in found.findings if f.code is not Code.RECEIVER_SPHERE_SHRUNK]
            return TracedGroup(_of_pair(self, own, paths, factors), (*doubts, *degenerate))

        return [np.flatnonzero(names == name) for name in np.unique(names)], traced


class TracedGroup(NamedTuple):
    """The objectives of a pair of a group by its number in it, one a band, and findings.

    Those of pressures are as coherent as arrival times that are known exactly make them, see
    `as_coherent`.
    """

    objectives: Callable[[int], list[Objective]]
    findings: tuple[Finding, ...]


def expected_fit(
    scene: Scene,
    bands: Bands,
    priors: tuple[MaterialPrior, ...],
    typical: FloatArray,
    settings: Settings,
    *,
    directivities: Directivities,
    decay_range_db: float,
    position_sd_m: float,
) -> ExpectedFit:
    """Return how pairs will be fitted: traced as for a fit, for as long as they will be observed.

    Parameters
    ----------
    scene : Scene
        With all pairs.
    typical : float array, shape (n_materials, n_bands)
    settings : Settings
        Of the fit to come.
    decay_range_db : float
        How far decays will be observed above the noise.
    position_sd_m : float
        Of every coordinate of source and receiver.
    """
    decay_s = float(scene_decay_s(scene, bands, typical).max())
    # how far image sources can be had costs several searches for them: one source stands for all
    first = select_pairs(scene, scene.pairs[:, 0] == scene.pairs[0, 0])
    observed_s = decay_s * decay_range_db / 60.0
    pressures = fits_pressures(settings)
    plan = plan_trace(first, priors, decay_s, observed_s, settings, coherent=pressures)
    plan = replace(plan, settings=_with_fewer_rays(plan.settings, scene))
    coherent = pressures and (plan.far_images or settings.model == "coherent")
    geometry = _geometry(scene, priors, position_sd_m, settings)
    return ExpectedFit(
        scene, bands, priors, typical, decay_range_db, position_sd_m, directivities, plan, coherent,
        geometry,
    )  # fmt: skip


def _geometry(
    scene: Scene, priors: tuple[MaterialPrior, ...], position_sd_m: float, settings: Settings
) -> Geometry:
    """Return what a fit under these settings leaves open of one pair's arrival times."""
    delays = [DELAY_SD_S if k.wall_delay_sd_s is None else k.wall_delay_sd_s for k in priors]
    n, delays_free = len(priors), settings.reflection_delays
    sd = [*(6 * [position_sd_m]), prior_speed_sd(scene.air, settings), LATENCY_SD_S["emission"]]
    points = (f"{p} {x}" for p in ("source", "receiver") for x in "xyz")
    return Geometry(
        (*points, "speed", "latency", *(f"delay {k.name}" for k in priors)),
        np.array([*sd, *(delays if delays_free else n * [0.0])]),
        np.array(8 * [settings.positions != "fixed"] + n * [delays_free]),
        speed_of_sound_m_s(scene.air),
        np.arange(8 + n)[None, :],
    )


def _late_images(fit: ExpectedFit) -> tuple[TraceSettings, Paths | None]:
    """Return how to trace each pair of a box without rays, and late images of one for all of them.

    What comes after all that is added as pressures is so much that its energies are alike wherever
    source and receiver stand: every n-th image of the first pair, of n times the weight. None where
    there are rays.
    """
    scene, plan = fit.scene, fit.plan
    if plan.settings.n_rays:
        return plan.settings, None
    early_s = FIT_END_S + 2.0 * RINGING_PERIODS / float(fit.bands.centres_hz[0])
    early_s = min(early_s, plan.settings.duration_s)
    paths = trace(select_pairs(scene, slice(0, 1)), plan.settings, plan.scattering).paths
    far = np.flatnonzero(paths.length_m > early_s * speed_of_sound_m_s(scene.air))
    every = max(far.size // _LATE_IMAGES, 1)
    late = select(paths, far[::every])
    late = replace(late, weight_per_m2=far.size / max(len(late), 1) * late.weight_per_m2)
    return replace(plan.settings, duration_s=early_s), late


def _with_fewer_rays(settings: TraceSettings, scene: Scene) -> TraceSettings:
    """Return settings under which the receivers of one source catch some million rays at most.

    A ray of length l crosses a sphere of radius r in a volume V ``pi r**2 l / V`` times on average.
    """
    length_m = settings.duration_s * speed_of_sound_m_s(scene.air)
    crossings = np.pi * settings.receiver_radius_m**2 * length_m / volume_m3(scene.room.mesh)
    most = int(np.bincount(scene.pairs[:, 0]).max())
    affordable = int(_MOST_CAUGHT / (crossings * most))
    return replace(settings, n_rays=min(settings.n_rays, max(affordable, _FEWEST_RAYS)))


def _of_pair(
    fit: ExpectedFit, scene: Scene, paths: Paths, factors: FloatArray | None
) -> Callable[[int], list[Objective]]:
    """Return what gives the objectives of a pair of a traced scene, one a band.

    Parameters
    ----------
    factors : float array, shape (n_bands, n_paths), or None
        On the weight of every path in every band.
    """
    filters = _band_filters(fit.bands, attenuation_per_m(scene.air, fit.bands))
    of_pair = paths_of_pairs(paths)

    def objectives(pair: int) -> list[Objective]:
        caught = select(paths, of_pair[pair])
        stands = None if caught.objects is None else caught.objects[pair : pair + 1]
        caught = replace(caught, n_pairs=1, pair=np.zeros_like(caught.pair), objects=stands)
        weights = None if factors is None else factors[:, of_pair[pair]]
        alone = select_pairs(scene, slice(pair, pair + 1))
        return _objectives(fit, alone, caught, weights, filters)

    return objectives


def _objectives(
    fit: ExpectedFit,
    alone: Scene,
    paths: Paths,
    factors: FloatArray | None,
    filters: tuple[_BandFilter, ...],
) -> list[Objective]:
    """Return the objective of every band for the only pair of a scene."""
    binned = bin_paths(alone, fit.bands, paths, fit.plan.settings.duration_s, factors)
    unknown = [
        replace(absorption_block(fit.priors, f.band, 0.2), start=fit.typical[:, f.band])
        for f in filters
    ]
    energies = [
        _expected_term(fit, f, alone, in_band(binned, f.centre_hz), block)
        for f, block in zip(filters, unknown, strict=True)
    ]
    if not fit.coherent:
        return [
            Objective(Parameters((block, _unit_gain())), (term,))
            for block, term in zip(unknown, energies, strict=True)
        ]
    energies = [
        replace(term, model_error=_PRESSURE_MODEL_ERROR, ringing_error=_PRESSURE_RINGING_ERROR)
        for term in energies
    ]
    # those that any band adds as pressures, of which the lowest rings longest
    last_s = float(first_windows(energies[0].observations[0], FIT_END_S).edges_s[-1])
    last_s = max(last_s, FIT_END_S) + RINGING_PERIODS / filters[0].centre_hz
    only = np.zeros(1, dtype=np.int64)
    images = image_paths(paths, only, 0.0, speed_of_sound_m_s(alone.air) * last_s)
    objectives = []
    for f, block, term in zip(filters, unknown, energies, strict=True):
        pressures = coherent_term(
            fit.bands,
            f.band,
            term,
            f.attenuation_per_m,
            images_of(images, only, None if factors is None else factors[f.band]),
            binned,
            fit.geometry,
            FIT_END_S,
        )
        blocks = (block, _unit_gain(), geometry_block(fit.geometry))
        objectives.append(Objective(Parameters(blocks), (pressures,)))
    return objectives


def as_coherent(objective: Objective, covariance: FloatArray | None) -> Objective:
    """Return a band's objective as coherent as what is known of its arrival times allows.

    Parameters
    ----------
    covariance : float array, shape (n_geometry, n_geometry), or None
        Of the free numbers of the geometry; None: that of the prior.
    """
    (term,) = objective.terms
    if not isinstance(term, CoherentTerm):
        return objective
    coherent = with_coherence(term, whole_covariance(term.geometry, covariance))
    return replace(objective, terms=(coherent,))


@dataclass(frozen=True, slots=True, eq=False)
class _BandFilter:
    """One band's filter with all that is computed of it once."""

    band: int
    centre_hz: float
    bandwidth_hz: float
    kernel: SpreadingKernel  # of all bands
    attenuation_per_m: float


def _band_filters(bands: Bands, attenuation_per_m: FloatArray) -> tuple[_BandFilter, ...]:
    """Return the filter of every band."""
    kernel = spreading_kernel(bands)
    found = []
    for band, centre_hz in enumerate(bands.centres_hz):
        alone = Bands(bands.kind, bands.centres_hz[band : band + 1])
        width_hz = float(statistical_bandwidth_hz(alone)[0])
        attenuation = float(attenuation_per_m[band])
        found.append(_BandFilter(band, float(centre_hz), width_hz, kernel, attenuation))
    return tuple(found)


def _expected_term(
    fit: ExpectedFit, own: _BandFilter, alone: Scene, coarse: BinnedPaths, absorption: Block
) -> EnergyTerm:
    """Return the windows of one pair that has not been measured yet.

    Its noise stands where the expected decay, at the absorption the block starts with, has fallen
    by `decay_range_db`. The "measured" energy is that noise: only the variance of predictions is
    asked of them, not how well they fit.

    Parameters
    ----------
    alone : Scene
        With this pair alone.
    coarse : BinnedPaths
        Of this pair alone, in the bins of this band.
    """
    c = speed_of_sound_m_s(alone.air)
    direct_s = float(distances_m(alone)[0] / c)
    timing_sd_s = float(np.sqrt(2.0) * fit.position_sd_m / c)
    rows = coarse.rows[0]
    usable_s, noise_per_s = _expected_noise(
        own, coarse.edges_s, rows, absorption, fit.decay_range_db
    )
    periods = _PRESSURE_PERIODS if fit.coherent else _ENERGY_PERIODS
    edges = window_edges_s(direct_s, usable_s, own.bandwidth_hz, periods=periods)
    fine = fine_edges_s(edges, own.bandwidth_hz)
    centres = 0.5 * (coarse.edges_s[1:] + coarse.edges_s[:-1])
    reach_s = spreading_reach_s(own.kernel, own.band)
    bin_centres_s = centres[: int(np.searchsorted(centres, edges[-1] + reach_s))]
    noise = noise_per_s * np.diff(edges)
    observed = Observation(
        0,
        edges,
        noise,
        noise,
        spreading_matrix(own.kernel, own.band, bin_centres_s, edges),
        fine,
        spreading_matrix(own.kernel, own.band, bin_centres_s, fine),
        spreading_slopes_per_s(own.kernel, own.band, bin_centres_s, edges),
        timing_sd_s,
        0,
    )
    rows = first_rows(rows, bin_centres_s.size)
    term = EnergyTerm(own.centre_hz, own.bandwidth_hz, own.attenuation_per_m, (rows,), (observed,))
    return in_air(term)


def _expected_noise(
    own: _BandFilter,
    edges_s: FloatArray,
    rows: EnergyRows,
    absorption: Block,
    decay_range_db: float,
) -> tuple[float, float]:
    """Return where the usable decay would end in s, and the energy of the noise per second.

    The decay is that of Schroeder's backward integral; the noise has the power that the decay has
    left after `decay_range_db`.
    """
    attenuation = np.array([own.attenuation_per_m])
    energy = weigh(rows, absorption.start[:, None], attenuation, derivative=False).energy[0]
    left = np.cumsum(energy[::-1])[::-1]
    levels_db = -10.0 * np.log10(np.maximum(left / left[0], 1e-30))
    late = int(np.searchsorted(levels_db, decay_range_db))
    late = min(late, edges_s.size - 2)
    early = min(int(np.searchsorted(levels_db, _FROM_DB)), late - 1)
    fallen = (levels_db[late] - levels_db[early]) * np.log(10.0) / 10.0
    constant_s = float(edges_s[late] - edges_s[early]) / max(float(fallen), 1e-6)
    end_s = float(edges_s[late]) - np.log(_CLEAR_OF_NOISE) * constant_s
    return end_s, float(left[0] * 10.0 ** (-0.1 * decay_range_db) / constant_s)


def _unit_gain() -> Block:
    """Return an unknown level without a prior."""
    one = np.ones(1)
    fitted = np.ones(1, dtype=np.bool_)
    prior_sd = np.full(1, np.inf)
    return Block("gain", ("level",), "log", one, fitted, 0.0 * one, prior_sd, 0.0 * one, one)
