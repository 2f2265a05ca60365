"""``roomfit schema``: the keys of a campaign file, for editors."""

from __future__ import annotations

import argparse
import json

from roomfit.base.arguments import check_known
from roomfit.cli.terminal import say
from roomfit.files.schema import Campaign, Table, json_schema
from roomfit.treat.campaign import TreatmentTable


def run(options: argparse.Namespace) -> None:
    tables: dict[str, type[Table]] = {"campaign": Campaign, "treatment": TreatmentTable}
    check_known("no schema of this name", options.of, tables)
    say(json.dumps(json_schema(tables[options.of], options.of.capitalize()), indent=2))
