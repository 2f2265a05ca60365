"""The command line: arguments in, one call into `roomfit.app`, an exit code out.

Exit codes: 0 done, 1 a fault of roomfit itself, 2 bad input (or an answer that the data do not
hold), 130 interrupted.
"""

from __future__ import annotations

import sys


def main() -> None:
    """Run the command line and leave with its exit code."""
    from roomfit.cli.commands import app
    from roomfit.errors import RoomfitError

    try:
        app()
    except RoomfitError as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(2)
    except KeyboardInterrupt:
        sys.stderr.write("interrupted; nothing half-written was left behind\n")
        sys.exit(130)
