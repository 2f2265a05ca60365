"""What measurements not yet made would tell: energies, with the windows and noise of a fit.

Whether pressures of image sources will be added is not known before; they tell more.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from roomfit.base.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import Bands
from roomfit.base.findings import Code, Finding
from roomfit.base.forks import in_forks, in_this_process
from roomfit.base.typing import FloatArray, IntArray, Progress
from roomfit.design.candidates import DesignOptions
from roomfit.design.choose import PairInformation
from roomfit.design.prior import PriorInformation
from roomfit.fit.scattering import band_factors, specified_scattering
from roomfit.fit.trace_plan import TracePlan, plan_trace
from roomfit.fit.traced_room import scene_decay_s
from roomfit.model.binned import BinnedPaths, bin_paths, in_band
from roomfit.model.energy import EnergyTerm, Observation, fine_edges_s, in_air
from roomfit.model.observation import absorption_block
from roomfit.model.parameters import Block, Parameters
from roomfit.model.patterns import Directivities
from roomfit.model.problem import Objective
from roomfit.model.weighing import first_rows, weigh
from roomfit.model.windows import window_edges_s
from roomfit.room.mesh import volume_m3
from roomfit.room.scene import Scene, distances_m, select_pairs
from roomfit.settings import Settings
from roomfit.signals import filters
from roomfit.tracing.paths import Paths, TraceSettings, concatenate, select
from roomfit.tracing.trace import trace

# As in a fit: a window is used down to where the decay stands 4 dB above the noise.
_CLEAR_OF_NOISE = 2.5
# The time constant of the late decay is read from 5 dB below the whole energy on.
_FROM_DB = 5.0
_WINDOW_PERIODS = 1.5  # windows as short as the fit's
# Rays caught by all receivers of one source: more would fill memory for nothing.
_MOST_CAUGHT, _FEWEST_RAYS = 4e6, 2_000
# Image sources of a box are each pair's own until then, and so many of one pair serve all later on.
_EARLY_S, _EARLY_PERIODS, _LATE_IMAGES = 0.2, 8.0, 100_000


class _Expected(NamedTuple):
    """How measurements will be made and fitted."""

    known: PriorInformation
    options: DesignOptions
    directivities: Directivities
    plan: TracePlan
    fineness: TraceSettings  # of what is traced for each pair
    late: Paths | None  # that all pairs have in common


def information_of_candidates(
    scene: Scene,
    known: PriorInformation,
    options: DesignOptions,
    settings: Settings,
    directivities: Directivities,
    progress: Progress | None = None,
) -> tuple[PairInformation, tuple[Finding, ...]]:
    """Return what every pair of a scene would tell, those of one source traced at once."""
    plan = _plan(scene, known, options, settings)
    late = _late_images(scene, known, plan)
    fit = _Expected(known, options, directivities, plan, *late)
    # rays serve all receivers of a source; without rays every pair is a group by itself
    names = scene.pairs[:, 0] if fit.late is None else np.arange(len(scene.pairs))
    groups = [np.flatnonzero(names == name) for name in np.unique(names)]
    shown = in_this_process(progress)

    def of_group(number: int) -> tuple[FloatArray, tuple[Finding, ...]]:
        found = _of_group(fit, select_pairs(scene, groups[number]))
        if shown is not None:
            shown((number + 1) / len(groups))
        return found

    findings, found = list(plan.findings), list[FloatArray]()
    for own, doubts in in_forks(of_group, range(len(groups))):
        reported = {f.code for f in findings}
        findings += [f for f in doubts if f.code not in reported]
        found.append(own)
    # back from the order of the sources to that of the pairs
    matrices = np.concatenate(found)[np.argsort(np.concatenate(groups))]
    gain: IntArray = np.full(len(matrices), -1)
    if options.level != "absolute":
        gain = scene.pairs[:, 0] if options.level == "per-source" else np.arange(len(matrices))
    return PairInformation(matrices, gain), tuple(findings)


def _plan(
    scene: Scene, known: PriorInformation, options: DesignOptions, settings: Settings
) -> TracePlan:
    """Return how to trace for as long as pairs will be observed.

    A ray of length l crosses a sphere of radius r in a volume V ``pi r**2 l / V`` times on average:
    there are so few rays that the receivers of one source catch some million at most.
    """
    decay_s = float(scene_decay_s(scene, known.bands, known.typical).max())
    observed_s = decay_s * options.decay_range_db / 60.0
    # one source stands for all
    first = select_pairs(scene, scene.pairs[:, 0] == scene.pairs[0, 0])
    plan = plan_trace(first, known.priors, decay_s, observed_s, settings)
    own = plan.settings
    length_m = own.duration_s * speed_of_sound_m_s(scene.air)
    crossings = np.pi * own.receiver_radius_m**2 * length_m / volume_m3(scene.room.mesh)
    affordable = int(_MOST_CAUGHT / (crossings * int(np.bincount(scene.pairs[:, 0]).max())))
    n_rays = min(own.n_rays, max(affordable, _FEWEST_RAYS))
    return replace(plan, settings=replace(own, n_rays=n_rays))


def _late_images(
    scene: Scene, known: PriorInformation, plan: TracePlan
) -> tuple[TraceSettings, Paths | None]:
    """Return how to trace each pair of a box without rays, and late images of one for all of them.

    What is late is so much that its energies are alike wherever source and receiver stand: every
    n-th image of the first pair, of n times the weight. None where there are rays.
    """
    if plan.settings.n_rays:
        return plan.settings, None
    early_s = _EARLY_S + _EARLY_PERIODS / float(known.bands.centres_hz[0])
    early_s = min(early_s, plan.settings.duration_s)
    paths = trace(select_pairs(scene, slice(0, 1)), plan.settings, plan.scattering).paths
    far = np.flatnonzero(paths.length_m > early_s * speed_of_sound_m_s(scene.air))
    late = select(paths, far[:: max(far.size // _LATE_IMAGES, 1)])
    late = replace(late, weight_per_m2=far.size / max(len(late), 1) * late.weight_per_m2)
    return replace(plan.settings, duration_s=early_s), late


def _of_group(fit: _Expected, own: Scene) -> tuple[FloatArray, tuple[Finding, ...]]:
    """Return the information of the pairs of a scene, which are traced together, and findings."""
    known, plan = fit.known, fit.plan
    found = trace(own, fit.fineness, plan.scattering)
    paths = found.paths if fit.late is None else concatenate((found.paths, fit.late))
    n_bands, traced = len(known.bands), plan.scattering.coefficients
    scattering = specified_scattering(known.priors, traced, n_bands)
    factors, degenerate = band_factors(fit.directivities, own, known.bands, paths, scattering)
    binned = bin_paths(own, known.bands, paths, plan.settings.duration_s, factors)
    one, zero, free = np.ones(1), np.zeros(1), np.ones(1, dtype=np.bool_)
    gain = Block("gain", ("level",), "log", one, free, zero, np.full(1, np.inf), zero, one)

    def of_band(band: int) -> list[list[FloatArray]]:
        block = absorption_block(known.priors, band, 0.2)
        unknown = Parameters((replace(block, start=known.typical[:, band]), gain))
        coarse = in_band(binned, float(known.bands.centres_hz[band]))
        terms = [_expected_term(fit, own, pair, band, coarse) for pair in range(len(own.pairs))]
        objectives = [Objective(unknown, (term,)) for term in terms]
        return [[o.information(draw[:, band]) for draw in known.draws] for o in objectives]

    # a candidate near a wall is no doubt about anything
    doubts = [f for f in found.findings if f.code is not Code.RECEIVER_SPHERE_SHRUNK]
    each = np.array(in_forks(of_band, range(n_bands)))
    return np.moveaxis(each, 0, 2), (*doubts, *degenerate)


def _expected_term(
    fit: _Expected, own: Scene, pair: int, band: int, coarse: BinnedPaths
) -> EnergyTerm:
    """Return the windows of one pair that has not been measured yet.

    Its noise stands where the expected decay, at a typical absorption, has fallen by the range that
    is observed. The "measured" energy is that noise: only the variance of predictions is asked of
    them, not how well they fit.
    """
    c, bands, edges_s = speed_of_sound_m_s(own.air), fit.known.bands, coarse.edges_s
    kernel, rows = filters.spreading_kernel(bands), coarse.rows[pair]
    one = Bands(bands.kind, bands.centres_hz[band : band + 1])
    width_hz = float(filters.statistical_bandwidth_hz(one)[0])
    air = attenuation_per_m(own.air, one)
    energy = weigh(rows, fit.known.typical[:, band : band + 1], air)[0]
    usable_s, noise_per_s = _expected_noise(energy, edges_s, fit.options.decay_range_db)
    direct_s = float(distances_m(own)[pair] / c)
    edges = window_edges_s(direct_s, usable_s, width_hz, periods=_WINDOW_PERIODS)
    fine = fine_edges_s(edges, width_hz)
    centres = 0.5 * (edges_s[1:] + edges_s[:-1])
    reach_s = filters.spreading_reach_s(kernel, band)
    bin_centres_s = centres[: int(np.searchsorted(centres, edges[-1] + reach_s))]
    noise = noise_per_s * np.diff(edges)
    observed = Observation(
        0,
        edges,
        noise,
        noise,
        filters.spreading_matrix(kernel, band, bin_centres_s, edges),
        fine,
        filters.spreading_matrix(kernel, band, bin_centres_s, fine),
        filters.spreading_slopes_per_s(kernel, band, bin_centres_s, edges),
        float(np.sqrt(2.0) * fit.options.position_sd_m / c),
        0,
    )
    rows = first_rows(rows, bin_centres_s.size)
    return in_air(
        EnergyTerm(float(one.centres_hz[0]), width_hz, float(air[0]), (rows,), (observed,))
    )


def _expected_noise(
    energy: FloatArray, edges_s: FloatArray, decay_range_db: float
) -> tuple[float, float]:
    """Return where the usable decay would end in s, and the energy of the noise per second.

    The decay is that of Schroeder's backward integral; the noise has the power that the decay has
    left after `decay_range_db`.
    """
    left = np.cumsum(energy[::-1])[::-1]
    levels_db = -10.0 * np.log10(np.maximum(left / left[0], 1e-30))
    late = min(int(np.searchsorted(levels_db, decay_range_db)), edges_s.size - 2)
    early = min(int(np.searchsorted(levels_db, _FROM_DB)), late - 1)
    fallen = (levels_db[late] - levels_db[early]) * np.log(10.0) / 10.0
    constant_s = float(edges_s[late] - edges_s[early]) / max(float(fallen), 1e-6)
    end_s = float(edges_s[late]) - np.log(_CLEAR_OF_NOISE) * constant_s
    return end_s, float(left[0] * 10.0 ** (-0.1 * decay_range_db) / constant_s)
