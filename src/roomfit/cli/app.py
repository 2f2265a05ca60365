"""``roomfit app``: the workbench in the browser."""

from __future__ import annotations

import argparse
from pathlib import Path

from roomfit.cli.arguments import Commands, add_command, whole_number
from roomfit.cli.terminal import say, warn

_OWN = ("127.0.0.1", "localhost", "::1")


def add(commands: Commands) -> None:
    about = (
        "Work on a project in the browser: room, measurements, absorption, what if, report.\n\n"
        "FOLDER holds campaign.toml, recordings and results, which the other commands read and "
        "write, too. Nothing leaves this machine, and nobody gets in without the address that is "
        "printed."
    )
    parser = add_command(commands, "app", about, run)
    parser.add_argument(
        "folder", type=Path, nargs="?", default=Path(), help="Of the project; made if needed."
    )
    parser.add_option(
        "--port", "To listen at; 0: any. Left out: 8321, or the next free.", type=whole_number
    )
    parser.add_option(
        "--host", "Address to listen at; others than this may reach it.", default="127.0.0.1"
    )
    parser.add_argument(
        "--no-browser", action="store_true", help="Print the address; open no browser."
    )


def run(options: argparse.Namespace) -> None:
    import asyncio

    if options.host not in _OWN:
        warn(
            f"warning: {options.host} can be reached from other machines. Whoever has the address "
            "with its token reads and changes this project, and can have this machine compute; "
            "what is sent is not encrypted."
        )
    asyncio.run(_serve(options))


async def _serve(options: argparse.Namespace) -> None:
    """Serve the project; what reads its files imports its libraries while the page does."""
    import sys

    from roomfit.app.jobs import Bench
    from roomfit.base.errors import InputError

    def tell(text: str) -> None:
        say(text)
        sys.stdout.flush()

    bench = Bench(options.folder.resolve())
    await bench.reader.started()
    try:
        try:
            from roomfit.app.server import serve
        except ModuleNotFoundError as error:
            raise InputError(
                "the workbench needs packages that are not installed",
                found=f"no module {error.name!r}",
                needed="the extra app",
                hint="pip install 'roomfit[app]'",
            ) from error
        await serve(
            bench,
            host=options.host,
            port=options.port,
            open_browser=not options.no_browser,
            say=tell,
        )
    finally:
        await bench.stop()
