"""``roomfit app``: the workbench in the browser."""

from __future__ import annotations

import argparse
import asyncio
import sys
from typing import Any

from roomfit.base.errors import InputError
from roomfit.cli.terminal import say, warn

_OWN = ("127.0.0.1", "localhost", "::1")


def run(options: argparse.Namespace) -> None:
    if options.host not in _OWN:
        warn(
            f"warning: {options.host} can be reached from other machines. Whoever has the address "
            "with its token reads and changes this project, and can have this machine compute; "
            "what is sent is not encrypted."
        )
    asyncio.run(_serve(options))


async def _serve(options: argparse.Namespace) -> None:
    """Serve the project; what reads its files imports its libraries while the page does."""
    from roomfit.app.jobs import Bench

    def tell(text: str) -> None:
        say(text)
        sys.stdout.flush()

    bench = Bench(options.folder.resolve())
    await bench.reader.started()
    try:
        place = {"host": options.host, "port": options.port}
        await _server()(bench, **place, open_browser=not options.no_browser, say=tell)
    finally:
        await bench.stop()


def _server() -> Any:
    """Return what serves; `InputError` without the packages of the extra ``app``."""
    try:
        from roomfit.app.server import serve
    except ModuleNotFoundError as error:
        what = "the workbench needs packages that are not installed"
        found, hint = f"no module {error.name!r}", "pip install 'roomfit[app]'"
        raise InputError(what, found=found, needed="the extra app", hint=hint) from error
    return serve
