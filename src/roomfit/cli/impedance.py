"""``roomfit impedance``: complex impedances of walls."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def impedance(
    campaign: Annotated[Path, typer.Argument(help="Campaign file (TOML).")],
    out: Annotated[Path, typer.Option("--out", help="Folder for the results; made if needed.")],
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Write into a folder that is not empty.")
    ] = False,
) -> None:
    """Find the acoustic impedance of a measured room's walls over frequency, with intervals."""
    from roomfit.cli.progress import progress_bar
    from roomfit.impedance.campaign import impedance_to_folder

    with progress_bar("identifying impedances") as progress:
        result = impedance_to_folder(campaign, out, overwrite=overwrite, progress=progress)
    typer.echo(str(result))
    typer.echo(f"\nresult.json, impedance.csv and pictures are in {out}")
