"""``roomfit compare``: what changed between two results."""

from __future__ import annotations

import argparse
from pathlib import Path

from roomfit.cli.arguments import Commands, add_command, result_file
from roomfit.cli.terminal import say


def add(commands: Commands) -> None:
    about = "Compare two results, as before and after a renovation: what changed, and how surely."
    parser = add_command(commands, "compare", about, run)
    parser.add_argument("first", type=Path, help="result.json or absorption.csv of a fit.")
    parser.add_argument("second", type=Path, help="That of another.")
    parser.add_option(
        "--out", "Folder for a table, a page and a picture; made if needed.", type=Path
    )
    parser.add_edited()
    parser.add_overwrite()


def run(options: argparse.Namespace) -> None:
    from roomfit.cli.commands import compare_to_folder

    compared = compare_to_folder(
        result_file(options, options.first),
        result_file(options, options.second),
        options.out,
        overwrite=options.overwrite,
    )
    say(str(compared))
    if options.out is not None:
        say(f"\ncompared.csv, compared.html and compared.png are in {options.out}")
