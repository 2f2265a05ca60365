"""Random boxes simulated with pressures: errors, and how often 95 % intervals hold the truth.

    python benchmarks/boxes.py [--first SEED] [--rooms N]

Boxes of 4.5-9 x 3.6-7 x 2.4-3.8 m with six materials from 0.01 to 0.97, eight pairs, positions 1 cm
wrong, noise 60 dB below the peak, six octaves. The data are made by image sources that add as
pressures, which shares nothing with the fitted model. The null model gives all walls of a room the
one absorption that explains it best.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from roomfit.base.errors import InsufficientDataError
from roomfit.demo.boxes import write_measured_box
from roomfit.files.inputs import load_campaign
from roomfit.identify import identify
from roomfit.result import Result
from simulated_rooms.random_boxes import random_plan

BANDS = slice(1, 7)  # of the simulated octaves 63 to 8000 Hz, those that are fitted


def identified(seed: int) -> tuple[Result, np.ndarray]:
    """Return the answer of one simulated room and the truth, (n_materials, n_bands)."""
    rng = np.random.default_rng(seed)
    plan = random_plan(rng)
    with tempfile.TemporaryDirectory() as folder:
        answer = identify(**load_campaign(write_measured_box(plan, Path(folder), rng)))
    return answer, plan.absorption[:, BANDS]


def line(name: str, answers: list[tuple[Result, np.ndarray]]) -> str:
    """Return one row of the table."""
    truth = np.array([t for _, t in answers])
    error = np.abs(np.array([a.absorption for a, _ in answers]) - truth)
    null = np.abs(np.array([a.mean_absorption[0] for a, _ in answers])[:, None, :] - truth)
    low = np.array([a.lower95 for a, _ in answers])
    high = np.array([a.upper95 for a, _ in answers])
    held = (low <= truth) & (truth <= high)
    sure = np.array([a.identifiable for a, _ in answers])
    bands = " ".join(f"{100 * h:4.0f}" for h in held.mean(axis=(0, 1)))
    return (
        f"{name:>6} {np.median(error):7.3f} {np.quantile(error, 0.9):6.3f} {np.median(null):7.3f}"
        f" {100 * held.mean():6.0f} {np.median(high - low):7.2f} {sure.sum():6d}"
        f" {(sure & ~held).sum():8d}    {bands}"
    )


def main() -> None:
    """Run the rooms one after the other and print the pooled line last."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=200)
    parser.add_argument("--rooms", type=int, default=6)
    asked = parser.parse_args()
    print("  seed  median   90 %    null held %   width   sure of those    held % by octave")
    print("         error  error  median         median            wrong")
    answers = []
    for seed in range(asked.first, asked.first + asked.rooms):
        try:
            answers.append(identified(seed))
        except InsufficientDataError as refusal:
            print(f"{seed:>6} refused: {refusal.what}, {refusal.where}")
            continue
        print(line(str(seed), answers[-1:]), flush=True)
    if answers:
        print(line("all", answers))


if __name__ == "__main__":
    main()
