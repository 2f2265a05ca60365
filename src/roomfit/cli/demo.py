"""``roomfit demo``: the main job on a room whose truth is known."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def demo(
    out: Annotated[
        Path, typer.Option("--out", help="Folder for the campaign and its results.")
    ] = Path("roomfit-demo"),
    seed: Annotated[int, typer.Option("--seed", help="Draws positions, levels and noise.")] = 1,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Write into a folder that is not empty.")
    ] = False,
) -> None:
    """Simulate a measured room by another road than the fit's own model, and identify it."""
    from roomfit.cli.progress import progress_bar
    from roomfit.commands import demo_text, run_demo

    with progress_bar("simulating and identifying") as progress:
        result = run_demo(out, seed, overwrite=overwrite, progress=progress)
    typer.echo(demo_text(result.answer, result.true_absorption))
    typer.echo(f"\nThe campaign is in {out / 'campaign'}, result and pictures in {out / 'result'}.")
