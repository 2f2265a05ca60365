"""``roomfit treat``: what to hang where."""

from __future__ import annotations

import argparse
from pathlib import Path

from roomfit.cli.arguments import Commands, add_command
from roomfit.cli.terminal import progress_line, say


def add(commands: Commands) -> None:
    about = "Choose what to hang where, so that targets are met, and how likely they then are."
    parser = add_command(commands, "treat", about, run)
    parser.add_argument("campaign", type=Path, help="Campaign file (TOML) of the room.")
    parser.add_argument("treatment", type=Path, help="Surfaces, products and targets (TOML).")
    parser.add_option(
        "--absorption", "result.json or absorption.csv of a fit.", type=Path, required=True
    )
    parser.add_out()
    parser.add_option(
        "--pairs",
        "all: every source with every receiver; campaign: the measured ones.",
        default="all",
    )
    parser.add_option(
        "--state", "State of the room among the campaign's [[states]]; left out: as described."
    )
    parser.add_overwrite()


def run(options: argparse.Namespace) -> None:
    from roomfit.commands import treat_to_folder
    from roomfit.prediction.campaign import WantedPairs, pair_choice

    wanted = WantedPairs(pair_choice(options.pairs), options.state or "")
    with progress_line("choosing what to hang") as progress:
        answer = treat_to_folder(
            options.campaign,
            options.absorption,
            options.treatment,
            options.out,
            wanted=wanted,
            overwrite=options.overwrite,
            progress=progress,
        )
    say(str(answer))
    say(f"\ntreatment.json, treatment.csv and a picture are in {options.out}")
