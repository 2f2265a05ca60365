"""``roomfit predict``: what would be measured."""

from __future__ import annotations

import argparse
from pathlib import Path

from roomfit.cli.arguments import Commands, add_command, number, result_file
from roomfit.cli.terminal import say
from roomfit.report.progress import shown_progress


def add(commands: Commands) -> None:
    about = "Predict reverberation and clarity with their intervals, as the room is or changed."
    parser = add_command(commands, "predict", about, run)
    parser.add_argument("campaign", type=Path, help="Campaign file (TOML) of the room to predict.")
    parser.add_fit(required=False)
    parser.add_out()
    parser.add_option(
        "--set",
        "What if: MATERIAL=0.3, 0.3+-0.05, one value per band, x1.5+-0.2, another material of the "
        "room, or a name of the catalogue. May be given several times.",
        dest="changes",
        metavar="CHANGE",
        action="append",
    )
    parser.add_pairs()
    parser.add_state()
    parser.add_option(
        "--grid",
        "Maps over the room in place of its receivers: HEIGHT,SPACING in m, as 1.2,0.5.",
        metavar="H,S",
        type=_grid,
    )
    parser.add_doubted()
    parser.add_threads()
    parser.add_overwrite()


def _grid(text: str) -> tuple[float, float]:
    height, _, spacing = text.partition(",")
    return number(height), number(spacing)


def run(options: argparse.Namespace) -> None:
    from roomfit.cli.predictions import predict_to_folder
    from roomfit.predict.campaign import WantedPairs, pair_choice
    from roomfit.predict.changes import read_change

    changes = [read_change(text) for text in options.changes or []]
    wanted = WantedPairs(
        pair_choice(options.pairs), options.state or "", options.grid, options.doubted
    )
    with shown_progress("predicting") as progress:
        predicted = predict_to_folder(
            options.campaign,
            options.absorption and result_file(options, options.absorption),
            options.out,
            changes,
            wanted=wanted,
            overwrite=options.overwrite,
            progress=progress,
        )
    say(str(predicted))
    files = "predicted.json, predicted.csv, predicted.html" + ", grid.csv" * bool(options.grid)
    say(f"\n{files} and pictures are in {options.out}")
