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


def run(options: argparse.Namespace) -> None:
    from roomfit.inversion.diffuse import diffuse_absorption
    from roomfit.io.reverberation import reverberation_arguments
    from roomfit.report.text import diffuse_text

    say(diffuse_text(diffuse_absorption(**reverberation_arguments(options.campaign))))
