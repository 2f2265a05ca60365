"""``roomfit design``: where to measure."""

from __future__ import annotations

import argparse
from pathlib import Path

from roomfit.base.door import files_read, reading_noted
from roomfit.base.errors import located
from roomfit.base.typing import part
from roomfit.base.whole_files import check_output_folder, sole_writer, whole_output_folder
from roomfit.cli.arguments import result_file
from roomfit.cli.terminal import say
from roomfit.design.campaign import design_arguments
from roomfit.design.output import write_design
from roomfit.design.positions import design
from roomfit.files.campaign import read_campaign
from roomfit.files.results import read_result
from roomfit.report.designed import describe
from roomfit.report.figures import write_pictures
from roomfit.report.progress import shown_progress
from roomfit.report.text import text


def run(options: argparse.Namespace) -> None:
    design_to_folder(options, options.out)


@sole_writer
@reading_noted()
def design_to_folder(options: argparse.Namespace, out: Path) -> None:
    """Choose where to measure; write design.json, .csv and pictures into a folder."""
    check_output_folder(out, overwrite=options.overwrite)
    campaign = read_campaign(options.campaign, to_fit=False)
    found = options.result and read_result(result_file(options, options.result))
    wanted = {
        "n_candidates": options.candidates,
        "number": options.choose,
        "most_sources": options.sources,
        "criterion": options.criterion,
    }
    given = {name: value for name, value in wanted.items() if value is not None}
    arguments = design_arguments(campaign, found, given)
    with shown_progress("choosing where to measure") as progress:
        with located(str(options.campaign)):
            answer = design(**arguments, progress=part(progress, 0.0, 0.98))
        shown = describe(answer)
        with whole_output_folder(out, overwrite=options.overwrite) as folder:
            write_design(folder, answer, files_read())
            write_pictures(folder, shown, png_too=options.png)
    say(f"{text(shown)}\n\ndesign.json, design.csv and pictures are in {out}")
