"""``roomfit design``: where to measure."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def design(
    campaign: Annotated[
        Path, typer.Argument(help="Campaign file (TOML); it need not have a measurement.")
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder for the results; made if needed.")],
    candidates: Annotated[
        int, typer.Option("--candidates", help="Pairs of source and receiver to choose from.")
    ] = 200,
    choose: Annotated[
        int | None, typer.Option("--choose", help="How many; 6, or 1 after a fit.")
    ] = None,
    sources: Annotated[
        int | None, typer.Option("--sources", help="How many different sources at most.")
    ] = None,
    criterion: Annotated[
        str | None,
        typer.Option("--criterion", help="determinant, mean or worst: what is to become small."),
    ] = None,
    result: Annotated[
        Path | None,
        typer.Option("--result", help="result.json of a fit: what to measure next."),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Write into a folder that is not empty.")
    ] = False,
) -> None:
    """Choose where to measure, so that absorption is found with the narrowest intervals."""
    from roomfit.cli.progress import progress_bar
    from roomfit.commands import design_to_folder

    wanted = {
        "n_candidates": candidates,
        "number": choose,
        "most_sources": sources,
        "criterion": criterion,
    }
    with progress_bar("choosing where to measure") as progress:
        answer = design_to_folder(
            campaign,
            out,
            {name: value for name, value in wanted.items() if value is not None},
            result_file=result,
            overwrite=overwrite,
            progress=progress,
        )
    typer.echo(str(answer))
    typer.echo(f"\ndesign.json, design.csv and pictures are in {out}")
