"""No file brings the program down, keeps it, fills the memory or the terminal.

Here a few cases of the fuzzer; ``python tests/fuzz/fuzz.py --cases 100000`` runs all of them.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from random import Random

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="watches by /proc")
HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from corpus import corpus  # noqa: E402
from examples import examples  # noqa: E402
from fuzz import readers  # noqa: E402
from mutations import damaged  # noqa: E402

from roomfit.base.errors import RoomfitError  # noqa: E402

# read in the process itself, within milliseconds
QUICK = (
    *("box.obj", "text.ply", "big.ply", "box.geo", "scan.json", "text.dxf", "binary.dxf"),
    *("corners.csv", "planes.csv", "response.wav", "response.npy", "rew.txt"),
)


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
    assert f"{len(corpus()) + 100} cases" in printed and "'failed'" not in printed


@pytest.mark.parametrize("seed", range(40))
def test_a_damaged_file_is_read_or_refused_in_words(seed, quick_readers):
    folder, known = quick_readers
    for name in QUICK:
        path = folder / name
        path.write_bytes(damaged(name, examples()[name], Random(seed)))
        try:
            known[name](path)
        except RoomfitError as error:
            assert 0 < len(str(error)) < 4000, name


@pytest.fixture(scope="module")
def quick_readers(tmp_path_factory):
    folder = tmp_path_factory.mktemp("damaged")
    return folder, readers(folder)
