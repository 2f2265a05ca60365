"""``roomfit compare``: what changed between two results."""

from __future__ import annotations

import argparse

from roomfit.base.table import csv_of
from roomfit.base.whole_files import check_output_folder, whole_output_folder, write_text_atomically
from roomfit.cli.arguments import result_file
from roomfit.cli.terminal import say
from roomfit.files.results import read_result
from roomfit.report.comparison import compare_results, comparison_records


def run(options: argparse.Namespace) -> None:
    out = options.out
    if out is not None:
        check_output_folder(out, overwrite=options.overwrite)
    first, second = (
        read_result(result_file(options, path)) for path in (options.first, options.second)
    )
    compared = compare_results(first, second)
    if out is not None:
        with whole_output_folder(out, overwrite=options.overwrite) as folder:
            write_text_atomically(folder / "compared.csv", csv_of(comparison_records(compared)))
    say(str(compared))
    if out is not None:
        say(f"\ncompared.csv is in {out}")
