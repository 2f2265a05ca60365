"""``roomfit impedance``: complex impedances of walls."""

from __future__ import annotations

import argparse

from roomfit.cli.terminal import say
from roomfit.impedance.campaign import impedance_to_folder
from roomfit.report.progress import shown_progress


def run(options: argparse.Namespace) -> None:
    with shown_progress("identifying impedances") as progress:
        result = impedance_to_folder(
            options.campaign, options.out, overwrite=options.overwrite, progress=progress
        )
    say(str(result))
    say(f"\nresult.json, impedance.csv and pictures are in {options.out}")
