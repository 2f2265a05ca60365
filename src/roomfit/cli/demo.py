"""``roomfit demo``: the identification of a room whose absorption is known."""

from __future__ import annotations

import argparse
from pathlib import Path

from roomfit.cli.arguments import Commands, add_command, whole_number
from roomfit.cli.terminal import say
from roomfit.report.progress import shown_progress


def add(commands: Commands) -> None:
    about = "Simulate a measured room independently of the fit's own model, and identify it."
    parser = add_command(commands, "demo", about, run)
    parser.add_option(
        "--out", "Folder for the campaign and its results.", type=Path, default=Path("roomfit-demo")
    )
    parser.add_option(
        "--seed", "Of the positions, levels and noise drawn.", type=whole_number, default=1
    )
    parser.add_overwrite()


def run(options: argparse.Namespace) -> None:
    from roomfit.commands import demo_text, run_demo

    out: Path = options.out
    with shown_progress("simulating and identifying") as progress:
        answer, true_absorption = run_demo(
            out, options.seed, overwrite=options.overwrite, progress=progress
        )
    say(demo_text(answer, true_absorption))
    say(f"\nThe campaign is in {out / 'campaign'}, result and pictures in {out / 'result'}.")
