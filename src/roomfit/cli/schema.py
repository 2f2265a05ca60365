"""``roomfit schema``: the keys of a campaign file, for editors."""

from __future__ import annotations

import argparse
import json

from roomfit.base.arguments import check_known
from roomfit.cli.terminal import say
from roomfit.files.schema import campaign_schema
from roomfit.files.treatment_schema import treatment_schema


def run(options: argparse.Namespace) -> None:
    schemas = {"campaign": campaign_schema, "treatment": treatment_schema}
    check_known("no schema of this name", options.of, schemas)
    say(json.dumps(schemas[options.of](), indent=2))
