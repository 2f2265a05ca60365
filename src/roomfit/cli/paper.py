"""``roomfit paper``: every result of Suh (2001), and what it left open."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def paper(
    out: Annotated[Path, typer.Option("--out", help="Folder for paper.json, tables, pictures.")],
    seeds: Annotated[
        int, typer.Option("--seeds", min=1, help="Searches of every problem by every method.")
    ] = 50,
    workers: Annotated[int, typer.Option("--workers", min=1, help="Processes.")] = 2,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Write into a folder that is not empty.")
    ] = False,
) -> None:
    """Repeat the paper on its reconstructed room, then ask what other rays would have said."""
    from roomfit.cli.progress import progress_bar
    from roomfit.suh2001.output import paper_text, run_paper
    from roomfit.suh2001.repeat import PaperSettings

    with progress_bar("repeating the paper") as progress:
        result = run_paper(
            out, PaperSettings(seeds, workers), overwrite=overwrite, progress=progress
        )
    typer.echo(paper_text(result))
    typer.echo(f"\npaper.json, tables and pictures are in {out}.")
