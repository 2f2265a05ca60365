"""The pairs of source and receiver that could be measured: where, and how informative."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import count
from typing import NamedTuple, get_args

import numpy as np

from roomfit.base.arguments import check_known, check_range
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.design.choose import Criterion, Rules
from roomfit.room.mesh import refuse
from roomfit.room.scene import (
    NEAREST_PAIR_M,
    Point,
    Room,
    Scene,
    distances_m,
    is_clear_of_walls,
    position_findings,
)
from roomfit.signals.measurement import Level

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
        for name in ("number", "most_sources", "n_candidates", "n_draws"):
            count = getattr(self, name)
            check_range(name, 1 if count is None else count, 1, np.inf)
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


def region_of(room: Room, heights_m: tuple[float, float], options: DesignOptions) -> Region:
    """Return the region of a room between two heights above its lowest point, cut by a box."""
    vertices = room.mesh.vertices_m
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    high = np.minimum(high, [*high[:2], low[2] + heights_m[1]])
    low = np.maximum(low, [*low[:2], low[2] + heights_m[0]])
    if options.region_m is not None:
        low, high = np.maximum(low, options.region_m[0]), np.minimum(high, options.region_m[1])
    if np.any(low > high):
        what, found = "a region ends below its beginning", f"{low.tolist()} to {high.tolist()} m"
        hint = "exchange its two corners, or name a higher range of heights"
        raise InputError(what, found=found, needed="the lower corner first", hint=hint)
    return Region(low, high, options.wall_distance_m)


def spread_positions(room: Room, region: Region, n: int, seed: int) -> FloatArray:
    """Return n positions spread evenly over a region, shape (n, 3).

    Scrambled Sobol points of the box, those kept that are in the room and clear of its walls.
    """
    from scipy.stats import qmc  # heavy

    sampler = qmc.Sobol(3, scramble=True, rng=np.random.default_rng(seed))
    found, tried = np.zeros((0, 3)), 0
    while len(found) < n and tried < _MOST_TRIES:
        points = sampler.random(max(256, 1 << (4 * n - 1).bit_length()))
        tried += len(points)
        positions = region.low_m + points * (region.high_m - region.low_m)
        clear = is_clear_of_walls(room, positions, region.wall_distance_m)
        found = np.concatenate((found, positions[clear]))
    if len(found) < n:
        raise _too_narrow(region, len(found), n)
    return found[:n]


_MOST_IN_GRID = 20_000


def grid_positions(room: Room, region: Region, spacing_m: float) -> FloatArray:
    """Return the positions of a grid in a region, shape (n, 3).

    The grid is centred in the region, with the same spacing in x, y and z; a region without height
    has one layer.
    """
    steps = [int(side / spacing_m + 1e-9) for side in region.high_m - region.low_m]
    if math.prod(n + 1 for n in steps) > _MOST_IN_GRID:
        what, needed = "a grid of more positions than can be examined", f"at most {_MOST_IN_GRID}"
        found = f"{' x '.join(str(n + 1) for n in steps)} positions, {spacing_m:g} m apart"
        hint = "a wider spacing, or region_m"
        raise InputError(what, where="grid_m", found=found, needed=needed, hint=hint)
    axes = [
        0.5 * (low + high) + spacing_m * (np.arange(n + 1) - 0.5 * n)
        for low, high, n in zip(region.low_m, region.high_m, steps, strict=True)
    ]
    positions = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    positions = positions[is_clear_of_walls(room, positions, region.wall_distance_m)]
    if not len(positions):
        raise _too_narrow(region, 0, 1)
    return positions


def compatible_positions(receivers_m: FloatArray, apart_m: float) -> BoolArray:
    """Return which receivers, (n_pairs, 3), may stand in one design: far apart, or at one position.

    Of shape (n_pairs, n_pairs), False on the diagonal.
    """
    steps = receivers_m[:, None, :] - receivers_m[None, :, :]
    distance = np.sqrt(np.sum(steps**2, axis=2))
    # the same position may be measured from several sources
    fine = (distance >= apart_m) | (distance < _SAME_POSITION_M)
    np.fill_diagonal(fine, False)
    return np.asarray(fine)


def _too_narrow(region: Region, found: int, needed: int) -> InputError:
    return InputError(
        "the room leaves too little space for candidates",
        where=f"from {region.low_m.round(2).tolist()} to {region.high_m.round(2).tolist()} m",
        found=f"{found} positions at least {region.wall_distance_m:g} m from all walls",
        needed=f"{needed}",
        hint="lower wall_distance_m or widen the heights in [design]; furniture counts as walls",
    )


def design_candidates(
    existing: Scene,
    options: DesignOptions,
    source_distance_m: float,
    seed: int,
    *,
    count_measured: bool = True,
) -> tuple[Scene, Rules, tuple[Finding, ...]]:
    """Return the scene of all pairs, the rules for them, and whether there are few.

    Sources and receivers that exist are candidates where they stand. To them come the positions
    that the options list, or else as many as are needed: receivers on a grid or spread evenly,
    sources spread evenly. Where there are more pairs than wanted, every source keeps the same
    share of them.

    The pairs of `existing` have been measured; they are put first where they count.
    """
    new = _new_points(existing, options, seed)
    sources, receivers = (*existing.sources, *new[0]), (*existing.receivers, *new[1])
    for kind, points in (("source", sources), ("receiver", receivers)):
        if not points:
            what, hint = (
                f"no candidate for a {kind}",
                f"add [{kind}s.NAME] with position = [x, y, z]",
            )
            needed = f"[{kind}s.NAME] with a position, or positions in [design]"
            raise InputError(what, found="none", needed=needed, hint=hint)
        refuse(position_findings(existing.room, points, ()))
    # existing points come first, so that their indices are those of the existing scene
    measured = {(int(s), int(r)) for s, r in existing.pairs}
    every = np.array([(i, j) for i in range(len(sources)) for j in range(len(receivers))])
    was = np.array([(int(s), int(r)) in measured for s, r in every])
    whole = Scene(existing.room, sources, receivers, every, existing.air)
    distance_m = distances_m(whole)
    possible = np.flatnonzero(~was & (distance_m >= source_distance_m))
    if not possible.size:
        farthest_m = distance_m[~was].max(initial=0.0)
        what = "no pair of source and receiver is far enough apart"
        found = f"{int((~was).sum())} pairs, the farthest {farthest_m:.2f} m apart"
        needed = f"at least {source_distance_m:.2f} m"
        raise InputError(what, found=found, needed=needed, hint="set source_distance_m in [design]")
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
    few = f"Only {possible.size} pairs of source and receiver are allowed where {n} were asked for."
    evidence = {"found": possible.size, "asked": n}
    return scene, rules, (Finding(Code.FEW_CANDIDATES, About(), few, evidence),)


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


def _new_points(
    existing: Scene, options: DesignOptions, seed: int
) -> tuple[list[Point], list[Point]]:
    """Return new sources and receivers, each named by a letter and a number not taken yet."""
    room, sources, receivers = existing.room, options.sources, options.receivers
    at_m = [np.array(sources).reshape(-1, 3), np.array(receivers).reshape(-1, 3)]
    if not sources and options.new_sources:
        region = region_of(room, options.source_heights_m, options)
        at_m[0] = spread_positions(room, region, options.new_sources, seed)
    if not receivers:
        region = region_of(room, options.receiver_heights_m, options)
        if options.grid_m is not None:
            at_m[1] = grid_positions(room, region, options.grid_m)
        else:  # one for each pair that is wanted: hardly a position serves two sources
            at_m[1] = spread_positions(room, region, options.n_candidates, seed + 1)
    found = []
    for letter, positions, old in zip(
        "SR", at_m, (existing.sources, existing.receivers), strict=True
    ):
        free = (n for i in count(1) if (n := f"{letter}{i}") not in {p.name for p in old})
        found.append([Point(next(free), p.round(3), options.position_sd_m) for p in positions])
    return found[0], found[1]


def _used(whole: Scene, pairs: IntArray) -> Scene:
    """Return the scene of some pairs, without the points that none of them uses."""
    used_s, s = np.unique(pairs[:, 0], return_inverse=True)
    used_r, r = np.unique(pairs[:, 1], return_inverse=True)
    sources = tuple(whole.sources[i] for i in used_s)
    receivers = tuple(whole.receivers[i] for i in used_r)
    pairs = np.column_stack((s, r))
    return replace(whole, sources=sources, receivers=receivers, pairs=pairs)
