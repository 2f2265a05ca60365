"""``roomfit paper``: every result of Suh (2001), and what it left open."""

from __future__ import annotations

import argparse

from roomfit.cli.terminal import say
from roomfit.paper.output import paper_text, run_paper
from roomfit.report.progress import shown_progress


def run(options: argparse.Namespace) -> None:
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
