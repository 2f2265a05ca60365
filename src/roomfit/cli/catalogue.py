"""``roomfit catalogue``: common materials with what tables say of their absorption."""

from __future__ import annotations

from typing import Annotated

import typer


def catalogue(
    words: Annotated[
        list[str] | None,
        typer.Argument(help="A name, to see all about it; or words to look for; or nothing."),
    ] = None,
) -> None:
    """List common materials, or show one with the spread of its absorption and the sources."""
    from roomfit.materials.catalogue import find_material, search_catalogue
    from roomfit.report.text import catalogue_text, entry_text

    found = search_catalogue(words or [])
    name = "-".join(words or [])
    if words and (not found or name.lower() in (e.name for e in found)):
        typer.echo(entry_text(find_material(name)))
    else:
        typer.echo(catalogue_text(found))
