"""The paper's problem with other rays for the measurement than for the model.

    python benchmarks/independent_rays.py [--repeats 8]

The paper makes "measurement" and model with the same rays, so that the error is exactly 0 at the
truth, however few the rays. Here the measurement is the mean of four traces of 262,144 rays, and
the models have others; least squares from even and random points, one pair (case 3) or all three.
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy.optimize import least_squares

from roomfit.model.weighing import EnergyRows
from roomfit.paper.room import (
    CASES,
    DIVISIONS,
    PRINTED_ARRIVALS_MS,
    Division,
    SquaresProblem,
    division_rows,
    paper_scene,
    residuals,
    trace_paper_room,
    whole_windows_s,
    window_energies,
)
from roomfit.tracing.paths import Paths

PAIRS = {1: (2,), 3: (0, 1, 2)}  # case 3 is the only one off the room's plane of symmetry
RAYS = (1_000, 10_000, 18_000, 100_000, 300_000)
MODEL_SEED = 100_000  # seeds of measurement and model never meet


def rows_of(paths: Paths, division: Division, cases: tuple[int, ...]) -> list[EnergyRows]:
    """Return the rows of some cases; windows from the printed arrival, as few rays are late."""
    first_ms = [PRINTED_ARRIVALS_MS[CASES[case]][1] for case in cases]
    return [
        division_rows(paths, case, whole_windows_s(ms, 5), division)
        for case, ms in zip(cases, first_ms, strict=True)
    ]


def found(problems: list[SquaresProblem], n: int, rng: np.random.Generator) -> np.ndarray:
    """Return the absorption of least squares over all pairs."""

    def rows(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        parts = [residuals(problem, x) for problem in problems]
        return np.concatenate([r for r, _ in parts]), np.concatenate([j for _, j in parts])

    starts = [np.full(n, 0.4), *rng.uniform(0.01, 0.99, (3, n))]
    ends = [
        least_squares(lambda x: rows(x)[0], s, lambda x: rows(x)[1], bounds=(0, 1), x_scale="jac")
        for s in starts
    ]
    return np.asarray(min(ends, key=lambda end: end.cost).x)


def main() -> None:
    """Print the rms error of an absorption over the number of rays."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=8)
    parser.add_argument("--rays", type=int, nargs="+", default=RAYS)
    asked = parser.parse_args()
    scene = paper_scene()
    measured = [trace_paper_room(scene, 262_144, "sobol", seed) for seed in range(4)]
    kinds = [(n, cases, d) for n, cases in PAIRS.items() for d in DIVISIONS.values()]
    for rays in asked.rays:
        seeds = range(MODEL_SEED, MODEL_SEED + asked.repeats)
        models = [trace_paper_room(scene, rays, "sobol", seed) for seed in seeds]
        for n_pairs, cases, division in kinds:
            truth = np.array(division.true_absorption)
            parts = [rows_of(paths, division, cases) for paths in measured]
            energies = [
                np.mean([window_energies(rows, truth) for rows in case], axis=0)
                for case in zip(*parts, strict=True)
            ]
            off = []
            for repeat, paths in enumerate(models):
                pairs = zip(rows_of(paths, division, cases), energies, strict=True)
                problems = [SquaresProblem(rows, energy) for rows, energy in pairs]
                rng = np.random.default_rng((rays, repeat))
                off.append(found(problems, truth.size, rng) - truth)
            error = np.sqrt(np.mean(np.square(off)))
            print(
                f"{rays:8,} rays, {n_pairs} pairs, {truth.size} materials: {error:.3f}", flush=True
            )


if __name__ == "__main__":
    main()
