"""Boxes whose walls scatter: absorption with scattering known, fitted, and not thought of.

    python benchmarks/scattering.py [--first SEED] [--rooms N] [--model auto] [--scattering S]
        [--level S] [--choice]

Boxes as in `boxes.py`, s = 0.15 at every wall, or of --level at floor and ceiling. Data: image
sources that add as pressures, thinned by (1 - s) a hit, and noise modulated by an independent
tracer (`simulated_rooms/random_boxes.py`).
Each room is written as a campaign and identified three times as anybody's: its walls' scattering
specified, fitted (which chooses among eight values by energies), and none. Right is
what is fitted if of .05, .15, .3 and .5 the nearest (in ratio) is the truth. "sure" is the share
called identifiable, "wrong" how many of these lie outside their interval.

--choice    nothing is fitted: which coefficient is assumed where none is specified, and what does
            as well
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from roomfit.base.findings import Code
from roomfit.checks.examine import eyring_start
from roomfit.demo.boxes import PLAN_BANDS, BoxPlan
from roomfit.files.inputs import load_campaign
from roomfit.fit.measurements import collect_measurements
from roomfit.fit.paths import traced_paths
from roomfit.fit.scattering import ChosenScattering
from roomfit.identify import identify
from roomfit.materials.priors import complete_priors
from roomfit.result import Result
from roomfit.settings import Model
from simulated_rooms.random_boxes import random_plan, write_scattering_box

GRID = (0.05, 0.15, 0.3, 0.5)


@dataclass(frozen=True)
class Outcome:
    """One fit of one room, and what is true in the same bands."""

    answer: Result
    true: np.ndarray  # (n_materials, n_bands)

    @property
    def chosen(self) -> float:
        """The value of the grid nearest to the scattering that the fit used."""
        used = self.answer.scattering
        assert used is not None, "every fit of responses tells what it traced with"
        s = float(np.median(used))
        return min(GRID, key=lambda g: abs(np.log(max(s, 1e-3) / g)))


def outcome(plan: BoxPlan, campaign: Path, specified: str, model: Model) -> Outcome:
    """Identify a campaign with what is specified of scattering, and set the truth beside it."""
    text = campaign.read_text()
    file = campaign.with_name("specified.toml")
    file.write_text(text.replace("scattering = 0.0", f"scattering = {specified}"))
    arguments = load_campaign(file)
    arguments["settings"] = replace(arguments["settings"], model=model)
    answer = identify(**arguments)
    rows = np.array([plan.materials.index(name) for name in answer.materials])
    bands = np.searchsorted(PLAN_BANDS.centres_hz, np.array(answer.bands.centres_hz) / 1.2)
    return Outcome(answer, plan.absorption[np.ix_(rows, bands)])


def choice(campaign: Path) -> ChosenScattering:
    """Return what is assumed where nothing is specified of scattering."""
    text = campaign.read_text().replace("scattering = 0.0", "")
    file = campaign.with_name("unspecified.toml")
    file.write_text(text)
    given = load_campaign(file)
    scene, bands = given["scene"], given["bands"]
    measured = collect_measurements(scene, given["measurements"], bands, {})
    priors = complete_priors(scene.room.materials, (), bands)
    start = eyring_start(measured)
    traced = traced_paths(measured, priors, given["settings"], start, None)
    return traced.chosen_scattering[0]


def line(name: str, done: list[Outcome]) -> str:
    """Return one row of the table."""
    true = np.stack([o.true for o in done])
    value, low, high, sure = (
        np.stack([getattr(o.answer, key) for o in done])
        for key in ("absorption", "lower95", "upper95", "identifiable")
    )
    error, held = np.abs(value - true), (low <= true) & (true <= high)
    wrong = int(np.sum(sure & ~held))
    phi = np.median([o.answer.chi2_reduced for o in done])
    null = np.stack(
        [o.answer.areas_m2 @ o.answer.absorption / o.answer.areas_m2.sum() for o in done]
    )
    nothing = np.median(np.abs(null[:, None, :] - true))
    return (
        f"{name:<24} {np.median(error):6.3f} {np.quantile(error, 0.9):6.3f} {error.max():6.2f}"
        f" {held.mean():6.2f} {np.median(high - low):6.2f} {phi:6.2f} {sure.mean():6.2f}"
        f" {wrong:6d} {nothing:6.3f} {np.mean([o.answer.seconds for o in done]):6.0f}"
    )


def main() -> None:
    """Run the rooms one after the other and print the pooled lines last."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=400)
    parser.add_argument("--rooms", type=int, default=5)
    parser.add_argument("--model", choices=("energy", "auto", "coherent"), default="auto")
    parser.add_argument("--scattering", type=float, default=0.15)
    parser.add_argument("--level", type=float, help="of floor and ceiling, if another")
    parser.add_argument("--choice", action="store_true", help="what is assumed, nothing fitted")
    asked = parser.parse_args()
    level = asked.scattering if asked.level is None else asked.level
    walls = np.array([asked.scattering] * 4 + [level] * 2)
    if asked.choice:
        for seed in range(asked.first, asked.first + asked.rooms):
            rng = np.random.default_rng(seed)
            with tempfile.TemporaryDirectory() as folder:
                found = choice(write_scattering_box(random_plan(rng), walls, Path(folder), rng))
            value, low, high = (x[0] for x in (found.value, found.lower, found.upper))
            print(f"{seed}: {value:g} ({low:g} to {high:g} do as well)", flush=True)
        return
    print(f"s = {asked.scattering:g}, level {level:g}, model {asked.model}, {asked.rooms} rooms")
    titles = ("median", "90 %", "max", "held", "width", "phi", "sure", "wrong", "null", "s")
    print(f"{'fit':<24}" + "".join(f" {title:>6}" for title in titles))
    pooled: dict[str, list[Outcome]] = {}
    fired = 0
    cases = (("known", f"{asked.scattering:g}"), ("fitted", '"fit"'), ("not thought of", "0.0"))
    for seed in range(asked.first, asked.first + asked.rooms):
        rng = np.random.default_rng(seed)
        with tempfile.TemporaryDirectory() as folder:
            plan = random_plan(rng)
            campaign = write_scattering_box(plan, walls, Path(folder), rng)
            for name, specified in cases:
                done = outcome(plan, campaign, specified, asked.model)
                pooled.setdefault(name, []).append(done)
                print(
                    line(f"{seed} {name}", [done]), *dict.fromkeys(done.answer.models), flush=True
                )
        fired += any(f.code == Code.SCATTERING_UNDERESTIMATED for f in done.answer.findings)
    for name, all_of in pooled.items():
        print(line(f"all, {name}", all_of))
    nearest = min(GRID, key=lambda g: abs(np.log(asked.scattering / g)))
    right = sum(o.chosen == nearest for o in pooled["fitted"])
    print(f"scattering right in {right} of {asked.rooms}; smooth walls doubted in {fired}")


if __name__ == "__main__":
    main()
