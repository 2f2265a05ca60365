"""``roomfit coverage``: how often the intervals of a campaign hold the true values."""

from __future__ import annotations

import argparse
from pathlib import Path

from roomfit.cli.arguments import Commands, add_command, number, result_file, whole_number
from roomfit.cli.terminal import say
from roomfit.report.progress import shown_progress


def add(commands: Commands) -> None:
    about = (
        "Simulate a campaign with known absorption many times, identify each, and count how many "
        "intervals hold the true value.\n\nAn interrupted run continues where it stopped. Slices "
        "of one folder may run on many machines."
    )
    parser = add_command(commands, "coverage", about, run)
    parser.add_argument("campaign", type=Path, help="Campaign file (TOML).")
    parser.add_out("Folder for replicates and their summary.")
    parser.add_option(
        "--replicates", "How often the campaign is simulated.", type=whole_number, default=200
    )
    parser.add_option(
        "--first",
        "First replicate of this run, from 0: for a cluster.",
        type=whole_number,
        default=0,
    )
    parser.add_option(
        "--only", "How many replicates this run simulates (default: all others).", type=whole_number
    )
    parser.add_option(
        "--from",
        "Distribution of the absorption: prior, or the result.json of a fit.",
        dest="source",
        default="prior",
    )
    parser.add_option(
        "--snr-db",
        "Loudest block over noise in every band (default: as in the measured files). "
        "With it no response is read, and none need exist.",
        type=number,
    )
    parser.add_edited()
    parser.add_option("--seed", "Of the draws.", type=whole_number, default=1)
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--workers", type=whole_number, default=1, help="Processes (default: 1).")
    where.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="Address of a running dask scheduler (needs the extra cluster), which must reach the "
        "output folder by the same path.",
    )


def run(options: argparse.Namespace) -> None:
    from roomfit.cli.commands import estimate_coverage_to_folder
    from roomfit.coverage.synthetic_room import CoverageSettings

    settings = CoverageSettings(
        replicates=options.replicates,
        first=options.first,
        only=options.only,
        result=None if options.source == "prior" else result_file(options, Path(options.source)),
        snr_db=options.snr_db,
        seed=options.seed,
        workers=options.workers,
        scheduler=options.scheduler,
    )
    with shown_progress("estimating coverage") as progress:
        result = estimate_coverage_to_folder(
            options.campaign, options.out, settings, progress=progress
        )
    say(str(result))
    say(f"\ncoverage.json, coverage.csv and coverage.png are in {options.out}")
