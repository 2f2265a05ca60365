"""No file brings the program down, keeps it, fills the memory or the terminal.

Here a few cases of the fuzzer; ``python tests/fuzz/fuzz.py --cases 100000`` runs all of them.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="watches by /proc")
HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from corpus import corpus  # noqa: E402


def fuzz(*arguments: str) -> str:
    """Run the fuzzer in a process of its own and return what it printed."""
    done = subprocess.run(
        [sys.executable, str(HERE / "fuzz.py"), *arguments],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_what_once_failed_and_damaged_files_of_every_format_are_read_or_refused():
    """In one process, which takes most of the time to start."""
    printed = fuzz("--corpus", "--cases", "100", "--seed", "20")
    assert printed.startswith(f"{len(corpus()) + 100} cases") and "'failed'" not in printed
