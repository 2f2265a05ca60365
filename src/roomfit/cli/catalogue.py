"""``roomfit catalogue``: common materials and their published absorption."""

from __future__ import annotations

import argparse

from roomfit.cli.arguments import Commands, add_command
from roomfit.cli.terminal import say


def add(commands: Commands) -> None:
    about = "List common materials, or show one with the spread of its absorption and the sources."
    parser = add_command(commands, "catalogue", about, run)
    parser.add_argument(
        "words", nargs="*", help="Name of a material to show, or words to search for."
    )


def run(options: argparse.Namespace) -> None:
    from roomfit.materials.catalogue import find_material, search_catalogue
    from roomfit.report.text import catalogue_text, entry_text

    found = search_catalogue(options.words)
    name = "-".join(options.words)
    if options.words and (not found or name.lower() in (e.name for e in found)):
        say(entry_text(find_material(name)))
    else:
        say(catalogue_text(found))
