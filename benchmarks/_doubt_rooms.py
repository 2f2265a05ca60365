"""Rooms that are described rightly: simulated here, in another program, and measured ones.

Each kind of simulated room takes a seed, from which everything of it follows; measured rooms take
the folder of measurements. All are `hostile.Case`s, arrays in memory, of two octaves where they
are simulated. What a campaign leaves undescribed on purpose is in `RightRoom.expected`.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import roomfit
from hostile import Case, box, described
from known_changes import r3vival
from measured_rooms import bras_campaign, dechorate_campaign
from room_values import studio
from roomfit.base.typing import FloatArray
from roomfit.demo.boxes import (
    WALLS,
    BoxPlan,
    add_noise,
    box_departures,
    box_lattice,
    pressure_of_images,
    true_box,
)
from roomfit.model.patterns import UnknownDirectivity
from simulated_rooms.measured_polyhedron import Shape, polyhedron_plan, write_measured_polyhedron
from simulated_rooms.patched_box import Patch, parted_hits
from simulated_rooms.random_boxes import random_plan
from simulated_rooms.scattering_box import diffuse_echogram, modulated_noise, specular_box

BANDS = roomfit.bands_between("octave", 500, 1000)
PLAN_COLUMNS = (3, 4)  # of these bands among the octaves of a plan, 63 to 8000 Hz
POSITION_ERROR_M = 0.01
DURATION_S = 0.45
N_ENDS = {1: (1, 1), 2: (1, 2), 4: (2, 2), 8: (2, 4)}  # sources and receivers of so many pairs
RATES_HZ = (16_000, 44_100, 48_000)
# A two-way loudspeaker at 1 kHz, about: shares of the Legendre polynomials of degree 1, 2 and 3.
THIRD_ORDER = (0.9, 0.5, 0.2)
NON_OMNIDIRECTIONAL = frozenset({"source-not-omnidirectional"})


@dataclass(frozen=True)
class RightRoom:
    """A kind of room of which nothing is described wrongly but what is expected to be found."""

    make: Callable[[int], Case]  # of a seed
    expected: frozenset[str] = frozenset()  # codes that are no false alarm there
    every: int = 1  # costly kinds are taken in each so-manyth round only


@dataclass(frozen=True)
class Loudspeaker:
    """How sources of a simulated box radiate: omnidirectional, or of first or third order."""

    order: int = 0
    is_aimed: bool = True  # towards the receivers; otherwise anywhere
    directivity: UnknownDirectivity | None = None  # as the campaign has it; None: it says nothing


@dataclass(frozen=True)
class Simulated:
    """What is true of a box of our own simulator beside its plan."""

    n_pairs: int
    rate_hz: int = 16_000
    loudspeaker: Loudspeaker = Loudspeaker()
    scattering: float = 0.0
    specified_scattering: float = 0.0
    # by source, of those that see it
    patches: Mapping[str, Patch] = field(default_factory=dict)


def rate_hz(seed: int) -> int:
    """Return the sampling rate of a seed's recordings."""
    return int(np.random.default_rng([seed, 30]).choice(RATES_HZ))


def spaced_plan(seed: int, n_pairs: int) -> BoxPlan:
    """Return a random box with every source 1 m or more from every receiver."""
    rng = np.random.default_rng([seed, 31])
    n_sources, n_receivers = N_ENDS[n_pairs]
    while True:
        plan = random_plan(rng)
        sources = dict(list(plan.sources_m.items())[:n_sources])
        receivers = dict(list(plan.receivers_m.items())[:n_receivers])
        steps = np.array(list(sources.values()))[:, None] - np.array(list(receivers.values()))
        if np.linalg.norm(steps, axis=-1).min() > 1.0:
            return replace(plan, sources_m=sources, receivers_m=receivers)


def simulated_case(seed: int, plan: BoxPlan, simulated: Simulated) -> Case:
    """Return a box of our own simulator, described as planned.

    The absorption of a wall with a patch is the mean over its area, for the share of the sources
    that see the patch; where not all do, an answer between both is right as well.
    """
    rng = np.random.default_rng([seed, 32])
    responses = _responses(plan, simulated, rng)
    room = roomfit.shoebox_room(plan.lengths_m, dict(zip(WALLS, plan.materials, strict=True)))
    sources, receivers = (
        [roomfit.Point(name, np.array(p), POSITION_ERROR_M) for name, p in ends.items()]
        for ends in (plan.sources_m, plan.receivers_m)
    )
    arguments = {
        "scene": roomfit.scene_of(room, sources, receivers),
        "measurements": [
            roomfit.Measurement(*pair, x, simulated.rate_hz) for pair, x in responses.items()
        ],
        "settings": roomfit.Settings(),
    }
    if simulated.loudspeaker.directivity is not None:
        arguments["directivities"] = dict.fromkeys(
            plan.sources_m, simulated.loudspeaker.directivity
        )
    without = plan.absorption[:, PLAN_COLUMNS]
    seen = np.array(without)
    for patch in list(simulated.patches.values())[:1]:
        wall = WALLS.index(patch.wall)
        share = _patch_share(plan, patch)
        seen[wall] += share * (patch.absorption[list(PLAN_COLUMNS)] - without[wall])
    share_seen = len(simulated.patches) / len(plan.sources_m)
    mean = without + share_seen * (seen - without)
    truth = dict(zip(plan.materials, mean, strict=True))
    case = described(arguments, truth, BANDS, simulated.specified_scattering)
    if 0.0 < share_seen < 1.0:
        case = replace(case, interval=(np.minimum(without, seen), np.maximum(without, seen)))
    return case


def _patch_share(plan: BoxPlan, patch: Patch) -> float:
    """Return the share of its wall that a patch covers."""
    axis = WALLS.index(patch.wall) // 2
    sides = [length for i, length in enumerate(plan.lengths_m) if i != axis]
    return float(np.prod(np.subtract(patch.upper_m, patch.lower_m)) / np.prod(sides))


def _responses(
    plan: BoxPlan, simulated: Simulated, rng: np.random.Generator
) -> dict[tuple[str, str], FloatArray]:
    """Return samples of every source with every receiver."""
    synthetic, at = true_box(plan, POSITION_ERROR_M, rng)
    noise_db = rng.uniform(-60.0, -45.0)
    walls = np.full(6, simulated.scattering)
    specular = specular_box(synthetic, walls)
    receivers = np.array([at[r] for r in plan.receivers_m])
    n_samples, responses = round(DURATION_S * simulated.rate_hz), {}
    for s in plan.sources_m:
        level_db = rng.normal(0.0, 3.0, synthetic.centres_hz.size)
        radiates = _pattern(simulated.loudspeaker, receivers.mean(axis=0) - at[s], rng)
        diffuse = [np.zeros(n_samples)] * len(receivers)
        if simulated.scattering:
            echograms = diffuse_echogram(
                synthetic, walls, at[s], receivers, DURATION_S, rng, n_rays=20_000
            )
            sound = n_samples, float(simulated.rate_hz), synthetic.centres_hz, level_db, rng
            diffuse = [modulated_noise(e, *sound) for e in echograms]
        for r, late in zip(plan.receivers_m, diffuse, strict=True):
            steps, hits, _ = box_lattice(specular, at[s], at[r], DURATION_S)
            images, heard = (np.linalg.norm(steps, axis=0), hits), specular
            if s in simulated.patches:
                images, heard = parted_hits(specular, simulated.patches[s], at[r], steps, hits)
            sent = radiates(box_departures(specular, at[s], at[r], DURATION_S))
            early = pressure_of_images(
                images, heard, DURATION_S, float(simulated.rate_hz), level_db, sent
            )
            responses[s, r] = add_noise(early + late, noise_db, rng)
    return responses


def _pattern(
    loudspeaker: Loudspeaker, toward: FloatArray, rng: np.random.Generator
) -> Callable[[FloatArray], FloatArray]:
    """Return the amplitude of a source in directions, (n, 3) unit vectors."""
    aim = toward if loudspeaker.is_aimed else rng.standard_normal(3)
    aim = aim / np.linalg.norm(aim)
    shares = {0: (), 1: (rng.uniform(0.4, 0.9),), 3: THIRD_ORDER}[loudspeaker.order]
    series = np.polynomial.Legendre((1.0, *shares))
    return lambda directions: np.asarray(series(directions @ aim))


def our_box(seed: int, n_pairs: int, **changes: Any) -> Case:
    """Return a box of our simulator, sampled at a rate that follows from its seed."""
    plan = spaced_plan(seed, n_pairs)
    return simulated_case(seed, plan, Simulated(n_pairs, rate_hz(seed), **changes))


def cycling(make: Callable[..., Case], *n_pairs: int, **changes: Any) -> Callable[[int], Case]:
    """Return a maker that takes another number of pairs from seed to seed."""
    return lambda seed: make(seed, n_pairs[seed % len(n_pairs)], **changes)


def pyroom_box(
    seed: int, n_pairs: int, scattering: float | None = None, noise_db: float | None = None
) -> Case:
    """Return a box of pyroomacoustics, scattering specified as it is; by images alone for None."""
    simulated = {"rate_hz": rate_hz(seed), "noise_db": noise_db, "scattering": scattering}
    return box(seed, n_pairs, BANDS, scattering or 0.0, simulated)


def polyhedron(seed: int, n_pairs: int, shape: Shape) -> Case:
    """Return a room that is no box, of one or two sources."""
    plan = polyhedron_plan(shape, np.random.default_rng([seed, 7]))
    n_sources, n_receivers = N_ENDS[n_pairs]
    plan = replace(
        plan,
        sources_m=dict(list(plan.sources_m.items())[:n_sources]),
        receivers_m=dict(list(plan.receivers_m.items())[:n_receivers]),
    )
    with tempfile.TemporaryDirectory() as folder:
        made = write_measured_polyhedron(plan, Path(folder), np.random.default_rng([seed, 8]))
        arguments = roomfit.load_campaign(made.campaign)
    truth = dict(zip(made.materials, made.absorption[:, PLAN_COLUMNS], strict=True))
    return described(arguments, truth, BANDS, 0.0)


def without_noise(seed: int, n_pairs: int, **simulated: Any) -> Case:
    """Return a box of pyroomacoustics whose files have no noise."""
    return pyroom_box(seed, n_pairs, noise_db=-np.inf, **simulated)


RIGHT_ROOMS: dict[str, RightRoom] = {
    **{f"ours, {n} pairs": RightRoom(partial(our_box, n_pairs=n)) for n in N_ENDS},
    "ours, scattering .1": RightRoom(
        cycling(our_box, 2, 4, 8, scattering=0.1, specified_scattering=0.1)
    ),
    **{f"pyroom images, {n} pairs": RightRoom(partial(pyroom_box, n_pairs=n)) for n in N_ENDS},
    "pyroom images, no noise": RightRoom(cycling(without_noise, 1, 2, 4)),
    "pyroom rays, -60 dB": RightRoom(
        cycling(pyroom_box, 1, 2, 4, 8, scattering=0.1, noise_db=-60.0)
    ),
    "pyroom rays, no noise": RightRoom(cycling(without_noise, 1, 2, 4, 8, scattering=0.1)),
    "slanted": RightRoom(cycling(polyhedron, 2, 4, shape="slanted"), every=3),
    "l-shaped": RightRoom(cycling(polyhedron, 2, 4, shape="l-shaped"), every=3),
    "paper's room": RightRoom(cycling(polyhedron, 2, shape="paper"), every=3),
    **{
        f"undescribed order {order}, {'aimed' if aimed else 'any way'}": RightRoom(
            cycling(our_box, 2, 4, 8, loudspeaker=Loudspeaker(order, aimed)), NON_OMNIDIRECTIONAL
        )
        for order in (1, 3)
        for aimed in (True, False)
    },
    "loudspeaker fitted": RightRoom(
        cycling(our_box, 4, 8, loudspeaker=Loudspeaker(1, False, UnknownDirectivity()))
    ),
}


def dechorate(data: Path, fitted: bool) -> Case:
    """Return the six files of dEchorate, floor, ceiling and walls three materials."""
    text = dechorate_campaign(data / "dechorate", ())
    if fitted:
        text = text.replace("[sources.S1]\n", '[sources.S1]\ndirectivity = "fit"\n')
    return from_text(text)


def from_text(text: str) -> Case:
    """Return a campaign of a measured room; nobody knows its absorption."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "campaign.toml"
        path.write_text(text)
        arguments = roomfit.load_campaign(path)
    return measured_case(dict(arguments))


def measured_case(arguments: dict[str, Any]) -> Case:
    """Return a measured room, its absorption unknown: NaN."""
    bands = arguments.get("bands") or roomfit.bands_between("octave", 125, 4000)
    n_materials = len(arguments["scene"].room.materials)
    return Case(arguments, np.full((n_materials, len(bands)), np.nan))


def r3vival_state(data: Path, state: str) -> Case:
    """Return a state of R3VIVAL with twelve loudspeakers of one make, their directivity fitted."""
    scene, files, directivities = r3vival(data, state, 60, ["150", "200"])
    return measured_case({"scene": scene, "measurements": files, "directivities": directivities})


def ptb_studio(data: Path) -> Case:
    """Return PTB's studio with the ISO 3382 values of six pairs, scattering as it was stated."""
    known = studio(data / "ptb_studio")
    priors = tuple(
        replace(prior, scattering=np.full(prior.prior_logit_mean.size, s))
        for prior, s in zip(known.priors, known.scattering, strict=True)
    )
    return measured_case({"scene": known.scene, "measurements": known.values, "materials": priors})


def _whatever_seed(make: Callable[[], Case], _: int) -> Case:
    """Return a room that was measured, of which there is one."""
    return make()


def measured_rooms(data: Path) -> dict[str, RightRoom]:
    """Return the measured rooms that lie in a folder; each is the same for every seed."""
    makers: dict[str, tuple[str, Callable[[], Case], frozenset[str]]] = {
        f"r3vival {state}": ("r3vival", partial(r3vival_state, data, state), frozenset())
        for state in ("000", "100", "R")
    }
    makers["bras_cr2"] = (
        "bras_cr2", lambda: from_text(bras_campaign(data / "bras_cr2")), frozenset()
    )  # fmt: skip
    makers["ptb_studio"] = ("ptb_studio", partial(ptb_studio, data), frozenset())
    makers["dechorate, fitted"] = ("dechorate", partial(dechorate, data, True), frozenset())
    makers["dechorate"] = ("dechorate", partial(dechorate, data, False), NON_OMNIDIRECTIONAL)
    return {
        f"measured {name}": RightRoom(partial(_whatever_seed, make), expected)
        for name, (folder, make, expected) in makers.items()
        if (data / folder).is_dir()
    }
