"""The command line: arguments in, one call into `roomfit.app`, an exit code out.

Exit codes: 0 done, 1 a fault of roomfit itself, 2 bad input (or an answer that the data do not
hold), 130 interrupted.
"""

from __future__ import annotations

import sys

_INTERRUPTED = 130


def main() -> None:
    """Run the command line and leave with its exit code."""
    from roomfit.errors import RoomfitError

    try:
        _run()
    except RoomfitError as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(2)
    except KeyboardInterrupt:
        sys.stderr.write("interrupted; nothing half-written was left behind\n")
        sys.exit(_INTERRUPTED)


def _run() -> None:
    from roomfit.cli.commands import app

    try:
        app()
    except SystemExit as end:
        # typer turns Ctrl-C into this code without a word
        if end.code == _INTERRUPTED:
            raise KeyboardInterrupt from end
        raise
