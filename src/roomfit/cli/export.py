"""``roomfit export``: absorption for another program."""

from __future__ import annotations

import argparse
import textwrap
from pathlib import Path

from roomfit.cli.arguments import Commands, add_command, number, result_file
from roomfit.cli.terminal import say


def add(commands: Commands) -> None:
    about = "Write what was found as materials of another program, or the report as PDF or Word."
    parser = add_command(commands, "export", about, run)
    parser.add_argument("result", type=Path, help="result.json or absorption.csv of a fit.")
    parser.add_option(
        "--format",
        "catt, odeon, isimpa, pyroomacoustics, csv, excel, budget (of the uncertainty, CSV), or "
        "pdf or word (the report).",
        required=True,
    )
    parser.add_out("File to write.")
    parser.add_option(
        "--scattering", "For all materials, where the result does not specify it.", type=number
    )
    parser.add_edited()
    parser.add_overwrite("Replace what exists.")


def run(options: argparse.Namespace) -> None:
    from roomfit.cli.commands import export_result

    written = export_result(
        result_file(options, options.result),
        options.format,
        options.out,
        scattering=options.scattering,
        overwrite=options.overwrite,
    )
    for file in written.files:
        say(file)
    for finding in written.findings:
        text = f"  {finding.severity:<8} {finding.sentence}"
        say(textwrap.fill(text, 100, subsequent_indent=" " * 11, break_on_hyphens=False))
