"""Boxes that are measured well and described wrongly, one fault at a time."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roomfit.demo.boxes import BoxPlan
from roomfit.result import Result
from simulated_rooms.patched_box import Patch, patch_area_m2, write_patched_box
from simulated_rooms.random_boxes import random_plan, write_scattering_box

OCTAVES = 8  # of a plan, 63 to 8000 Hz
TRUE_C = 20.0  # degrees, of every simulated room


@dataclass(frozen=True)
class Fault:
    """How a room is simulated, and what its campaign specifies wrongly."""

    name: str
    position_error_m: float = 0.01
    scattering: float = 0.0
    patch: tuple[float, float, float] | None = None  # width, height, absorption
    misspecify: Callable[[str, BoxPlan], str] = lambda text, _: text
    joined: tuple[str, str] | None = None  # the second is specified as the first's material


def _temperature(specified_c: float, sd_c: float | None) -> Callable[[str, BoxPlan], str]:
    spread = "" if sd_c is None else f"\ntemperature_sd_c = {sd_c}"

    def misspecify(text: str, _: BoxPlan) -> str:
        return text.replace("temperature_c = 20.0", f"temperature_c = {specified_c}{spread}")

    return misspecify


def _longer(by_m: float) -> Callable[[str, BoxPlan], str]:
    def misspecify(text: str, plan: BoxPlan) -> str:
        x, y, z = plan.lengths_m
        return text.replace(f"shoebox = {[x, y, z]}", f"shoebox = {[x + by_m, y, z]}")

    return misspecify


def _same_material(text: str, _: BoxPlan) -> str:
    """South and north are specified as one material, as is usual."""
    text = text.replace('north = "material_north"', 'north = "material_south"')
    return re.sub(r"\[materials\.material_north\]\nscattering[^\n]*\n", "", text)


def _position_sd_1_cm(text: str, _: BoxPlan) -> str:
    return re.sub(r"position_sd = [0-9.]+", "position_sd = 0.01", text)


FAULTS = (
    Fault("nothing"),
    Fault("positions 3 cm, sd 1", 0.03, misspecify=_position_sd_1_cm),
    Fault("positions 10 cm, sd 1", 0.10, misspecify=_position_sd_1_cm),
    Fault("2 K, sd 0", misspecify=_temperature(TRUE_C - 2.0, 0.0)),
    Fault("2 K, sd 1 K", misspecify=_temperature(TRUE_C - 2.0, 1.0)),
    Fault("two walls as one", misspecify=_same_material, joined=("south", "north")),
    Fault("curtain forgotten", patch=(2.0, 2.0, 0.7)),
    Fault("door open, 2 m2", patch=(1.0, 2.0, 1.0)),
    Fault("scattering .3 as 0", scattering=0.3),
    Fault("a wall 5 cm off", misspecify=_longer(0.05)),
)


@dataclass(frozen=True)
class Misspecified:
    """One campaign, and the true absorption of the materials that it names."""

    campaign: Path
    absorption: dict[str, np.ndarray]  # of each specified material, (8,)


def write_misspecified(fault: Fault, seed: int, folder: Path) -> Misspecified:
    """Simulate the room of a seed with a fault and write its campaign.

    The room, the positions and the materials of a seed are the same for any fault. Where a wall is
    specified as one material and is of two, the mean over its area counts as true.
    """
    rng = np.random.default_rng(seed)
    plan = random_plan(rng)
    patch = None if fault.patch is None else patch_on_hardest_wall(plan, *fault.patch)
    if fault.scattering:
        walls = np.full(6, fault.scattering)
        campaign = write_scattering_box(plan, walls, folder, rng)
    else:
        campaign = write_patched_box(plan, patch, folder, rng, fault.position_error_m)
    campaign.write_text(fault.misspecify(campaign.read_text(), plan))
    return Misspecified(campaign, _means(fault, plan, patch))


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


def _means(fault: Fault, plan: BoxPlan, patch: Patch | None) -> dict[str, np.ndarray]:
    truth = dict(zip(plan.materials, plan.absorption, strict=True))
    x, y, z = plan.lengths_m
    areas = {"west": y * z, "east": y * z, "south": x * z, "north": x * z}
    if patch is not None:
        name, share = f"material_{patch.wall}", patch_area_m2(patch) / areas[patch.wall]
        truth[name] = (1.0 - share) * truth[name] + share * patch.absorption
    if fault.joined is not None:
        first, second = (f"material_{wall}" for wall in fault.joined)
        truth[first] = 0.5 * (truth[first] + truth.pop(second))  # opposite walls are as large
    return truth


def true_absorption_of(misspecified: Misspecified, answer: Result) -> np.ndarray:
    """Return the true absorption of the answer's materials and octaves, (n_materials, n_bands)."""
    octaves = 62.5 * 2.0 ** np.arange(OCTAVES)
    columns = [int(np.argmin(np.abs(np.log(octaves / f)))) for f in answer.bands.centres_hz]
    return np.array([misspecified.absorption[name][columns] for name in answer.materials])
