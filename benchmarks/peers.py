"""roomfit beside another open program that fits walls, acoustic-spaces 4, on the same rooms.

    python benchmarks/peers.py PROGRAM [--seeds 1 2] [--parameters edt c80 d50 ts] [--data FOLDER]

PROGRAM is the path of its command, from `pip install acoustic-spaces` in an environment of its own.
It is GPL-3, is run as it stands, and no part of roomfit.

Boxes: those of `other_boxes.py`, six materials, eight responses. Both programs get the same
recordings, positions (1 cm off), air, and walls that do not scatter. Else both run as they come:
roomfit by its campaign, the other one from .15 of every wall, with the T30, EDT and C80 that it
takes from the recordings; --parameters names others. Noise lies 45 to 60 dB below the peak, which
hides the range of a T30 from it: --noise-db sets another level. Its intervals are 1.96 of its
standard errors, within 0 to 1. Processor seconds are those of its command with its start, and of
roomfit's `identify` with the reading of files.

--data FOLDER holds `ptb_studio` (see `room_values.py`): each pair left out in turn, its T30, EDT
and C80 predicted by both from the measured values of the others. --pairs says of how many, evenly
among the six. The other program's diffraction is switched off there: for the studio's many edges it
asks for more than 20 GB.

--rays sets the other program's late rays (its default: 50,000).
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from _other_box import write_other_box
from _peer import (
    FITTED,
    SEED,
    PeerFit,
    found_program,
    read_fit,
    read_predicted,
    run_peer,
    write_scene,
    write_values,
)
from other_boxes import Outcome, one_for_all, outcome
from room_values import BANDS, Case, left_out_errors, studio, traced
from roomfit.base.errors import InputError
from roomfit.files.inputs import load_campaign


@dataclass(frozen=True, eq=False)
class Both:
    """One box: the answer of either program."""

    ours: Outcome
    theirs: PeerFit
    their_cpu_s: float


def box_by_both(program: str, seed: int, more: list[str], noise_db: float | None) -> Both:
    """Simulate a box and have both identify it from the same files; `more`: the other's options."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        box = write_other_box(seed, folder, noise_db=noise_db)
        scene = load_campaign(box.campaign)["scene"]
        n_materials = len(scene.room.materials)
        fit = folder / "fit.json"
        command = ["calibrate", str(write_scene(scene, np.zeros(n_materials), folder))]
        for s, r in scene.pairs.tolist():
            source, receiver = scene.sources[s].name, scene.receivers[r].name
            command += ["--measured", source, receiver, str(folder / f"{source}_{receiver}.wav")]
        command += ["--threads", "1", "--seed", SEED, "--json", str(fit)]
        cpu_s = run_peer(program, command + more)
        ours = outcome(box, False, "")
        return Both(ours, read_fit(fit, n_materials, ours.answer.bands.centres_hz), cpu_s)


def show_boxes(done: list[Both]) -> None:
    """Print both programs and the baseline over all boxes."""
    true = np.concatenate([b.ours.true for b in done])
    answers = [b.ours.answer for b in done]
    rows = {
        "roomfit": (
            [(a.absorption, a.lower95, a.upper95) for a in answers],
            [b.ours.cpu_seconds for b in done],
        ),
        "acoustic-spaces": (
            [(b.theirs.absorption, *b.theirs.bounds) for b in done],
            [b.their_cpu_s for b in done],
        ),
    }
    print(f"{'':22}|error| median   90 %  coverage  median width  CPU s a room")
    for label, (each, cpu_s) in rows.items():
        found, low, high = np.concatenate([np.array(one) for one in each], axis=1)
        error, held = np.abs(found - true), (low <= true) & (true <= high)
        print(
            f"{label:22}{np.median(error):14.3f}{np.quantile(error, 0.9):7.3f}{held.mean():10.2f}"
            f"{np.median(high - low):14.3f}{np.mean(cpu_s):14.1f}"
        )
    null = np.abs(np.concatenate([one_for_all(b.ours) for b in done]) - true)
    print(f"{'one for all walls':22}{np.median(null):14.3f}{np.quantile(null, 0.9):7.3f}")


def studio_errors(
    program: str, case: Case, left_out: int, more: list[str]
) -> tuple[np.ndarray, float]:
    """Return the other program's errors for one pair, (3, n_bands), and its processor seconds.

    Of times relative, of C80 in dB, as `left_out_errors` has them. `more`: of both commands.
    """
    pair = case.values[left_out]
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        scene = write_scene(case.scene, case.scattering, folder, diffraction=False)
        values = folder / "values.json"
        write_values([v for v in case.values if v is not pair], values)
        fitted, shared = str(folder / "fitted.yaml"), ["--threads", "1", "--seed", SEED, *more]
        fit = ["calibrate", str(scene), "--measured-json", str(values), "-o", fitted]
        seconds = run_peer(program, fit + shared)
        seconds += run_peer(program, ["simulate", fitted, "--out", str(folder / "out"), *shared])
        answer = folder / "out" / "parameters.json"
        found = read_predicted(answer, pair.source, pair.receiver, BANDS.centres_hz)
    measured = np.array([pair.at(name, BANDS.centres_hz) for name in FITTED])
    unit = measured.copy()
    unit[[not name.endswith("_s") for name in FITTED]] = 1.0
    return np.abs(found - measured) / unit, seconds


def show_studio(program: str, folder: Path, n_pairs: int, more: list[str]) -> None:
    """Print the errors of pairs left out: of both programs, and of the mean of the others."""
    case = studio(folder)
    chosen = np.linspace(0, len(case.values) - 1, n_pairs).round().astype(int).tolist()
    theirs, seconds = zip(*(studio_errors(program, case, i, more) for i in chosen), strict=True)
    ours = left_out_errors(case, traced(case))
    print(f"{case.name}: mean |error| of {len(chosen)} pairs left out, one at a time")
    print(f"{'':12}roomfit  acoustic-spaces  mean of the others")
    for row, name in enumerate(FITTED):
        scale, unit = (100.0, "%") if name.endswith("_s") else (1.0, "dB")
        cells = [
            scale * float(np.nanmean(x[:, case.judged]))
            for x in (ours[name][0][chosen], np.array(theirs)[:, row], ours[name][1][chosen])
        ]
        label = f"{name.split('_')[0]} ({unit})"
        print(f"{label:12}{cells[0]:7.2f}{cells[1]:17.2f}{cells[2]:20.2f}")
    print(f"acoustic-spaces: {np.mean(seconds):.0f} CPU s a pair left out")


def main() -> int:
    """Run the rooms, print the tables, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("program", help="path of the command acoustic-spaces")
    parser.add_argument("--seeds", type=int, nargs="*", default=[1, 2])
    parser.add_argument("--parameters", nargs="+", default=[], help="what the other program fits")
    parser.add_argument("--noise-db", type=float, help="of all recordings, relative to their peak")
    parser.add_argument("--data", type=Path, help="folder of measured rooms")
    parser.add_argument("--pairs", type=int, default=6, help="of the studio, left out in turn")
    parser.add_argument("--rays", type=int, help="of the other program")
    asked = parser.parse_args()
    rays = ["--rays", str(asked.rays)] if asked.rays else []
    more = rays + (["--parameters", *asked.parameters] if asked.parameters else [])
    done = []
    try:
        found_program(asked.program)
        for seed in asked.seeds:
            done.append(box_by_both(asked.program, seed, more, asked.noise_db))
            print(f"seed {seed}: {done[-1].their_cpu_s:.0f} CPU s of the other program", flush=True)
        if done:
            show_boxes(done)
        if asked.data is not None:
            show_studio(asked.program, asked.data / "ptb_studio", asked.pairs, rays)
    except InputError as refusal:
        print(refusal, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
