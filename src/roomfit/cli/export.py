"""``roomfit export``: absorption for another program."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def export(
    result: Annotated[Path, typer.Argument(help="result.json or absorption.csv of a fit.")],
    wanted: Annotated[
        str,
        typer.Option("--format", help="catt, odeon, isimpa, raven, pyroomacoustics or csv."),
    ],
    out: Annotated[Path, typer.Option("--out", help="File to write; for raven a folder.")],
    scattering: Annotated[
        float | None,
        typer.Option("--scattering", help="For all materials, where the result tells none."),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace what is there already.")
    ] = False,
) -> None:
    """Write the absorption that was found as materials of another program."""
    from roomfit.commands import export_result

    written = export_result(
        result,
        wanted,
        out,
        scattering=scattering,
        overwrite=overwrite,
    )
    for file in written.files:
        typer.echo(str(file))
    for finding in written.findings:
        typer.echo(f"  {finding.severity:<8} {finding.sentence}")
