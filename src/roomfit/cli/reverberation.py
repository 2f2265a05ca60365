"""``roomfit reverberation``: mean absorption from decay times alone."""

from __future__ import annotations

import argparse
from pathlib import Path

from roomfit.cli.arguments import Commands, add_command
from roomfit.cli.terminal import say


def add(commands: Commands) -> None:
    about = (
        "Find the mean absorption of a room from decay times, where no position is known.\n\n"
        "By Sabine, Eyring, Arau-Puchades and Fitzroy, with intervals, and split over materials by "
        "their priors."
    )
    parser = add_command(commands, "reverberation", about, run)
    parser.add_argument("campaign", type=Path, help="Campaign file (TOML) with [reverberation].")
    parser.add_option("--out", "Folder for a page and a table; made if needed.", type=Path)
    parser.add_overwrite()


def run(options: argparse.Namespace) -> None:
    from roomfit.cli.predictions import reverberation_to_folder
    from roomfit.report.text import diffuse_text

    found = reverberation_to_folder(options.campaign, options.out, overwrite=options.overwrite)
    say(diffuse_text(found))
    if options.out is not None:
        say(f"\nreverberation.html, reverberation.csv and result.json are in {options.out}")
