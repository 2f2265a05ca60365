"""The commands. Heavy packages are imported inside them, so that --help answers at once."""

from __future__ import annotations

from typing import Annotated

import typer

import roomfit
from roomfit.cli.calibrate import calibrate
from roomfit.cli.catalogue import catalogue
from roomfit.cli.check import check
from roomfit.cli.demo import demo
from roomfit.cli.design import design
from roomfit.cli.export import export
from roomfit.cli.identify import identify
from roomfit.cli.impedance import impedance
from roomfit.cli.paper import paper
from roomfit.cli.predict import predict

app = typer.Typer(
    name="roomfit",
    help="Absorption of a real room's walls from impulse responses measured in it.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"roomfit {roomfit.__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Absorption of a real room's walls from impulse responses measured in it."""


app.command()(calibrate)
app.command()(catalogue)
app.command()(check)
app.command()(demo)
app.command()(design)
app.command()(export)
app.command()(identify)
app.command()(impedance)
app.command()(paper)
app.command()(predict)
