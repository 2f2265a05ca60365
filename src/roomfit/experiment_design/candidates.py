"""The pairs of source and receiver that could be measured: where, and how informative."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike

from roomfit._checks import check_known
from roomfit.air import Air, speed_of_sound_m_s
from roomfit.errors import InputError
from roomfit.experiment_design.choose import Criterion, Rules
from roomfit.experiment_design.information import (
    ExpectedMeasurement,
    information_of_pairs,
)
from roomfit.experiment_design.prior import PriorInformation
from roomfit.findings import About, Code, Finding
from roomfit.geometry.inside import distance_to_walls_m, is_inside
from roomfit.geometry.mesh import refuse, volume_m3
from roomfit.inversion.scattering import band_factors, specified_scattering
from roomfit.inversion.sequential import FIT_END_S
from roomfit.inversion.solve import prior_speed_sd
from roomfit.inversion.trace_plan import TracePlan, fits_pressures, plan_trace
from roomfit.materials.priors import MaterialPrior
from roomfit.measurement import LATENCY_SD_S, Level
from roomfit.objective.coherent import DELAY_SD_S, RINGING_PERIODS
from roomfit.objective.parameters import Geometry
from roomfit.prediction.decay import scene_decay_s
from roomfit.response.directivity import Directivities
from roomfit.scene import (
    NEAREST_PAIR_M,
    Point,
    Room,
    Scene,
    distances_m,
    position_findings,
    select_pairs,
)
from roomfit.settings import Settings
from roomfit.tracing.paths import Paths, TraceSettings, concatenate, select
from roomfit.tracing.trace import trace
from roomfit.typing import BoolArray, FloatArray, IntArray, Progress, part

Position = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class DesignOptions:
    """How many measurements to choose, from which candidates, and how they will be made.

    Raises
    ------
    InputError
        A number is below 1, or a name is unknown.
    """

    number: int | None = None  # pairs to choose; None: 6, or 1 after a fit
    criterion: Criterion | None = None  # None: "determinant", or "worst" after a fit
    most_sources: int | None = None  # different sources that a design may have
    n_candidates: int = 200  # pairs to choose from at most
    n_random: int = 200  # random designs to compare with
    n_draws: int = 2  # of the prior absorption, at which information is evaluated
    sources: tuple[Position, ...] = ()  # new sources, m
    receivers: tuple[Position, ...] = ()  # new receivers, m
    new_sources: int = 8  # spread evenly over the room where `sources` lists none
    grid_m: float | None = None  # spacing of new receivers where none is listed; None: spread
    source_heights_m: tuple[float, float] = (1.0, 2.0)  # above the lowest point of the room
    receiver_heights_m: tuple[float, float] = (1.0, 2.0)
    region_m: tuple[Position, Position] | None = None  # two corners of a box for new positions
    wall_distance_m: float = 1.0  # least distance of new positions from all walls
    source_distance_m: float | None = None  # of receivers from their source; None: ISO 3382's
    receiver_distance_m: float = 2.0  # least distance between two receivers
    decay_range_db: float = 45.0  # how far decays will be observed above the noise
    position_sd_m: float = 0.02  # of every coordinate of source and receiver
    level: Level = "per-source"  # what measurements will share a gain

    def __post_init__(self) -> None:
        for name, number in (
            ("candidates", self.n_candidates),
            ("measurements to choose", self.number),
            ("sources", self.most_sources),
            ("draws", self.n_draws),
        ):
            if number is not None and number < 1:
                raise InputError(f"the number of {name} is below 1", found=str(number), needed="1")
        if self.criterion is not None:
            check_known("unknown criterion", self.criterion, get_args(Criterion))
        check_known("unknown level", self.level, get_args(Level))


# Points that are tried before a region counts as too narrow.
_MOST_TRIES = 2**14
_SAME_POSITION_M = 0.01


class Region(NamedTuple):
    """A box in the room's frame, and how far from all walls a position must be."""

    low_m: FloatArray  # (3,)
    high_m: FloatArray  # (3,)
    wall_distance_m: float = 1.0  # ISO 3382-2:2008, 4.3.3: a quarter of a wavelength, normally 1 m


def region_of(
    room: Room,
    heights_m: tuple[float, float],
    wall_distance_m: float,
    box_m: tuple[ArrayLike, ArrayLike] | None = None,
) -> Region:
    """Return the region of a room between two heights above its lowest point, cut by a box.

    Raises
    ------
    InputError
        Nothing is left of it.
    """
    vertices = room.mesh.vertices_m
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    floor = float(low[2])
    low = np.maximum(low, [*low[:2], floor + heights_m[0]])
    high = np.minimum(high, [*high[:2], floor + heights_m[1]])
    if box_m is not None:
        low, high = np.maximum(low, box_m[0]), np.minimum(high, box_m[1])
    if np.any(low > high):
        raise InputError(
            "a region ends below its beginning",
            found=f"from {low.tolist()} to {high.tolist()} m",
            needed="the lower corner first",
        )
    return Region(low, high, wall_distance_m)


def spread_positions(room: Room, region: Region, n: int, seed: int) -> FloatArray:
    """Return n positions spread evenly over a region, shape (n, 3).

    Scrambled Sobol points of the box, those kept that are in the room and clear of its walls.

    Raises
    ------
    InputError
        Hardly any position in the region is allowed.
    """
    from scipy.stats import qmc  # heavy

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


_MOST_IN_GRID = 20_000


def grid_positions(room: Room, region: Region, spacing_m: float) -> FloatArray:
    """Return the positions of a grid in a region, shape (n, 3).

    The grid is centred in the region, with the same spacing in x, y and z; a region without height
    has one layer.

    Raises
    ------
    InputError
        No position is allowed.
    """
    axes = []
    steps = [int(side / spacing_m + 1e-9) for side in region.high_m - region.low_m]
    if math.prod(n + 1 for n in steps) > _MOST_IN_GRID:
        raise InputError(
            "a grid of more positions than can be examined",
            where="grid_m",
            found=f"{' x '.join(str(n + 1) for n in steps)} positions, {spacing_m:g} m apart",
            needed=f"at most {_MOST_IN_GRID}",
            hint="a wider spacing, or region_m",
        )
    for low, high, n in zip(region.low_m, region.high_m, steps, strict=True):
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
    """Return which receivers may stand in one design: far enough apart, or at one position.

    `receivers_m`, shape (n_pairs, 3): of every pair.

    Returns
    -------
    bool array, shape (n_pairs, n_pairs)
        False on the diagonal.
    """
    steps = receivers_m[:, None, :] - receivers_m[None, :, :]
    distance = np.sqrt(np.sum(steps**2, axis=2))
    # the same position may be measured from several sources
    fine = (distance >= apart_m) | (distance < _SAME_POSITION_M)
    np.fill_diagonal(fine, False)
    return np.asarray(fine)


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
        found=f"{found} positions at least {region.wall_distance_m:g} m from all walls",
        needed=f"{needed}",
        hint="lower wall_distance_m or widen the heights in [design]; furniture counts as walls",
    )


# Receivers made for each pair that is wanted: enough that hardly a position serves two sources.
_RECEIVERS_PER_PAIR = 1.0


def design_candidates(
    existing: Scene,
    options: DesignOptions,
    source_distance_m: float,
    seed: int,
    *,
    count_measured: bool = True,
) -> tuple[Scene, Rules, tuple[Finding, ...]]:
    """Return the scene of all pairs, those measured already first, and what may stand together.

    Sources and receivers that exist are candidates where they stand. To them come the positions
    that the options list, or else as many as are needed: receivers on a grid or spread evenly,
    sources spread evenly. Where there are more pairs than wanted, every source keeps the same
    share of them.

    Parameters
    ----------
    existing : Scene
        Its pairs have been measured.
    source_distance_m : float
        Least distance of a receiver from its source.
    count_measured : bool
        Whether measured pairs are put first, to count as information that exists already.

    Raises
    ------
    InputError
        No pair is possible, or a listed position is outside the room or in a wall.
    """
    sources = (*existing.sources, *_new_sources(existing, options, seed))
    receivers = (*existing.receivers, *_new_receivers(existing, options, seed))
    for kind, points in (("source", sources), ("receiver", receivers)):
        if not points:
            raise InputError(
                f"there is no candidate for a {kind}",
                needed=f"[{kind}s.NAME] with a position, or positions in [design]",
            )
        refuse(position_findings(existing.room, points, ()))
    # existing points come first, so that their indices are those of the existing scene
    measured = {(int(s), int(r)) for s, r in existing.pairs}
    every = np.array([(i, j) for i in range(len(sources)) for j in range(len(receivers))])
    was = np.array([(int(s), int(r)) in measured for s, r in every])
    whole = Scene(existing.room, sources, receivers, every, existing.air)
    possible = np.flatnonzero(~was & (distances_m(whole) >= source_distance_m))
    if not possible.size:
        raise InputError(
            "no pair of source and receiver is far enough apart",
            found=f"{int((~was).sum())} pairs, the farthest "
            f"{distances_m(whole)[~was].max(initial=0.0):.2f} m apart",
            needed=f"at least {source_distance_m:.2f} m",
            hint="set source_distance_m in [design]",
        )
    n, rng = options.n_candidates, np.random.default_rng(seed)
    possible = possible[even_part(every[possible, 0], n, rng)]
    fixed = np.flatnonzero(was) if count_measured else np.zeros(0, dtype=np.int64)
    scene = _used(whole, every[np.concatenate((fixed, possible))])
    receivers_m = np.array([r.position_m for r in scene.receivers])[scene.pairs[:, 1]]
    rules = Rules(
        scene.pairs[:, 0],
        compatible_positions(receivers_m, max(options.receiver_distance_m, NEAREST_PAIR_M)),
        np.arange(len(scene.pairs)) >= fixed.size,
        tuple(range(fixed.size)),
        options.most_sources,
    )
    if possible.size >= n:
        return scene, rules, ()
    few = Finding(
        Code.FEW_CANDIDATES,
        About(),
        f"Only {possible.size} pairs of source and receiver are allowed where {n} were asked for.",
        {"found": possible.size, "asked": n},
    )
    return scene, rules, (few,)


def even_part(source: IntArray, n: int, rng: np.random.Generator) -> IntArray:
    """Return n of many pairs, drawn so that each source keeps as many as the others, in order.

    `source` has the shape (n_pairs,).
    """
    if len(source) <= n:
        return np.arange(len(source))
    rank = np.empty(len(source))
    for s in np.unique(source):
        own = np.flatnonzero(source == s)
        rank[own] = rng.permutation(own.size) + rng.random(own.size)
    return np.sort(np.argsort(rank, kind="stable")[:n])


def _new_sources(existing: Scene, options: DesignOptions, seed: int) -> tuple[Point, ...]:
    if options.sources:
        positions = np.array(options.sources)
    elif options.new_sources == 0:
        return ()
    else:
        region = region_of(
            existing.room, options.source_heights_m, options.wall_distance_m, options.region_m
        )
        positions = spread_positions(existing.room, region, options.new_sources, seed)
    return _named("S", positions, existing.sources, options.position_sd_m)


def _new_receivers(existing: Scene, options: DesignOptions, seed: int) -> tuple[Point, ...]:
    if options.receivers:
        positions = np.array(options.receivers)
    else:
        room = existing.room
        region = region_of(
            room, options.receiver_heights_m, options.wall_distance_m, options.region_m
        )
        if options.grid_m is not None:
            positions = grid_positions(room, region, options.grid_m)
        else:
            n = int(np.ceil(_RECEIVERS_PER_PAIR * options.n_candidates))
            positions = spread_positions(room, region, n, seed + 1)
    return _named("R", positions, existing.receivers, options.position_sd_m)


def _named(
    letter: str, positions_m: FloatArray, existing: tuple[Point, ...], sd_m: float
) -> tuple[Point, ...]:
    """Return points named by a letter and a number that is not taken yet."""
    taken = {p.name for p in existing}
    numbers = (
        i for i in range(1, len(positions_m) + len(taken) + 1) if f"{letter}{i}" not in taken
    )
    return tuple(Point(f"{letter}{next(numbers)}", at.round(3), sd_m) for at in positions_m)


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


# Rays caught by all receivers of one source: more would fill memory for nothing.
_MOST_CAUGHT = 4e6
_FEWEST_RAYS = 2_000
# Of a pair: a window late in the decay has a thousand or more.
_LATE_IMAGES = 100_000
# The part of the time that tracing takes.
_TRACING = 0.3


def information_of_candidates(
    scene: Scene,
    known: PriorInformation,
    n_pairs: int,
    options: DesignOptions,
    settings: Settings,
    directivities: Directivities,
    progress: Progress | None,
) -> tuple[FloatArray, bool, tuple[Finding, ...]]:
    """Trace the candidates of every source at once and return the information of each.

    Parameters
    ----------
    scene : Scene
        With all pairs.
    n_pairs : int
        How many will have been measured in the end.

    Returns
    -------
    matrices : float array, shape (n_pairs, n_draws, n_bands, n + 1, n + 1)
        See `information_of_pairs`.
    coherent : bool
        Whether by pressures of image sources.
    findings : tuple of Finding
    """
    plan = _plan(scene, known, options, settings)
    expected = _expected_measurement(scene.air, known.priors, plan, n_pairs, options, settings)
    findings = list(plan.findings)
    found: list[FloatArray] = []
    indices: list[IntArray] = []
    fineness, late = _late_images(scene, known, plan)
    # rays serve all receivers of a source
    groups = scene.pairs[:, 0] if late is None else np.arange(len(scene.pairs))
    names = np.unique(groups)
    for number, name in enumerate(names):
        at = np.flatnonzero(groups == name)
        own = select_pairs(scene, at)
        done = part(progress, number / names.size, (number + 1) / names.size)
        traced = trace(own, fineness, plan.scattering, part(done, 0.0, _TRACING))
        paths = traced.paths if late is None else concatenate((traced.paths, late))
        n_bands = len(known.bands)
        scattering = specified_scattering(known.priors, plan.scattering.coefficients, n_bands)
        factors, degenerate = band_factors(directivities, own, known.bands, paths, scattering)
        # a candidate near a wall is no doubt about anything
        doubts = [f for f in traced.findings if f.code is not Code.RECEIVER_SPHERE_SHRUNK]
        reported = {f.code for f in findings}
        findings += [f for f in (*doubts, *degenerate) if f.code not in reported]
        weighing = part(done, _TRACING, 1.0)
        found.append(information_of_pairs(own, paths, factors, known, expected, weighing))
        indices.append(at)
    # back from the order of the sources to that of the pairs
    matrices = np.concatenate(found)[np.argsort(np.concatenate(indices))]
    return matrices, expected.coherent, tuple(findings)


def _late_images(
    scene: Scene, known: PriorInformation, plan: TracePlan
) -> tuple[TraceSettings, Paths | None]:
    """Return how to trace each pair of a box without rays, and late images of one for all of them.

    What comes after all that is added as pressures is so much that its energies are alike wherever
    source and receiver stand: every n-th image of the first pair, of n times the weight. None where
    there are rays.
    """
    if plan.settings.n_rays:
        return plan.settings, None
    early_s = FIT_END_S + 2.0 * RINGING_PERIODS / float(known.bands.centres_hz[0])
    early_s = min(early_s, plan.settings.duration_s)
    paths = trace(select_pairs(scene, slice(0, 1)), plan.settings, plan.scattering).paths
    far = np.flatnonzero(paths.length_m > early_s * speed_of_sound_m_s(scene.air))
    every = max(far.size // _LATE_IMAGES, 1)
    late = select(paths, far[::every])
    late = replace(late, weight_per_m2=far.size / max(len(late), 1) * late.weight_per_m2)
    return replace(plan.settings, duration_s=early_s), late


def _plan(
    scene: Scene, known: PriorInformation, options: DesignOptions, settings: Settings
) -> TracePlan:
    """Choose how to trace: as for a fit, for as long as decays will be observed."""
    decay_s = float(scene_decay_s(scene, known.bands, known.typical).max())
    # how far image sources can be had costs several searches for them: one source stands for all
    first = select_pairs(scene, scene.pairs[:, 0] == scene.pairs[0, 0])
    observed_s = decay_s * options.decay_range_db / 60.0
    plan = plan_trace(
        first, known.priors, decay_s, observed_s, settings, coherent=fits_pressures(settings)
    )
    # what a box's images need to be moved follows from where they stand
    moved = plan.settings.keep_image_transforms and scene.room.shoebox_m is None
    fineness = replace(plan.settings, keep_image_transforms=moved)
    return replace(plan, settings=_with_fewer_rays(fineness, scene))


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
    air: Air,
    priors: tuple[MaterialPrior, ...],
    plan: TracePlan,
    n_pairs: int,
    options: DesignOptions,
    settings: Settings,
) -> ExpectedMeasurement:
    """Return what a fit under these settings would be given, and leave open."""
    delays = [DELAY_SD_S if k.wall_delay_sd_s is None else k.wall_delay_sd_s for k in priors]
    n, delays_free = len(priors), settings.reflection_delays
    sd = [*(6 * [options.position_sd_m]), prior_speed_sd(air, settings), LATENCY_SD_S["emission"]]
    points = (f"{p} {x}" for p in ("source", "receiver") for x in "xyz")
    geometry = Geometry(
        (*points, "speed", "latency", *(f"delay {k.name}" for k in priors)),
        np.array([*sd, *(delays if delays_free else n * [0.0])]),
        np.array(8 * [settings.positions != "fixed"] + n * [delays_free]),
        speed_of_sound_m_s(air),
        np.arange(8 + n)[None, :],
    )
    common = np.array([label == "speed" or label.startswith("delay") for label in geometry.labels])
    return ExpectedMeasurement(
        fits_pressures(settings) and (plan.far_images or settings.model == "coherent"),
        n_pairs,
        options.decay_range_db,
        options.position_sd_m,
        plan.settings.duration_s,
        geometry,
        common[geometry.fitted & (geometry.sd > 0.0)],
    )
