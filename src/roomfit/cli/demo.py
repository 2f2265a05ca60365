"""``roomfit demo``: the identification of a room whose absorption is known."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from roomfit.cli.arguments import Commands, add_command, whole_number
from roomfit.cli.terminal import say
from roomfit.report.progress import shown_progress

if TYPE_CHECKING:
    from roomfit.base.typing import BoolArray, FloatArray
    from roomfit.result import Result


def add(commands: Commands) -> None:
    about = "Simulate a measured room independently of the fit's own model, and identify it."
    parser = add_command(commands, "demo", about, run)
    parser.add_option(
        "--out", "Folder for the campaign and its results.", type=Path, default=Path("roomfit-demo")
    )
    parser.add_option(
        "--seed", "Of the positions, levels and noise drawn.", type=whole_number, default=1
    )
    parser.add_threads()
    parser.add_overwrite()


def run(options: argparse.Namespace) -> None:
    from roomfit.cli.commands import run_demo
    from roomfit.report.text import findings_text

    out: Path = options.out
    with shown_progress("simulating and identifying") as progress:
        answer, true_absorption = run_demo(
            out, options.seed, overwrite=options.overwrite, progress=progress
        )
    covered = (answer.lower95 <= true_absorption) & (true_absorption <= answer.upper95)
    say(_table(answer, true_absorption, covered))
    say(f"\n{_summary(answer, true_absorption, covered)}")
    if answer.findings:
        say(f"\n{findings_text(answer.findings)}")
    say(f"\nThe campaign is in {out / 'campaign'}, result and pictures in {out / 'result'}.")


def _table(answer: Result, true_absorption: FloatArray, covered: BoolArray) -> str:
    width = max(len(n) for n in answer.materials)
    cell = f"{'true':>5} {'found':>5} {'95 %':>9} "
    lines = [
        "Absorption: true, found and its 95 % interval; ! = the true value lies outside, "
        "? = not identifiable",
        f"{'Hz':<{width}}  " + " ".join(f"{f:^22g}" for f in answer.bands.centres_hz),
        f"{'':<{width}}  " + " ".join(f"{cell:<22}" for _ in answer.bands.centres_hz),
    ]
    for i, name in enumerate(answer.materials):
        cells = []
        for j in range(len(answer.bands)):
            mark = ("" if covered[i, j] else "!") + ("" if answer.identifiable[i, j] else "?")
            bounds = f"{answer.lower95[i, j]:.2f}-{answer.upper95[i, j]:.2f}"
            text = f"{true_absorption[i, j]:5.2f} {answer.absorption[i, j]:5.2f} {bounds}{mark}"
            cells.append(f"{text:<22}")
        lines.append(f"{name:<{width}}  " + " ".join(cells).rstrip())
    return "\n".join(lines)


def _summary(answer: Result, true_absorption: FloatArray, covered: BoolArray) -> str:
    import numpy as np

    error = np.abs(answer.absorption - true_absorption)
    uniform = np.abs(answer.mean_absorption[0] - true_absorption)
    sure = answer.identifiable
    lines = [
        f"median error {np.median(error):.3f}, 90 % of errors below {np.quantile(error, 0.9):.3f}, "
        f"largest {error.max():.3f}",
        f"baseline, one absorption for all walls: median error {np.median(uniform):.3f}",
        f"coverage: the interval contains the truth in {covered.sum()} of {covered.size} cases "
        f"({100 * covered.mean():.0f} %)",
        f"called identifiable: {sure.sum()} of {sure.size}, of which {(sure & ~covered).sum()} "
        "outside their interval",
        f"{answer.seconds:.1f} s for the identification",
    ]
    return "\n".join(lines)
