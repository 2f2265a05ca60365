"""Where to measure: what a design promises in the paper's room, and what comes true.

    python benchmarks/design.py [--candidates 200] [--choose 6] [--criteria mean determinant]
        [--random 3] [--noises 1] [--position-error 0.01] [--loudspeaker-db 3]
        [--promise] [--pictures DIR]

The paper's room with its seven surfaces apart; nothing is known of them beforehand. First what is
promised: the mean width of the 95 % intervals after the chosen pairs of source and receiver, beside
200 random designs from the same candidates under the same rules. Then what is: responses of the
chosen pairs, and of some random designs, are simulated as pressures that are followed from cell to
cell (`simulated_rooms.polyhedra`), with the absorption of `roomfit.paper.room`, positions off
by --position-error, a loudspeaker that is uneven by --loudspeaker-db from octave to octave, and
noise; and identified as anybody's. Each design is measured --noises times, with other errors of
positions, levels and noise. --promise leaves the second part out; --pictures draws the first
design.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import get_args

import numpy as np

from roomfit.design.campaign import design_arguments
from roomfit.design.candidates import compatible_positions
from roomfit.design.choose import Criterion, Rules, random_design
from roomfit.design.output import mean_widths
from roomfit.design.positions import Design, design
from roomfit.files.campaign import Campaign, read_campaign
from roomfit.files.inputs import load_campaign
from roomfit.identify import identify
from roomfit.paper.room import DIVISIONS, PLANES
from roomfit.report.figures import png
from roomfit.report.prediction_figures import design_gain, design_map
from simulated_rooms.measured_polyhedron import PolyhedronPlan, write_measured_polyhedron
from simulated_rooms.polyhedral_rooms import obj_text, paper_cells

DURATION_S = 0.325
N_OCTAVES = 8


def empty_campaign(folder: Path) -> Campaign:
    """Write the paper's room and a campaign without any measurement, and read it."""
    (folder / "room.obj").write_text(obj_text(paper_cells()))
    lines = ["[room]", 'file = "room.obj"', 'unit = "m"', 'up = "z"']
    lines += [f'[materials."{name}"]\nscattering = 0.0' for name in PLANES]
    lines += ["[design]", "position_sd = 0.01"]
    (folder / "campaign.toml").write_text("\n".join(lines) + "\n")
    return read_campaign(folder / "campaign.toml", to_fit=False)


def some_random(found: Design, n: int, rng: np.random.Generator) -> list[tuple[int, ...]]:
    """Return random designs of as many pairs, under the same rules."""
    receivers = np.array([r.position_m for r in found.scene.receivers])[found.scene.pairs[:, 1]]
    rules = Rules(
        found.scene.pairs[:, 0],
        compatible_positions(receivers, found.receiver_distance_m),
        np.ones(len(receivers), dtype=bool),
    )
    return [random_design(rules, len(found.chosen), rng) for _ in range(n)]


def measured(
    found: Design,
    pairs: tuple[int, ...],
    seed: int,
    position_error_m: float,
    loudspeaker_db: float = 3.0,
) -> tuple[float, ...]:
    """Return mean width, mean and median error, coverage, phi and seconds of one campaign."""
    scene = found.scene
    ends = [(scene.sources[s], scene.receivers[r]) for s, r in scene.pairs[list(pairs)]]
    absorption = np.tile(np.array(DIVISIONS[7].true_absorption)[:, None], (1, N_OCTAVES))
    plan = PolyhedronPlan(
        paper_cells(),
        absorption,
        {s.name: tuple(s.position_m.tolist()) for s, _ in ends},
        {r.name: tuple(r.position_m.tolist()) for _, r in ends},
        DURATION_S,
        tuple((s.name, r.name) for s, r in ends),
    )
    with tempfile.TemporaryDirectory() as folder:
        synthetic = write_measured_polyhedron(
            plan,
            Path(folder),
            np.random.default_rng([seed, 11]),
            position_error_m=position_error_m,
            loudspeaker_db=loudspeaker_db,
        )
        answer = identify(**load_campaign(synthetic.campaign))
    rows = [synthetic.materials.index(name) for name in answer.materials]
    true = synthetic.absorption[rows][:, : len(answer.bands)]
    error = np.abs(answer.absorption - true)
    width = answer.upper95 - answer.lower95
    covered = (answer.lower95 <= true) & (true <= answer.upper95)
    return (
        float(width.mean()), float(error.mean()), float(np.median(error)), float(covered.mean()),
        float(answer.chi2_reduced.mean()), answer.seconds,
    )  # fmt: skip


def show(name: str, rows: list[tuple[float, ...]]) -> np.ndarray:
    """Print the mean over repetitions, and return it."""
    mean = np.asarray(np.mean(rows, axis=0))
    print(
        f"  {name:<16} width {mean[0]:.3f}  |error| mean {mean[1]:.4f} median {mean[2]:.4f}"
        f"  intervals hold {mean[3]:.2f}  phi {mean[4]:.2f}  {mean[5]:.0f} s a fit",
        flush=True,
    )
    return mean


def main() -> None:
    """Print promises, then what comes true."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--candidates", type=int, default=200)
    parser.add_argument("--choose", type=int, default=6)
    parser.add_argument("--criteria", nargs="+", default=["mean"], choices=get_args(Criterion))
    parser.add_argument("--random", type=int, default=3)
    parser.add_argument("--noises", type=int, default=1)
    parser.add_argument("--position-error", type=float, default=0.01)
    parser.add_argument("--loudspeaker-db", type=float, default=3.0)
    parser.add_argument("--promise", action="store_true")
    parser.add_argument("--pictures", type=Path)
    arguments = parser.parse_args()
    if arguments.pictures is not None:
        arguments.pictures.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        campaign = empty_campaign(Path(folder))
        designs = {}
        for criterion in arguments.criteria:
            used = time.process_time()
            options = {
                "n_candidates": arguments.candidates,
                "number": arguments.choose,
                "criterion": criterion,
            }
            found = design(**design_arguments(campaign, changed=options))
            designs[criterion] = found
            chosen, middle = mean_widths(found)[-1], np.median(found.random_means[:, -1])
            print(
                f"promised, {criterion}: {chosen:.3f}, random designs {middle:.3f} (median), "
                f"ratio {middle / chosen:.2f}; {found.seconds:.0f} s, of one processor "
                f"{time.process_time() - used:.0f} s",
                flush=True,
            )
        if arguments.pictures is not None:
            first = next(iter(designs.values()))
            (arguments.pictures / "design_map.png").write_bytes(png(design_map(first)))
            (arguments.pictures / "design_gain.png").write_bytes(png(design_gain(first)))
        if arguments.promise:
            return
        print("measured")
        uneven = (arguments.position_error, arguments.loudspeaker_db)
        best = {
            name: show(name, [
                measured(d, tuple(d.chosen.tolist()), seed, *uneven)
                for seed in range(arguments.noises)
            ])
            for name, d in designs.items()
        }  # fmt: skip
        first = next(iter(designs.values()))
        drawn = some_random(first, arguments.random, np.random.default_rng(5))
        rows = [
            show(f"random {i + 1}", [
                measured(first, pairs, seed, *uneven) for seed in range(arguments.noises)
            ])
            for i, pairs in enumerate(drawn)
        ]  # fmt: skip
        if rows:
            middle_row = np.median(rows, axis=0)
            for name, mean in best.items():
                print(
                    f"ratio, median of random over {name}: width {middle_row[0] / mean[0]:.2f}, "
                    f"mean |error| {middle_row[1] / mean[1]:.2f}"
                )


if __name__ == "__main__":
    main()
