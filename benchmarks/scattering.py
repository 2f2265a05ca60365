"""Boxes whose walls scatter: absorption with scattering known, fitted, and not thought of.

    python benchmarks/scattering.py [--first SEED] [--rooms N] [--model coherent] [--scattering S]

Boxes as in `boxes.py`, s = 0.15 at every wall. Data: image sources that add as pressures, thinned
by (1 - s) a hit, and noise modulated by an independent tracer (`testproblems/scattering_box.py`).
Fits: images of all orders to 0.25 s and rays for all that is scattered or later.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roomfit.app.coherent.fit import CoherentOptions, fit_coherent
from roomfit.app.fitting import BandAnswer, band_answer
from roomfit.app.gathering import campaign_scene
from roomfit.app.measuring import MeasuredPair, measure
from roomfit.app.problems import band_problems
from roomfit.app.retracing import Retracer, energy_fits, log_likelihoods, scene_retracer
from roomfit.app.scattering import choose_scattering, suspected_scattering
from roomfit.bands import Bands
from roomfit.files.campaign.campaign import read_campaign
from roomfit.files.campaign.materials import material_knowledge
from roomfit.files.rooms.read import read_room
from roomfit.materials.knowledge import MaterialKnowledge
from roomfit.materials.scattering import Scattering
from roomfit.scene.room import material_areas_m2
from roomfit.scene.scene import Scene
from roomfit.testproblems.measured_box import random_plan
from roomfit.testproblems.scattering_box import write_scattering_box
from roomfit.tracing.settings import TraceSettings

BANDS = slice(1, 7)  # of the simulated octaves 63 to 8000 Hz, those that are fitted
GRID = (0.05, 0.15, 0.3, 0.5)
DURATION_S = 0.25
N_RAYS = 16_384


@dataclass
class Room:
    """One simulated room, ready to be fitted."""

    scene: Scene
    bands: Bands
    knowledge: tuple[MaterialKnowledge, ...]
    measured: tuple[MeasuredPair, ...]
    retracer: Retracer
    truth: np.ndarray
    model: str

    def answers(self, coefficients: np.ndarray) -> tuple[list[BandAnswer], np.ndarray]:
        """Return the answer and the log likelihood of every band for a scattering."""
        start = np.full(len(self.bands), 0.15)
        areas = material_areas_m2(self.scene.room)
        told = (self.scene, self.bands, self.knowledge, self.measured)
        if self.model == "energy":
            fits = energy_fits(*told, self.retracer, start, coefficients)
            rows = self.retracer.at(self._named(coefficients)).binned
            problems = band_problems(*told, rows, start)
            answers = [
                band_answer(p.parameters, f, areas, "energy")
                for p, f in zip(problems, fits, strict=True)
            ]
            return answers, log_likelihoods(fits)
        traced = self.retracer.at(self._named(coefficients))
        fit = fit_coherent(
            *told, traced.paths, traced.binned, start, options=CoherentOptions(model="auto")
        )
        return list(fit.answers), np.nanmax(fit.log_likelihoods, axis=1)

    def _named(self, coefficients: np.ndarray) -> Scattering:
        return Scattering(self.scene.room.materials, coefficients[:, 0])


def simulated(seed: int, s: float, model: str) -> Room:
    """Measure one room."""
    rng = np.random.default_rng(seed)
    plan = random_plan(rng)
    with tempfile.TemporaryDirectory() as folder:
        box = write_scattering_box(plan, np.full(6, s), Path(folder), rng)
        campaign = read_campaign(box.campaign)
        room, _ = read_room(campaign.room)
        scene = campaign_scene(campaign, room)
        measured, _ = measure(campaign, scene)
    settings = TraceSettings(DURATION_S, N_RAYS, 1000, 0.5, image_until_s=DURATION_S)
    retracer = scene_retracer(scene, campaign.bands, settings, least_share=0.5)
    knowledge = material_knowledge(campaign, room.materials)
    order = [plan.materials.index(m) for m in room.materials]
    truth = plan.absorption[order][:, BANDS]
    return Room(scene, campaign.bands, knowledge, measured, retracer, truth, model)


def line(name: str, found: list[tuple[list[BandAnswer], np.ndarray]]) -> str:
    """Return one row of the table."""
    truth = np.array([t for _, t in found])
    value, low, high, sure = (
        np.array([np.stack([getattr(b, key) for b in answers], axis=1) for answers, _ in found])
        for key in ("absorption", "lower95", "upper95", "identifiable")
    )
    error, held = np.abs(value - truth), (low <= truth) & (truth <= high)
    phi = np.median([[b.phi for b in answers] for answers, _ in found])
    return (
        f"{name:<24} {np.median(error):6.3f} {np.quantile(error, 0.9):6.3f} {error.max():6.2f}"
        f" {held.mean():6.2f} {np.median(high - low):6.2f} {phi:6.2f} {sure.mean():6.2f}"
    )


def main() -> None:
    """Run the rooms one after the other and print the pooled lines last."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=400)
    parser.add_argument("--rooms", type=int, default=5)
    parser.add_argument("--model", choices=("energy", "coherent"), default="energy")
    parser.add_argument("--scattering", type=float, default=0.15)
    asked = parser.parse_args()
    print(f"s = {asked.scattering:g}, {asked.model} model, {asked.rooms} rooms")
    print("fit                      median   90 %    max   held  width    phi   sure")
    pooled: dict[str, list[tuple[list[BandAnswer], np.ndarray]]] = {}
    right = fired = 0
    for seed in range(asked.first, asked.first + asked.rooms):
        began = time.perf_counter()
        room = simulated(seed, asked.scattering, asked.model)
        shape = (6, len(room.bands))
        tried: dict[float, tuple[list[BandAnswer], np.ndarray]] = {}

        def fit(c: np.ndarray, room: Room = room, tried: dict = tried) -> np.ndarray:
            value = float(c[0, 0])
            if value not in tried:
                tried[value] = room.answers(c)
            return tried[value][1]

        choice = choose_scattering(fit, np.zeros(shape), np.ones(6, dtype=bool), grid=GRID)
        best = float(choice.coefficients[0, 0])
        smooth = fit(np.zeros(shape))
        findings = suspected_scattering(
            fit, room.scene.room.materials, np.zeros(shape), smooth, trials=(0.15,)
        )
        fit(np.full(shape, asked.scattering))
        right += best == min(GRID, key=lambda s: abs(s - asked.scattering))
        fired += bool(findings)
        values = {s: round(float(tried[s][1].sum() - smooth.sum()), 1) for s in sorted(tried)}
        seconds = time.perf_counter() - began
        print(
            f"seed {seed}: chosen {best:g}, log likelihoods over smooth {values}; {seconds:.0f} s"
        )
        for name, s in (("known", asked.scattering), ("fitted", best), ("not thought of", 0.0)):
            pooled.setdefault(name, []).append((tried[s][0], room.truth))
            print(line(f"{seed} {name}", pooled[name][-1:]), flush=True)
    for name, found in pooled.items():
        print(line(f"all, {name}", found))
    print(f"scattering right in {right} of {asked.rooms}; smooth walls doubted in {fired}")


if __name__ == "__main__":
    main()
