"""Workers end with whoever started them, and whoever waits for one is told for which."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from roomfit.base.errors import FolderInUseError, InputError
from roomfit.base.whole_files import locked
from roomfit.batch.rooms import described, identify_rooms, room_tasks
from roomfit.report.text import text

HELPERS = Path(__file__).parent / "helpers"


def test_a_room_that_another_run_holds_is_elsewhere_and_leaves_no_record(tmp_path: Path) -> None:
    """It is neither refused nor failed, and the next run looks at it again."""
    content = '[room]\nshoebox = [6, 5, 3]\n[[measurements]]\nparameters = "measured.csv"\n'
    (tmp_path / "hall").mkdir()
    campaign = tmp_path / "hall" / "campaign.toml"
    campaign.write_text(content)
    campaign.with_name("measured.csv").write_text("source,receiver,parameter,1000\nS,R,T30,0.3\n")
    out = tmp_path / "out"
    place = out / "rooms" / room_tasks([campaign])[0].address
    place.parent.mkdir(parents=True)
    with locked(place):
        (row,) = identify_rooms([campaign], out)
    assert (row.status, row.message) == ("elsewhere", "another run is identifying this room")
    assert "1 room: 1 elsewhere." in text(described([row]))
    assert list((out / "failures").iterdir()) == []
    (row,) = identify_rooms([campaign], out)
    assert row.status == "refused"  # it has no source
    assert issubclass(FolderInUseError, InputError)


def is_running(number: int) -> bool:
    """Whether a process is there that is no mere entry of the table of processes."""
    try:
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the system ends a process with its parent")
@pytest.mark.parametrize(("kind", "n"), [("cluster", 2), ("page", 1)])
def test_a_worker_ends_with_its_parent_whatever_it_is_doing(
    tmp_path: Path, kind: str, n: int
) -> None:
    """In a call that lets no thread of its own run; the page's, while its pipe stays open."""
    ends = os.pipe()
    program = [sys.executable, str(HELPERS / "cluster_more.py"), kind, str(tmp_path)]
    parent = subprocess.Popen(
        [*program, f"{ends[0]},{ends[1]}"],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(HELPERS), *sys.path])},
        pass_fds=ends,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        deadline = time.monotonic() + 240.0
        while len(found := [p for p in tmp_path.glob("*.pid") if p.read_text()]) < n:
            assert time.monotonic() < deadline and parent.poll() is None
            time.sleep(0.1)
        numbers = [int(p.read_text()) for p in found]
        assert all(is_running(number) for number in numbers)
        time.sleep(0.5)
        parent.kill()
        parent.wait()
        deadline = time.monotonic() + 20.0
        while any(is_running(number) for number in numbers):
            assert time.monotonic() < deadline
            time.sleep(0.1)
    finally:
        parent.kill()
        for end in ends:
            os.close(end)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="processes are looked up in /proc")
def test_an_interrupt_of_all_ends_a_cluster_at_once_and_leaves_no_worker(tmp_path: Path) -> None:
    """As the terminal sends it, while workers let nothing else run; dask alone takes 4 to 34 s."""
    program = [sys.executable, str(HELPERS / "cluster_more.py"), "cluster", str(tmp_path)]
    parent = subprocess.Popen(
        program,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(HELPERS), *sys.path])},
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        deadline = time.monotonic() + 240.0
        while len(found := [p for p in tmp_path.glob("*.pid") if p.read_text()]) < 2:
            assert time.monotonic() < deadline and parent.poll() is None
            time.sleep(0.1)
        os.killpg(parent.pid, signal.SIGINT)
        _, said = parent.communicate(timeout=3.0)
        assert not any(is_running(int(p.read_text())) for p in found)
        assert said.count("Traceback") == 1  # none of a worker
    finally:
        parent.kill()
