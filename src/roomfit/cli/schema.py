"""``roomfit schema``: the keys of a campaign file, for editors."""

from __future__ import annotations

import argparse

from roomfit.cli.arguments import Commands, add_command
from roomfit.cli.terminal import say


def add(commands: Commands) -> None:
    about = (
        "Print the JSON schema of campaign files, or of treatment files.\n\n"
        "Editors complete and check keys by it: roomfit schema > campaign.schema.json, and write "
        "#:schema ./campaign.schema.json as the first line of the campaign."
    )
    parser = add_command(commands, "schema", about, run)
    parser.add_option("--of", "campaign, or treatment.", default="campaign")


def run(options: argparse.Namespace) -> None:
    import json

    from roomfit.base.arguments import check_known
    from roomfit.files.schema import campaign_schema, treatment_schema

    schemas = {"campaign": campaign_schema, "treatment": treatment_schema}
    check_known("no schema of this name", options.of, schemas)
    say(json.dumps(schemas[options.of](), indent=2))
