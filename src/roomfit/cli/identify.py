"""``roomfit identify``: the absorption of a measured room."""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from roomfit.cli.arguments import Commands, add_command, number_range
from roomfit.cli.check import how_to_write
from roomfit.cli.terminal import say
from roomfit.report.progress import shown_progress

if TYPE_CHECKING:
    from roomfit.files.remedies import Advice
    from roomfit.result import Result


def add(commands: Commands) -> None:
    about = "Find the absorption of a measured room, per material and band, with intervals."
    parser = add_command(commands, "identify", about, run)
    parser.add_argument("campaign", type=Path, help="Campaign file (TOML).")
    parser.add_out()
    parser.add_option(
        "--bands",
        "Bands to fit, as 500-2000, in place of from_hz and to_hz of the campaign.",
        type=number_range,
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="A first answer: no search for faults of files, positions and chain, no pictures.",
    )
    parser.add_threads()
    parser.add_overwrite()


def run(options: argparse.Namespace) -> None:
    from roomfit.cli.commands import identify_to_folder
    from roomfit.report.text import answer_text

    with ExitStack() as line:

        def show(answer: Result, advised: Advice) -> None:
            line.close()  # that of the progress
            # a reader who has gone, or a full disk, is met again at the end, with all files written
            with suppress(OSError):
                say(answer_text(answer, advised))
                if advised:
                    say(how_to_write(options.campaign, options.out))
                sys.stdout.flush()

        identify_to_folder(
            options.campaign,
            options.out,
            between_hz=options.bands,
            quick=options.quick,
            overwrite=options.overwrite,
            progress=line.enter_context(shown_progress("identifying")),
            answered=show,
        )
    files = "absorption.csv" if options.quick else "absorption.csv and pictures"
    say(f"\nreport.html, result.json, {files} are in {options.out}")
