"""The pairs of source and receiver that could be measured, and those that have been."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.errors import InputError
from roomfit.files.campaign.campaign import Campaign
from roomfit.files.campaign.schema import Position
from roomfit.files.parameters import read_parameters
from roomfit.findings import Finding
from roomfit.geometry.faults import refuse
from roomfit.placement.choose import Rules
from roomfit.placement.places import (
    compatible_places,
    even_part,
    grid_places,
    region_of,
    spread_places,
)
from roomfit.scene.positions import NEAREST_PAIR_M, position_findings
from roomfit.scene.room import Room
from roomfit.scene.scene import Point, Scene, distances_m
from roomfit.typing import FloatArray, IntArray

# Receivers made for each pair that is wanted: enough that hardly a place serves two sources.
_RECEIVERS_PER_PAIR = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """All pairs, those measured already first.

    Attributes
    ----------
    scene : Scene
    n_held : int
        How many of its pairs have been measured and are to count.
    rules : Rules
    findings : tuple of Finding
    """

    scene: Scene
    n_held: int
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
    held = np.flatnonzero(was) if count_measured else np.zeros(0, dtype=np.int64)
    scene = _used(whole, every[np.concatenate((held, possible))])
    return Candidates(
        scene, held.size, _rules(campaign, scene, held.size, most_sources), _few(possible.size, n)
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
    told = campaign.design
    taken = [p.name for p in campaign.sources]
    if told.sources:
        return _named("S", np.array(told.sources), taken, told.position_sd)
    if told.new_sources == 0:
        return ()
    region = region_of(room, told.source_heights_m, told.wall_distance_m, _box(told.region_m))
    places = spread_places(room, region, told.new_sources, campaign.seed)
    return _named("S", places, taken, told.position_sd)


def _new_receivers(campaign: Campaign, room: Room, n: int) -> tuple[Point, ...]:
    told = campaign.design
    taken = [p.name for p in campaign.receivers]
    if told.receivers:
        return _named("R", np.array(told.receivers), taken, told.position_sd)
    region = region_of(room, told.receiver_heights_m, told.wall_distance_m, _box(told.region_m))
    if told.grid_m is not None:
        places = grid_places(room, region, told.grid_m)
    else:
        places = spread_places(
            room, region, int(np.ceil(_RECEIVERS_PER_PAIR * n)), campaign.seed + 1
        )
    return _named("R", places, taken, told.position_sd)


def _box(told: tuple[Position, Position] | None) -> tuple[FloatArray, FloatArray] | None:
    return None if told is None else (np.array(told[0]), np.array(told[1]))


def _named(letter: str, places_m: FloatArray, taken: list[str], sd_m: float) -> tuple[Point, ...]:
    """Return points named by a letter and a number that is not taken yet."""
    numbers = (i for i in range(1, len(places_m) + len(taken) + 1) if f"{letter}{i}" not in taken)
    return tuple(Point(f"{letter}{next(numbers)}", place.round(3), sd_m) for place in places_m)


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


def _rules(campaign: Campaign, scene: Scene, n_held: int, most_sources: int | None) -> Rules:
    receivers = np.array([r.position_m for r in scene.receivers])[scene.pairs[:, 1]]
    told = campaign.design
    candidate = np.arange(len(scene.pairs)) >= n_held
    most = told.most_sources if most_sources is None else most_sources
    apart_m = max(told.receiver_distance_m, NEAREST_PAIR_M)
    return Rules(scene.pairs[:, 0], compatible_places(receivers, apart_m), candidate, most)


def _few(found: int, asked: int) -> tuple[Finding, ...]:
    if found >= asked:
        return ()
    return (
        Finding(
            "few-candidates",
            "info",
            f"Only {found} pairs of source and receiver are allowed where {asked} were asked for.",
            {"found": found, "asked": asked},
        ),
    )
