"""``roomfit identify``: the main job."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def identify(
    campaign: Annotated[Path, typer.Argument(help="Campaign file (TOML).")],
    out: Annotated[Path, typer.Option("--out", help="Folder for the results; made if needed.")],
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Write into a folder that is not empty.")
    ] = False,
    no_cache: Annotated[
        bool, typer.Option("--no-cache", help="Do not keep the trace for a later run.")
    ] = False,
) -> None:
    """Find the absorption of a measured room, per material and band, with intervals."""
    from roomfit.cli.progress import progress_bar
    from roomfit.commands import identify_to_folder
    from roomfit.report.text import answer_text

    with progress_bar("identifying") as progress:
        answer = identify_to_folder(
            campaign, out, overwrite=overwrite, keep=not no_cache, progress=progress
        )
    typer.echo(answer_text(answer))
    typer.echo(f"\nreport.html, result.json, absorption.csv and pictures are in {out}")
