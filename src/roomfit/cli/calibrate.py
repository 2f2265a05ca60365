"""``roomfit calibrate``: whether the intervals of a campaign hold what they promise."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def calibrate(
    campaign: Annotated[Path, typer.Argument(help="Campaign file (TOML).")],
    out: Annotated[Path, typer.Option("--out", help="Folder for replicates and what they say.")],
    replicates: Annotated[
        int, typer.Option("--replicates", help="How often the campaign is made anew.")
    ] = 200,
    first: Annotated[
        int, typer.Option("--first", help="First replicate of this run, from 0: for a cluster.")
    ] = 0,
    only: Annotated[
        int | None, typer.Option("--only", help="How many this run makes; left out: all others.")
    ] = None,
    source: Annotated[
        str,
        typer.Option(
            "--from",
            help="What absorption is drawn from: prior, or the result.json of a fit.",
        ),
    ] = "prior",
    snr_db: Annotated[
        float | None,
        typer.Option(
            "--snr-db",
            help="Loudest block over noise in every band; left out: as in the measured files. "
            "With it no response is read, and none need exist.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", help="Of the draws.")] = 1,
    workers: Annotated[int, typer.Option("--workers", help="Processes.")] = 1,
) -> None:
    """Make a campaign anew with known truths, identify each, and count what intervals hold.

    A run that was stopped goes on where it was. Slices of one folder may run on many machines.
    """
    from roomfit.cli.progress import progress_bar
    from roomfit.commands import estimate_coverage_to_folder
    from roomfit.coverage.synthetic_room import CoverageSettings

    settings = CoverageSettings(
        replicates=replicates,
        first=first,
        only=only,
        result=None if source == "prior" else Path(source),
        snr_db=snr_db,
        seed=seed,
        workers=workers,
    )
    with progress_bar("calibrating") as progress:
        result = estimate_coverage_to_folder(campaign, out, settings, progress=progress)
    typer.echo(str(result))
    typer.echo(f"\ncalibration.json, calibration.csv and calibration.png are in {out}")
