"""``roomfit impedance``: complex impedances of walls."""

from __future__ import annotations

import argparse
from pathlib import Path

from roomfit.cli.arguments import Commands, add_command
from roomfit.cli.terminal import say
from roomfit.report.progress import shown_progress


def add(commands: Commands) -> None:
    about = "Find the acoustic impedance of a measured room's walls over frequency, with intervals."
    parser = add_command(commands, "impedance", about, run)
    parser.add_argument("campaign", type=Path, help="Campaign file (TOML).")
    parser.add_out()
    parser.add_overwrite()


def run(options: argparse.Namespace) -> None:
    from roomfit.impedance.campaign import impedance_to_folder

    with shown_progress("identifying impedances") as progress:
        result = impedance_to_folder(
            options.campaign, options.out, overwrite=options.overwrite, progress=progress
        )
    say(str(result))
    say(f"\nresult.json, impedance.csv and pictures are in {options.out}")
