"""``roomfit schema``: the keys of a campaign file, for editors."""

from __future__ import annotations

import argparse

from roomfit.cli.arguments import Commands, add_command
from roomfit.cli.terminal import say


def add(commands: Commands) -> None:
    about = (
        "Print the JSON schema of campaign files.\n\n"
        "Editors complete and check keys by it: roomfit schema > campaign.schema.json, and write "
        "#:schema ./campaign.schema.json as the first line of the campaign."
    )
    add_command(commands, "schema", about, run)


def run(_: argparse.Namespace) -> None:
    import json

    from roomfit.io.schema import campaign_schema

    say(json.dumps(campaign_schema(), indent=2))
