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
SLOW_TO_START = ("response.sofa", "directivity.sofa", "v73.mat")  # a process for each file


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


def test_every_file_that_once_failed_is_read_or_refused():
    printed = fuzz("--corpus")
    assert "'failed'" not in printed


def test_damaged_files_of_every_format_are_read_or_refused():
    printed = fuzz("--cases", "300", "--seed", "20", "--without", *SLOW_TO_START)
    assert printed.startswith("300 cases")


def test_damaged_hdf5_files_are_read_or_refused():
    printed = fuzz("--cases", "12", "--seed", "21", "--only", *SLOW_TO_START)
    assert printed.startswith("12 cases")
