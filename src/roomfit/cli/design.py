"""``roomfit design``: where to measure."""

from __future__ import annotations

import argparse
from pathlib import Path

from roomfit.cli.arguments import Commands, add_command, result_file, whole_number
from roomfit.cli.terminal import say
from roomfit.report.progress import shown_progress


def add(commands: Commands) -> None:
    about = "Choose where to measure, so that absorption is found with the narrowest intervals."
    parser = add_command(commands, "design", about, run)
    parser.add_argument(
        "campaign", type=Path, help="Campaign file (TOML); it need not have a measurement."
    )
    parser.add_out()
    parser.add_option(
        "--candidates",
        "Pairs of source and receiver to choose from.",
        type=whole_number,
        default=200,
    )
    parser.add_option("--choose", "How many (default: 6, or 1 after a fit).", type=whole_number)
    parser.add_option("--sources", "How many different sources at most.", type=whole_number)
    parser.add_option("--criterion", "What is to become small: determinant, mean or worst.")
    parser.add_option("--result", "result.json of a fit: what to measure next.", type=Path)
    parser.add_threads()
    parser.add_edited()
    parser.add_overwrite()


def run(options: argparse.Namespace) -> None:
    from roomfit.cli.commands import design_to_folder

    wanted = {
        "n_candidates": options.candidates,
        "number": options.choose,
        "most_sources": options.sources,
        "criterion": options.criterion,
    }
    with shown_progress("choosing where to measure") as progress:
        design = design_to_folder(
            options.campaign,
            options.out,
            {name: value for name, value in wanted.items() if value is not None},
            result_file=options.result and result_file(options, options.result),
            overwrite=options.overwrite,
            progress=progress,
        )
    say(f"{design}\n\ndesign.json, design.csv and pictures are in {options.out}")
