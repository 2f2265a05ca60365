"""``roomfit treat``: what to hang where."""

from __future__ import annotations

import argparse
from pathlib import Path

from roomfit.cli.arguments import Commands, add_command, result_file
from roomfit.cli.terminal import say
from roomfit.report.progress import shown_progress


def add(commands: Commands) -> None:
    about = "Choose what to hang where, so that targets are met, and how likely they then are."
    parser = add_command(commands, "treat", about, run)
    parser.add_argument("campaign", type=Path, help="Campaign file (TOML) of the room.")
    parser.add_argument("treatment", type=Path, help="Surfaces, products and targets (TOML).")
    parser.add_fit(required=False)
    parser.add_out()
    parser.add_pairs()
    parser.add_state()
    parser.add_doubted()
    parser.add_threads()
    parser.add_overwrite()


def run(options: argparse.Namespace) -> None:
    from roomfit.cli.predictions import treat_to_folder
    from roomfit.predict.campaign import WantedPairs, pair_choice

    pairs = pair_choice(options.pairs)
    wanted = WantedPairs(pairs, options.state or "", doubted=options.doubted)
    with shown_progress("choosing what to hang") as progress:
        answer = treat_to_folder(
            options.campaign,
            options.absorption and result_file(options, options.absorption),
            options.treatment,
            options.out,
            wanted=wanted,
            overwrite=options.overwrite,
            progress=progress,
        )
    say(str(answer))
    say(f"\ntreatment.html, .json, .csv and a picture are in {options.out}")
