"""``roomfit predict``: what would be measured."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def predict(
    campaign: Annotated[Path, typer.Argument(help="Campaign file (TOML) of the room to predict.")],
    absorption: Annotated[
        Path, typer.Option("--absorption", help="result.json or absorption.csv of a fit.")
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder for the results; made if needed.")],
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="What if: MATERIAL=0.3, 0.3+-0.05, one value per band, x1.5+-0.2, or a name of "
            "the catalogue. May be given several times.",
        ),
    ] = None,
    pairs: Annotated[
        str,
        typer.Option("--pairs", help="all: every source with every receiver; campaign: measured."),
    ] = "all",
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Write into a folder that is not empty.")
    ] = False,
    no_cache: Annotated[
        bool, typer.Option("--no-cache", help="Neither use nor keep intermediate results.")
    ] = False,
) -> None:
    """Predict reverberation and clarity with their intervals, as the room is or with changes."""
    from roomfit.cli.progress import progress_bar
    from roomfit.commands import predict_to_folder
    from roomfit.prediction.campaign import pair_choice
    from roomfit.prediction.changes import read_change

    wanted = [read_change(text) for text in changes or []]
    chosen = pair_choice(pairs)
    with progress_bar("predicting") as progress:
        predicted = predict_to_folder(
            campaign,
            absorption,
            out,
            wanted,
            pairs=chosen,
            overwrite=overwrite,
            use_cache=not no_cache,
            progress=progress,
        )
    typer.echo(str(predicted))
    typer.echo(f"\npredicted.json, predicted.csv and pictures are in {out}")
