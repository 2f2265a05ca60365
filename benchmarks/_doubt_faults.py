"""One fault at a time in rooms that are right otherwise, and which findings name its cause.

Those of `hostile.py`, and walls of two materials, further exponential windows, displaced points,
walls and arrays, files that are exchanged, scattering and absorbers that are not described.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

import hostile
import roomfit
from _doubt_rooms import (
    PLAN_COLUMNS,
    RightRoom,
    Simulated,
    our_box,
    pyroom_box,
    rate_hz,
    simulated_case,
    spaced_plan,
)
from hostile import Case, exponential_window, longer, with_files, with_scene
from roomfit.base.typing import FloatArray
from roomfit.demo.boxes import WALLS, BoxPlan
from roomfit.room.scene import Point
from simulated_rooms.patched_box import Patch
from simulated_rooms.random_boxes import random_plan

OCTAVES = 8  # of a plan, 63 to 8000 Hz


def patch_on_hardest_wall(
    plan: BoxPlan, width_m: float, height_m: float, absorption: float
) -> Patch:
    """Return a door on the hardest of the upright walls, where it changes most."""
    names = ("west", "east", "south", "north")
    hardest = int(np.argmin(plan.absorption[:4].mean(axis=1)))
    along = plan.lengths_m[1] if hardest < 2 else plan.lengths_m[0]
    begin = 0.3 * (along - width_m)
    values = np.full(OCTAVES, absorption)
    return Patch(names[hardest], (begin, 0.0), (begin + width_m, height_m), values)


# Of `hostile.FAULTS`: what is no fault, and what no data can tell from a right description.
HARMLESS = ("resampled", "10 s at 192 kHz", "ceiling fixed and right")
UNTELLABLE = ("mirrored",)


@dataclass(frozen=True)
class Fault:
    """A fault: the case that a seed makes with it, and the codes that name its cause.

    `causes` is empty where no code does: such a fault can be found or harmless, but not named.
    """

    make: Callable[[int], Case]
    causes: frozenset[str]


def base(seed: int) -> Case:
    """Return the right room into which a fault is put: ours and the other program's in turn."""
    maker = (pyroom_box, our_box)[seed % 2]
    return maker(seed, (4, 8)[seed // 2 % 2])


def _put(change: Callable[[Case], Case], seed: int) -> Case:
    return change(base(seed))


def _seeded(change: Callable[[Case, np.random.Generator], Case], seed: int) -> Case:
    return change(base(seed), np.random.default_rng([seed, 33]))


def moved(case: Case, rng: np.random.Generator, metres: float, kind: str) -> Case:
    """Specify all receivers, or one point, so much off, together and within the room.

    `kind`: "array" for all receivers, "one" for a single source or receiver.
    """
    points = [*case.scene.sources, *case.scene.receivers]
    chosen = {p.name for p in case.scene.receivers}
    if kind == "one":
        chosen = {points[rng.integers(len(points))].name}
    step = _possible_step(
        [p.position_m for p in points if p.name in chosen],
        np.array(case.scene.room.shoebox_m),
        metres,
        rng,
    )

    def at(many: Sequence[Point]) -> tuple[Point, ...]:
        return tuple(
            replace(p, position_m=p.position_m + step) if p.name in chosen else p for p in many
        )

    return with_scene(case, sources=at(case.scene.sources), receivers=at(case.scene.receivers))


def _possible_step(
    places_m: Sequence[FloatArray], lengths_m: FloatArray, metres: float, rng: np.random.Generator
) -> FloatArray:
    """Return a step in a random direction after which all places are 10 cm from every wall.

    Shorter, where the room leaves no space for it.
    """
    for attempt in range(10_000):
        step = rng.standard_normal(3)
        step *= metres * 0.999**attempt / np.linalg.norm(step)
        after = np.array(places_m) + step
        if np.all((after > 0.1) & (after < lengths_m - 0.1)):
            break
    return step


def shuffled(case: Case, rng: np.random.Generator) -> Case:
    """Give every file the name of another one."""
    files, n = case.files, len(case.files)
    while True:
        order = rng.permutation(n)
        if np.all(order != np.arange(n)):
            break
    taken = [replace(m, samples=files[k].samples) for m, k in zip(files, order, strict=True)]
    return with_files(case, taken)


def sources_exchanged(case: Case) -> Case:
    """Exchange the files of two sources, microphone by microphone."""
    of = {(m.source, m.receiver): m.samples for m in case.files}
    names = [p.name for p in case.scene.sources]
    other = dict(zip(names, reversed(names), strict=True))
    return with_files(
        case, [replace(m, samples=of[other[m.source], m.receiver]) for m in case.files]
    )


def two_walls_as_one(case: Case) -> Case:
    """Specify the material of the south wall for the north wall, too; their mean is true."""
    names = list(case.scene.room.materials)
    south, north = WALLS.index("south"), WALLS.index("north")
    own = dict(zip(WALLS, names, strict=True))
    lengths_m = case.scene.room.shoebox_m
    assert lengths_m is not None
    room = roomfit.shoebox_room(lengths_m, {**own, "north": names[south]})
    truth = dict(zip(names, case.absorption, strict=True))
    truth[names[south]] = 0.5 * (case.absorption[south] + case.absorption[north])
    priors = tuple(k for k in case.arguments["materials"] if k.name != names[north])
    arguments = {**with_scene(case, room=room).arguments, "materials": priors}
    return replace(
        case, arguments=arguments, absorption=np.array([truth[k] for k in room.materials])
    )


def of_two_materials(seed: int, share: float) -> Case:
    """Return a box one wall of which has another material over a share of its length."""
    plan = spaced_plan(seed, (4, 8)[seed % 2])
    rng = np.random.default_rng([seed, 34])
    wall = int(rng.integers(4))
    columns = list(PLAN_COLUMNS)
    own = plan.absorption[wall]
    while True:
        other = random_plan(rng).absorption[0]
        if abs(np.mean(other[columns] - own[columns])) > 0.2:
            break
    along, high = plan.lengths_m[1 - wall // 2], plan.lengths_m[2]
    patch = Patch(WALLS[wall], (0.0, 0.0), (share * along, high), other)
    return _patched(seed, plan, patch, len(plan.sources_m))


def _patched(seed: int, plan: BoxPlan, patch: Patch, n_sources: int) -> Case:
    patches = dict.fromkeys(list(plan.sources_m)[:n_sources], patch)
    n_pairs = len(plan.sources_m) * len(plan.receivers_m)
    return simulated_case(seed, plan, Simulated(n_pairs, rate_hz(seed), patches=patches))


def with_patch(seed: int, patch: tuple[float, float, float], n_sources: int | None = None) -> Case:
    """Return a box with something on its hardest wall that is not drawn.

    Parameters
    ----------
    patch : tuple of float
        Width, height and absorption.
    n_sources : int, optional
        For how many sources it is there; left out: all.
    """
    plan = spaced_plan(seed, (4, 8)[seed % 2])
    found = patch_on_hardest_wall(plan, *patch)
    return _patched(seed, plan, found, len(plan.sources_m) if n_sources is None else n_sources)


def scattering_not_described(seed: int, scattering: float) -> Case:
    """Return a box whose walls scatter and are specified as smooth."""
    return our_box(seed, (4, 8)[seed % 2], scattering=scattering)


CLIPPED = ("response-clipped",)
PLACES = (
    "displacement-detected",
    "position-inconsistent",
    "position-uncertainty-inflated",
    "geometry-shift-implausible",
)
OUTLINE = ("wall-position-mismatch", "displacement-detected")
SCALE = ("coordinates-scaled",)
FILES = ("exchanged",)
WRONG_FILE = ("measurement-outlier", "recording-unusable", "repeated-responses-differ")
CLOCK = ("recordings-late", "time-zero-mismatch")
SURFACE = ("reflection-disagrees",)
GATE = ("noise-gated",)
_CAUSES_OF_HOSTILE: dict[str, tuple[str, ...]] = {
    "exponential window 0.3 s": ("decay-bent",),
    "exponential window 1 s": ("decay-bent",),
    "clipped at half": CLIPPED,
    "noise gate": GATE,
    "denoised": (*GATE, "decay-bent"),
    "every file twice": ("recording-counted-once", "recording-of-two-pairs"),
    "35 degrees, exactly": SCALE,
    "3 cm": PLACES,
    "10 cm": PLACES,
    "30 cm": PLACES,
    "files swapped": FILES,
    "ends exchanged": (*FILES, *PLACES),
    "one +6 dB": ("levels-apart",),
    # the sentence of a time zero that mismatches asks for it
    "another room's file": (*WRONG_FILE, "time-zero-mismatch"),
    "sampling rate": SCALE,
    "5 ms late": CLOCK,
    "reversed": (*CLOCK, *WRONG_FILE),
    "silent": WRONG_FILE,
    "polarity": ("polarity-differs",),
    "1.1 times": SCALE,
    "wall 0.3 m out": OUTLINE,
    "wall missing": OUTLINE,
}


def _faults() -> dict[str, Fault]:
    left_out = ("none", *HARMLESS)
    found: dict[str, Fault] = {
        name: Fault(partial(_put, change), frozenset(_CAUSES_OF_HOSTILE.get(name, ())))
        for name, change in hostile.FAULTS.items()
        if name not in left_out
    }

    def add(name: str, make: Callable[[int], Case], causes: Sequence[str]) -> None:
        found[name] = Fault(make, frozenset(causes))

    for seconds in (0.1, 0.2, 0.5, 2.0):
        change = exponential_window(seconds)
        add(f"exponential window {seconds:g} s", partial(_put, change), ("decay-bent",))
    for metres in (0.05, 0.1, 0.2, 0.5, 1.0):
        for kind, title in (("array", "array"), ("one", "one point")):
            shift = partial(moved, metres=metres, kind=kind)
            add(f"{title} {metres:g} m off", partial(_seeded, shift), PLACES)
    for metres in (0.05, -0.1, 0.2):
        add(f"wall {metres:+g} m", partial(_put, longer(metres)), OUTLINE)
    add("shuffled", partial(_seeded, shuffled), FILES)
    add("sources exchanged", partial(_put, sources_exchanged), FILES)
    add("two walls as one", partial(_put, two_walls_as_one), SURFACE)
    for name, share in (("half", 0.5), ("third", 1.0 / 3.0)):
        add(f"wall of two materials, a {name}", partial(of_two_materials, share=share), SURFACE)
    for scattering in (0.1, 0.2, 0.4):
        name = f"scattering {scattering:g} as 0"
        make = partial(scattering_not_described, scattering=scattering)
        add(name, make, ("scattering-underestimated",))
    add("absorber not drawn", partial(with_patch, patch=(2.0, 2.0, 0.7)), SURFACE)
    door = (1.0, 2.0, 1.0)
    add("door open", partial(with_patch, patch=door), SURFACE)
    add("door open for one source", partial(with_patch, patch=door, n_sources=1), SURFACE)
    return found


FAULTS: dict[str, Fault] = _faults()
# Changes of right rooms that are no fault.
HARMLESS_CHANGES: dict[str, RightRoom] = {
    name: RightRoom(partial(_put, hostile.FAULTS[name]), every=3 if "192" in name else 1)
    for name in HARMLESS
}
