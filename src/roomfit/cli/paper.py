"""``roomfit paper``: the results of Suh (2001) in its reconstructed room."""

from __future__ import annotations

import argparse

from roomfit.cli.terminal import say
from roomfit.paper.output import paper_text, run_paper
from roomfit.report.progress import shown_progress


def run(options: argparse.Namespace) -> None:
    with shown_progress("repeating the paper") as progress:
        result = run_paper(
            options.out, seeds=options.seeds, overwrite=options.overwrite, progress=progress
        )
    say(paper_text(result))
    say(f"\npaper.json, table2.csv and pictures are in {options.out}.")
