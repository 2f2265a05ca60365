"""Rain against spheres: Monte-Carlo variance, and what it costs in tracing and in rows.

    python benchmarks/rays.py [--room NAME ...] [--seconds S]

For every room and scattering, both estimators trace the same rays; windows of 20 ms from 20 ms on,
absorption 0.2 everywhere, all energy from rays. "variance" is the mean over pairs and windows of
the squared relative Monte-Carlo error, from 32 independent batches (itself uncertain by some 10 %).
The last columns compare at equal work: variance times processor time of the trace (what a trace
costs), and variance times rows (what every later weighing costs), rain over spheres: below 1, rain
wins.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from roomfit.base.air import Air, speed_of_sound_m_s
from roomfit.files.rooms import read_room
from roomfit.files.rooms.model import RoomSpec
from roomfit.materials.priors import uniform_scattering
from roomfit.model.patterns import weigh_parts
from roomfit.model.weighing import energy_rows, weigh
from roomfit.paper.room import paper_scene
from roomfit.room.scene import Point, Room, Scene
from roomfit.tracing.paths import Estimator, TraceSettings
from roomfit.tracing.trace import trace
from simulated_rooms.hall import hall_room

SCATTERINGS = (0.1, 0.3, 0.7)
ABSORPTION = 0.2
WINDOW_S = 0.02
ESTIMATORS: tuple[Estimator, ...] = ("spheres", "rain")
CR2 = Path(__file__).resolve().parents[2] / "shared" / "data" / "bras_cr2"


@dataclass(frozen=True)
class Cost:
    """What one trace brought and took."""

    variance: float
    seconds: float
    rows: int


def cost(scene: Scene, estimator: Estimator, s: float, settings: TraceSettings) -> Cost:
    """Trace once and measure."""
    chosen = replace(settings, estimator=estimator)
    still = uniform_scattering(scene.room.materials, s)
    began = time.process_time()
    paths = trace(scene, chosen, still).paths
    seconds = time.process_time() - began
    c = speed_of_sound_m_s(scene.air)
    edges = np.arange(WINDOW_S, settings.duration_s + 1e-9, WINDOW_S)
    absorption = np.full((len(scene.room.materials), 1), ABSORPTION)
    squares = []
    for pair in range(len(scene.pairs)):
        rows = energy_rows(paths, pair, edges, c)
        energy = weigh(rows, absorption, np.zeros(1), derivative=False).energy[0]
        batches = weigh_parts(rows, None, absorption[:, 0], 0.0).batches
        observed = energy > 0.0
        variance = len(batches) * np.var(batches, axis=0, ddof=1)
        squares.append(variance[observed] / energy[observed] ** 2)
    return Cost(float(np.mean(np.concatenate(squares))), seconds, int((paths.batch >= 0).sum()))


def rooms(names: list[str]) -> list[tuple[str, Scene]]:
    """Return the scenes asked for; the measured room only where its data are."""
    paper = paper_scene()
    box = read_room(RoomSpec(shoebox=(6.1, 4.7, 2.8)))[0]
    made = {
        "paper's room": paper,
        "box": _scene(box, [1.2, 1.5, 1.1], [[4.1, 2.9, 1.2], [2.3, 3.7, 1.4], [5.2, 1.1, 1.8]]),
        "hall, 1012 triangles": _scene(
            hall_room(1012), [3.0, 0.1, 1.5], [[12.0, 2.0, 5.5], [20.0, -3.0, 7.0]]
        ),
    }
    measured = _cr2()
    if measured is not None:
        made["BRAS CR2"] = measured
    return [(n, s) for n, s in made.items() if not names or any(x in n for x in names)]


def _scene(room: Room, source: list[float], receivers: list[list[float]]) -> Scene:
    points = tuple(Point(f"R{i}", np.array(p)) for i, p in enumerate(receivers))
    pairs = np.array([(0, i) for i in range(len(points))])
    air = Air(attenuation="none")
    return Scene(room, (Point("S", np.array(source)),), points, pairs, air)


def _cr2() -> Scene | None:
    if not CR2.is_dir():
        return None
    room, _ = read_room(RoomSpec(file=CR2 / "scene9.ac", unit="m", up="y"))
    return _scene(room, [0.931, -2.547, 0.723], [[-0.993, 1.426, 1.23]])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--room", nargs="*", default=[])
    parser.add_argument("--seconds", type=float, default=0.2)
    parser.add_argument("--rays", type=int, default=16_384)
    asked = parser.parse_args()
    settings = TraceSettings(asked.seconds, asked.rays, -1, 0.5, n_batches=32, seed=3)
    print(
        "| room | s | variance spheres, rain | CPU s | 1000 rows | rain/spheres: x CPU | x rows |"
    )
    print("|---|---|---|---|---|---|---|")
    for name, scene in rooms(asked.room):
        for number, s in enumerate(SCATTERINGS):
            if number == 0:  # loads compiled code
                for estimator in ESTIMATORS:
                    cost(scene, estimator, s, replace(settings, n_rays=64))
            a, b = (cost(scene, estimator, s, settings) for estimator in ESTIMATORS)
            by_time = b.variance * b.seconds / (a.variance * a.seconds)
            by_rows = b.variance * b.rows / (a.variance * a.rows)
            print(
                f"| {name} | {s:g} | {a.variance:.2e}, {b.variance:.2e} "
                f"| {a.seconds:.2f}, {b.seconds:.2f} | {a.rows / 1e3:.0f}, {b.rows / 1e3:.0f} "
                f"| {by_time:.2f} | {by_rows:.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
