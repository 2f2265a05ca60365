"""``roomfit catalogue``: common materials and their published absorption."""

from __future__ import annotations

import argparse

from roomfit.cli.terminal import say
from roomfit.materials.catalogue import find_material, search_catalogue
from roomfit.report.check import catalogue_text, entry_text


def run(options: argparse.Namespace) -> None:
    found = search_catalogue(options.words)
    name = "-".join(options.words)
    if options.words and (not found or name.lower() in (e.name for e in found)):
        say(entry_text(find_material(name)))
    else:
        say(catalogue_text(found))
