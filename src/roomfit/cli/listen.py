"""``roomfit listen``: measured responses as they would be after a change."""

from __future__ import annotations

import argparse
from pathlib import Path

from roomfit.cli.arguments import Commands, add_command, result_file
from roomfit.cli.terminal import say
from roomfit.report.progress import shown_progress


def add(commands: Commands) -> None:
    about = (
        "Make the measured responses what they would be after a change of materials, as WAV files."
        "\n\nEvery band is scaled over time by the ratio of the predicted energies after to before."
    )
    parser = add_command(commands, "listen", about, run)
    parser.add_argument("campaign", type=Path, help="Campaign file (TOML) of the measured room.")
    parser.add_fit()
    parser.add_out()
    parser.add_option(
        "--set",
        "The change, as of roomfit predict. May be given several times.",
        dest="changes",
        metavar="CHANGE",
        action="append",
    )
    parser.add_state()
    parser.add_option(
        "--dry", "A WAV file of one channel, at the responses' rate, to convolve.", type=Path
    )
    parser.add_doubted()
    parser.add_overwrite()


def run(options: argparse.Namespace) -> None:
    from roomfit.cli.predictions import listen_to_folder
    from roomfit.predict.campaign import WantedPairs
    from roomfit.predict.changes import read_change
    from roomfit.predict.output import listen_text

    with shown_progress("listening") as progress:
        content = listen_to_folder(
            options.campaign,
            result_file(options, options.absorption),
            options.out,
            [read_change(text) for text in options.changes or []],
            dry=options.dry,
            wanted=WantedPairs(state=options.state or "", doubted=options.doubted),
            overwrite=options.overwrite,
            progress=progress,
        )
    say(listen_text(content))
    say(f"\nWAV files and listen.json are in {options.out}")
