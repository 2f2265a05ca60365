"""``roomfit paper``: every result of Suh (2001), and what it left open."""

from __future__ import annotations

import argparse

from roomfit.cli.arguments import Commands, add_command, positive_number
from roomfit.cli.terminal import say
from roomfit.report.progress import shown_progress


def add(commands: Commands) -> None:
    about = (
        "Repeat the paper in its reconstructed room, and examine what other rays would have given."
    )
    parser = add_command(commands, "paper", about, run)
    parser.add_out("Folder for paper.json, tables, pictures.")
    searches = "Searches of every problem by every method; of other rays as many sets, 8 at most."
    parser.add_option("--seeds", searches, type=positive_number, default=50)
    parser.add_option("--workers", "Processes.", type=positive_number, default=2)
    parser.add_overwrite()


def run(options: argparse.Namespace) -> None:
    from roomfit.paper.output import paper_text, run_paper

    with shown_progress("repeating the paper") as progress:
        result = run_paper(
            options.out,
            seeds=options.seeds,
            workers=options.workers,
            overwrite=options.overwrite,
            progress=progress,
        )
    say(paper_text(result))
    say(f"\npaper.json, tables and pictures are in {options.out}.")
