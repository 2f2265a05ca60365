"""Tasks that hold the interpreter or memory, and programs that are killed while they do."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import time
from functools import partial
from pathlib import Path


def hold(folder: Path, number: int) -> None:
    """Note the process, and then call what does not release the interpreter for ten minutes."""
    (folder / f"{number}.pid").write_text(str(os.getpid()))
    ctypes.PyDLL(None).sleep(600)


def main() -> None:
    """Have two workers hold, in a cluster; or start the page's worker."""
    from roomfit.batch.cluster import in_processes

    kind, folder = sys.argv[1], Path(sys.argv[2])
    if kind == "page":
        reading, _ = map(int, sys.argv[3].split(","))
        module = [sys.executable, "-m", "roomfit.app.jobs", "0"]
        found = subprocess.Popen(
            module, stdin=reading, stdout=subprocess.PIPE, start_new_session=True
        )
        assert found.stdout is not None
        found.stdout.readline()  # it is ready
        (folder / "0.pid").write_text(str(found.pid))
        time.sleep(600)
    list(in_processes([partial(hold, folder, n) for n in range(2)], 2))


if __name__ == "__main__":
    main()
