"""``roomfit app``: the workbench in the browser."""

from __future__ import annotations

import argparse

from roomfit.cli.terminal import say, warn

_OWN = ("127.0.0.1", "localhost", "::1")


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
