"""The pairs of source and receiver that could be measured, and those that have been.

All candidates traced, source by source, and what each of them would tell.

What is known of the absorption before a design, as the choice of places needs it.

Where sources and receivers may stand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from roomfit._checks import float_array
from roomfit.air import speed_of_sound_m_s
from roomfit.bands import Bands
from roomfit.errors import InputError
from roomfit.experiment_design.choose import Rules
from roomfit.experiment_design.information import (
    DesignTrace,
    ExpectedMeasurement,
    Unknowns,
    information_of_pairs,
)
from roomfit.findings import Code, Finding
from roomfit.geometry.inside import distance_to_walls_m, is_inside
from roomfit.geometry.mesh import refuse, volume_m3
from roomfit.inversion.scattering import band_factors, specified_scattering
from roomfit.inversion.solve import relative_speed_sd
from roomfit.inversion.trace_plan import TracePlan, fits_pressures, plan_trace
from roomfit.io.campaign import Campaign, Position
from roomfit.io.iso3382 import read_parameters
from roomfit.io.materials import material_priors
from roomfit.logit import expit, logit
from roomfit.materials.priors import MaterialPrior, in_bands
from roomfit.objective.observation import absorption_block
from roomfit.objective.parameters import leaders
from roomfit.prediction.setup import (
    eyring_time_s,
    predicted_bands,
    room_posterior,
    with_fitted_scattering,
)
from roomfit.scene import NEAREST_PAIR_M, Point, Room, Scene, distances_m, position_findings
from roomfit.tracing.paths import TraceSettings
from roomfit.tracing.trace import trace
from roomfit.typing import BoolArray, FloatArray, IntArray, Progress, part
from roomfit.uncertainty.posterior import AbsorptionPosterior

# Of a variance in logit: nothing is known better than to a millionth.
_LEAST_VARIANCE = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class PriorInformation:
    """What is known beforehand.

    Attributes
    ----------
    bands : Bands
    priors : tuple of MaterialPrior
    unknowns : Unknowns
    typical : float array, shape (n_materials, n_bands)
        Middle of what is known.
    draws : float array, shape (n_draws, n_materials, n_bands)
    findings : tuple of Finding
    """

    bands: Bands
    priors: tuple[MaterialPrior, ...]
    unknowns: Unknowns
    typical: FloatArray
    draws: FloatArray
    findings: tuple[Finding, ...] = ()


def information_from_priors(campaign: Campaign, materials: tuple[str, ...]) -> PriorInformation:
    """Return what the campaign tells of every material, or else the broad prior.

    The draws are a Latin hypercube of the priors, each band's its own: every absorption takes
    values spread evenly over its prior.
    """
    priors = material_priors(campaign, materials)
    number, leader = _numbers(priors)
    mean = np.stack([k.prior_logit_mean for k in priors])[leader]
    sd = np.stack([k.prior_logit_sd for k in priors])[leader]
    n, rng = campaign.design.draws, np.random.default_rng(campaign.seed)
    strata = rng.permuted(np.broadcast_to(np.arange(n), (*mean.shape, n)), axis=-1)
    drawn: FloatArray = mean + sd * np.moveaxis(ndtri((strata + 0.5) / n), -1, 0)
    free = np.flatnonzero(_is_free(number, leader))
    prior: FloatArray = np.stack([np.diag(row) for row in sd[free].T ** -2.0])
    return PriorInformation(
        campaign.bands,
        priors,
        _unknowns(priors, number, free, drawn, np.tile(prior, (n, 1, 1, 1))),
        _absorption(priors, mean[None], leader)[0],
        _absorption(priors, drawn, leader),
    )


def information_from_fit(
    campaign: Campaign, materials: tuple[str, ...], found: AbsorptionPosterior
) -> PriorInformation:
    """Return what a finished fit tells of every material, in the bands that it has.

    Bounds are left to the fit: intervals afterwards are those of plain logit absorption, as the
    result's covariance is.

    Raises
    ------
    InputError
        The result and the campaign have no band in common, or a material's absorption is nowhere
        told.
    """
    bands, findings = predicted_bands(campaign, found.bands)
    band_indices = np.flatnonzero(np.isin(campaign.bands.centres_hz, bands.centres_hz))
    specified_priors = in_bands(material_priors(campaign, materials), band_indices)
    priors = with_fitted_scattering(specified_priors, bands, found)
    posterior = room_posterior(campaign, priors, bands, found)
    variance = np.diagonal(posterior.logit_covariance, axis1=1, axis2=2).T
    priors = tuple(
        replace(
            k,
            lower=0.0,
            upper=1.0,
            known=a if k.tied_to is None and np.all(v <= _LEAST_VARIANCE) else k.known,
        )
        for k, a, v in zip(priors, posterior.absorption, variance, strict=True)
    )
    number, leader = _numbers(priors)
    free = np.flatnonzero(_is_free(number, leader))
    covariance = posterior.logit_covariance[:, free[:, None], free]
    inverse = np.linalg.inv(covariance + _LEAST_VARIANCE * np.eye(free.size))
    information: FloatArray = np.asarray(0.5 * (inverse + np.swapaxes(inverse, 1, 2)))
    at = logit(posterior.absorption)[None]
    return PriorInformation(
        bands,
        priors,
        _unknowns(priors, number, free, at, information[None]),
        posterior.absorption,
        _absorption(priors, at, leader),
        findings,
    )


def _numbers(priors: tuple[MaterialPrior, ...]) -> tuple[IntArray, IntArray]:
    """Return the number of each material's unknown, -1 where it is known, and its leader."""
    block = absorption_block(priors, 0, 0.2)
    leader = leaders(block)
    count = np.cumsum(block.fitted) - 1
    return np.where(block.fitted[leader], count[leader], -1), np.asarray(leader)


def _is_free(number: IntArray, leader: IntArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    return np.asarray((number >= 0) & (leader == np.arange(leader.size)))


def _unknowns(
    priors: tuple[MaterialPrior, ...],
    number: IntArray,
    free: IntArray,
    drawn: FloatArray,
    information: FloatArray,
) -> Unknowns:
    return Unknowns(
        tuple(k.name for k in priors),
        number,
        np.swapaxes(drawn[:, free], 1, 2),
        information,
        np.array([priors[i].lower for i in free]),
        np.array([priors[i].upper for i in free]),
    )


def _absorption(
    priors: tuple[MaterialPrior, ...], free: FloatArray, leader: IntArray
) -> FloatArray:
    """Return absorption of free numbers, known ones as they are, both (n_draws, n_materials, m)."""
    low = np.array([k.lower for k in priors])[leader, None]
    high = np.array([k.upper for k in priors])[leader, None]
    out = low + (high - low) * expit(free)
    for i, of in enumerate(leader):
        known = priors[of].known
        if known is not None:
            out[:, i] = known
    return np.asarray(out)


# Rays caught by all receivers of one source: more would fill memory for nothing.
_MOST_CAUGHT = 4e6
_FEWEST_RAYS = 2_000
# The part of the time that tracing takes.
_TRACING = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class TracedCandidates:
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


def trace_candidates(
    campaign: Campaign,
    scene: Scene,
    known: PriorInformation,
    n_pairs: int,
    progress: Progress | None,
) -> TracedCandidates:
    """Trace the candidates of every source at once and return what each of them would tell.

    Parameters
    ----------
    scene : Scene
        With all pairs.
    n_pairs : int
        How many will have been measured in the end.
    """
    plan = _plan(campaign, scene, known)
    expected_measurement = _expected_measurement(campaign, known, plan, n_pairs)
    findings = list(plan.findings)
    found: list[FloatArray] = []
    band_indices: list[IntArray] = []
    sources = np.unique(scene.pairs[:, 0])
    for number, source in enumerate(sources):
        at = np.flatnonzero(scene.pairs[:, 0] == source)
        own = replace(scene, pairs=scene.pairs[at])
        done = part(progress, number / sources.size, (number + 1) / sources.size)
        traced, doubts = _traced(campaign, own, known, plan, part(done, 0.0, _TRACING))
        findings += [f for f in doubts if f.code not in {g.code for g in findings}]
        found.append(
            information_of_pairs(
                *(own, traced, expected_measurement, known.typical, known.draws),
                part(done, _TRACING, 1.0),
            )
        )
        band_indices.append(at)
    # back from the order of the sources to that of the pairs
    matrices = np.concatenate(found)[np.argsort(np.concatenate(band_indices))]
    return TracedCandidates(matrices, expected_measurement.coherent, tuple(findings))


def _plan(campaign: Campaign, scene: Scene, known: PriorInformation) -> TracePlan:
    """Choose how to trace: as for a fit, for as long as decays will be heard."""
    decay_s = float(eyring_time_s(scene, known.bands, known.typical).max())
    # how far image sources can be had costs several searches for them: one source stands for all
    first = replace(scene, pairs=scene.pairs[scene.pairs[:, 0] == scene.pairs[0, 0]])
    observed_s = decay_s * campaign.design.decay_range_db / 60.0
    plan = plan_trace(
        *(first, known.priors, decay_s, observed_s, campaign.seed),
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


def _expected_measurement(
    campaign: Campaign, known: PriorInformation, plan: TracePlan, n_pairs: int
) -> ExpectedMeasurement:
    return ExpectedMeasurement(
        known.bands,
        known.priors,
        fits_pressures(campaign) and (plan.far_images or campaign.model == "coherent"),
        n_pairs,
        campaign.design.decay_range_db,
        campaign.design.position_sd,
        campaign.wall_delays,
        campaign.positions != "fixed",
        relative_speed_sd(campaign),
    )


def _traced(
    campaign: Campaign,
    own: Scene,
    known: PriorInformation,
    plan: TracePlan,
    progress: Progress | None,
) -> tuple[DesignTrace, tuple[Finding, ...]]:
    """Trace the pairs of one source, and weigh their paths in every band."""
    traced = trace(own, plan.settings, plan.scattering, progress)
    scattering = specified_scattering(known.priors, plan.scattering.coefficients, len(known.bands))
    factors, degenerate = band_factors(campaign, own, known.bands, traced.paths, scattering)
    # a candidate near a wall is no doubt about anything
    doubts = [f for f in traced.findings if f.code is not Code.RECEIVER_SPHERE_SHRUNK]
    return DesignTrace(traced.paths, factors, plan.settings.duration_s), (*doubts, *degenerate)


# Points that are tried before a region counts as too narrow.
_MOST_TRIES = 2**14
_SAME_PLACE_M = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """A box in the room's frame, and how far from all walls a place must be.

    Attributes
    ----------
    low_m, high_m : float arrays, shape (3,)
    wall_distance_m : float
        ISO 3382-2:2008, 4.3.3: a quarter of a wavelength, normally 1 m.
    """

    low_m: FloatArray
    high_m: FloatArray
    wall_distance_m: float = 1.0

    def __post_init__(self) -> None:
        for name in ("low_m", "high_m"):
            corner = float_array(f"corner of a region ({name})", getattr(self, name), (3,))
            object.__setattr__(self, name, corner)
        if np.any(self.low_m > self.high_m):
            raise InputError(
                "a region ends below its beginning",
                found=f"from {self.low_m.tolist()} to {self.high_m.tolist()} m",
                needed="the lower corner first",
            )


def region_of(
    room: Room,
    heights_m: tuple[float, float],
    wall_distance_m: float,
    box_m: tuple[FloatArray, FloatArray] | None = None,
) -> Region:
    """Return the region of a room between two heights above its lowest point, cut by a box."""
    vertices = room.mesh.vertices_m
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    floor = float(low[2])
    low = np.maximum(low, [*low[:2], floor + heights_m[0]])
    high = np.minimum(high, [*high[:2], floor + heights_m[1]])
    if box_m is not None:
        low, high = np.maximum(low, box_m[0]), np.minimum(high, box_m[1])
    return Region(low, high, wall_distance_m)


def spread_positions(room: Room, region: Region, n: int, seed: int) -> FloatArray:
    """Return n places spread evenly over a region, shape (n, 3).

    Scrambled Sobol points of the box, those kept that are in the room and clear of its walls.

    Raises
    ------
    InputError
        Hardly any place in the region is allowed.
    """
    sampler = qmc.Sobol(3, scramble=True, rng=np.random.default_rng(seed))
    found = np.zeros((0, 3))
    tried = 0
    while len(found) < n and tried < _MOST_TRIES:
        points = sampler.random(max(256, 1 << (4 * n - 1).bit_length()))
        tried += len(points)
        positions = region.low_m + points * (region.high_m - region.low_m)
        found = np.concatenate((found, positions[_clear(room, region, positions)]))
    if len(found) < n:
        raise _too_narrow(region, len(found), n)
    return found[:n]


def grid_positions(room: Room, region: Region, spacing_m: float) -> FloatArray:
    """Return the places of a grid in a region, shape (n, 3).

    The grid is centred in the region, with the same spacing in x, y and z; a region without height
    has one layer.

    Raises
    ------
    InputError
        No place is allowed.
    """
    axes = []
    for low, high in zip(region.low_m, region.high_m, strict=True):
        n = int((high - low) / spacing_m + 1e-9)
        axes.append(0.5 * (low + high) + spacing_m * (np.arange(n + 1) - 0.5 * n))
    positions = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    positions = positions[_clear(room, region, positions)]
    if not len(positions):
        raise _too_narrow(region, 0, 1)
    return positions


def least_source_distance_m(volume_m3: float, speed_m_s: float, decay_s: float) -> float:
    """Return how far from a source a receiver must be at least: ``2 sqrt(V / (c T))``.

    ISO 3382-1:2009, 4.3.2 and ISO 3382-2:2008, 4.3.3: nearer, direct sound is too strong for a
    decay to be read from.
    """
    return float(2.0 * np.sqrt(volume_m3 / (speed_m_s * decay_s)))


def compatible_positions(receivers_m: FloatArray, apart_m: float) -> BoolArray:
    """Return which receivers may stand in one design: far enough apart, or in one place.

    Parameters
    ----------
    receivers_m : float array, shape (n_pairs, 3)
        Of every pair.

    Returns
    -------
    bool array, shape (n_pairs, n_pairs)
        False on the diagonal.
    """
    steps = receivers_m[:, None, :] - receivers_m[None, :, :]
    distance = np.sqrt(np.sum(steps**2, axis=2))
    # the same place may be measured from several sources
    fine = (distance >= apart_m) | (distance < _SAME_PLACE_M)
    np.fill_diagonal(fine, False)
    return np.asarray(fine)


def even_part(source: IntArray, n: int, rng: np.random.Generator) -> IntArray:
    """Return n of many pairs, drawn so that each source keeps as many as the others, in order.

    Parameters
    ----------
    source : int array, shape (n_pairs,)
    """
    if len(source) <= n:
        return np.arange(len(source))
    rank = np.empty(len(source))
    for s in np.unique(source):
        own = np.flatnonzero(source == s)
        rank[own] = rng.permutation(own.size) + rng.random(own.size)
    return np.sort(np.argsort(rank, kind="stable")[:n])


def _clear(room: Room, region: Region, positions_m: FloatArray) -> BoolArray:
    inside = is_inside(room.mesh, positions_m)
    inside[inside] = (
        distance_to_walls_m(room.mesh, positions_m[inside]) >= region.wall_distance_m - 1e-9
    )
    return np.asarray(inside)


def _too_narrow(region: Region, found: int, needed: int) -> InputError:
    return InputError(
        "the room leaves too little space for candidates",
        where=f"from {region.low_m.round(2).tolist()} to {region.high_m.round(2).tolist()} m",
        found=f"{found} places at least {region.wall_distance_m:g} m from all walls",
        needed=f"{needed}",
        hint="lower wall_distance_m or widen the heights in [design]; furniture counts as walls",
    )


# Receivers made for each pair that is wanted: enough that hardly a place serves two sources.
_RECEIVERS_PER_PAIR = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """All pairs, those measured already first.

    Attributes
    ----------
    scene : Scene
    n_fixed : int
        How many of its pairs have been measured and are to count.
    rules : Rules
    findings : tuple of Finding
    """

    scene: Scene
    n_fixed: int
    rules: Rules
    findings: tuple[Finding, ...]


def design_candidates(
    campaign: Campaign,
    room: Room,
    n: int,
    source_distance_m: float,
    *,
    most_sources: int | None = None,
    count_measured: bool = True,
) -> Candidates:
    """Return up to n candidate pairs of a campaign.

    Sources and receivers that the campaign defines are candidates where they stand. To them come
    the places that ``[design]`` lists, or else as many as are needed: receivers on a grid or spread
    evenly, ``new_sources`` sources spread evenly.

    Parameters
    ----------
    campaign : Campaign
    room : Room
    n : int
        Most pairs. Where there are more, every source keeps the same share of them.
    source_distance_m : float
        Least distance of a receiver from its source.
    most_sources : int, optional
        How many sources a design may have.
    count_measured : bool
        Whether measured pairs are put first, to count as information that is held already.

    Raises
    ------
    InputError
        No pair is possible, or a listed place is outside the room or in a wall.
    """
    measured = measured_pairs(campaign)
    sources = (*campaign.sources, *_new_sources(campaign, room))
    receivers = (*campaign.receivers, *_new_receivers(campaign, room, n))
    _refuse_impossible(campaign, room, sources, receivers)
    names = [(s.name, r.name) for s in sources for r in receivers]
    every = np.array([(i, j) for i in range(len(sources)) for j in range(len(receivers))])
    was = np.array([pair in measured for pair in names])
    whole = Scene(room, sources, receivers, every, campaign.air)
    possible = np.flatnonzero(~was & (distances_m(whole) >= source_distance_m))
    if not possible.size:
        raise InputError(
            "no pair of source and receiver is far enough apart",
            where=str(campaign.path),
            found=f"{int((~was).sum())} pairs, the farthest "
            f"{distances_m(whole)[~was].max(initial=0.0):.2f} m apart",
            needed=f"at least {source_distance_m:.2f} m",
            hint="set source_distance_m in [design]",
        )
    rng = np.random.default_rng(campaign.seed)
    possible = possible[even_part(every[possible, 0], n, rng)]
    fixed = np.flatnonzero(was) if count_measured else np.zeros(0, dtype=np.int64)
    scene = _used(whole, every[np.concatenate((fixed, possible))])
    return Candidates(
        scene, fixed.size, _rules(campaign, scene, fixed.size, most_sources), _few(possible.size, n)
    )


def measured_pairs(campaign: Campaign) -> set[tuple[str, str]]:
    """Return the names of source and receiver of every pair that was measured to be fitted."""
    names = {(m.source, m.receiver) for m in campaign.measurements if m.use == "fit"}
    for table in campaign.tables:
        if table.use == "fit":
            values, _ = read_parameters(table.path, table.source, table.receiver)
            names |= {(v.source, v.receiver) for v in values}
    return names


def _new_sources(campaign: Campaign, room: Room) -> tuple[Point, ...]:
    table = campaign.design
    taken = [p.name for p in campaign.sources]
    if table.sources:
        return _named("S", np.array(table.sources), taken, table.position_sd)
    if table.new_sources == 0:
        return ()
    region = region_of(room, table.source_heights_m, table.wall_distance_m, _box(table.region_m))
    positions = spread_positions(room, region, table.new_sources, campaign.seed)
    return _named("S", positions, taken, table.position_sd)


def _new_receivers(campaign: Campaign, room: Room, n: int) -> tuple[Point, ...]:
    table = campaign.design
    taken = [p.name for p in campaign.receivers]
    if table.receivers:
        return _named("R", np.array(table.receivers), taken, table.position_sd)
    region = region_of(room, table.receiver_heights_m, table.wall_distance_m, _box(table.region_m))
    if table.grid_m is not None:
        positions = grid_positions(room, region, table.grid_m)
    else:
        positions = spread_positions(
            room, region, int(np.ceil(_RECEIVERS_PER_PAIR * n)), campaign.seed + 1
        )
    return _named("R", positions, taken, table.position_sd)


def _box(corners_m: tuple[Position, Position] | None) -> tuple[FloatArray, FloatArray] | None:
    return None if corners_m is None else (np.array(corners_m[0]), np.array(corners_m[1]))


def _named(
    letter: str, positions_m: FloatArray, taken: list[str], sd_m: float
) -> tuple[Point, ...]:
    """Return points named by a letter and a number that is not taken yet."""
    numbers = (
        i for i in range(1, len(positions_m) + len(taken) + 1) if f"{letter}{i}" not in taken
    )
    return tuple(Point(f"{letter}{next(numbers)}", place.round(3), sd_m) for place in positions_m)


def _refuse_impossible(
    campaign: Campaign, room: Room, sources: tuple[Point, ...], receivers: tuple[Point, ...]
) -> None:
    for kind, points in (("source", sources), ("receiver", receivers)):
        if not points:
            raise InputError(
                f"there is no candidate for a {kind}",
                where=str(campaign.path),
                needed=f"[{kind}s.NAME] with a position, or places in [design]",
            )
        refuse(position_findings(room, points, ()))


def _used(whole: Scene, pairs: IntArray) -> Scene:
    """Return the scene of some pairs, without the points that none of them uses."""
    used_s, s = np.unique(pairs[:, 0], return_inverse=True)
    used_r, r = np.unique(pairs[:, 1], return_inverse=True)
    return Scene(
        whole.room,
        tuple(whole.sources[i] for i in used_s),
        tuple(whole.receivers[i] for i in used_r),
        np.stack((s.reshape(-1), r.reshape(-1)), axis=1),
        whole.air,
    )


def _rules(campaign: Campaign, scene: Scene, n_fixed: int, most_sources: int | None) -> Rules:
    receivers = np.array([r.position_m for r in scene.receivers])[scene.pairs[:, 1]]
    table = campaign.design
    candidate = np.arange(len(scene.pairs)) >= n_fixed
    most = table.most_sources if most_sources is None else most_sources
    apart_m = max(table.receiver_distance_m, NEAREST_PAIR_M)
    return Rules(scene.pairs[:, 0], compatible_positions(receivers, apart_m), candidate, most)


def _few(found: int, asked: int) -> tuple[Finding, ...]:
    if found >= asked:
        return ()
    return (
        Finding(
            Code.FEW_CANDIDATES,
            f"Only {found} pairs of source and receiver are allowed where {asked} were asked for.",
            {"found": found, "asked": asked},
        ),
    )
