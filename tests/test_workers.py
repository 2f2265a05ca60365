"""Tasks reach every worker once, whatever dies on the way, and nothing listens to the world."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from cluster_tasks import die, die_once, number_into
from roomfit.base.errors import InsufficientDataError
from roomfit.batch.cluster import in_processes


def content(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.glob("*.txt")}


@pytest.mark.slow
def test_processes_of_a_batch_have_no_door_for_other_users_and_end_with_it(tmp_path: Path) -> None:
    """Another user of the machine finds no port and no socket of any of them, while they work."""
    psutil = pytest.importorskip("psutil")
    this = psutil.Process()
    before = {p.pid for p in this.children(recursive=True)}
    doors = set(this.net_connections("all"))
    tasks = [partial(number_into, tmp_path, n, 0.5) for n in range(4)]
    pids = set()
    for _, pid in in_processes(tasks, 2):
        family = [p for p in this.children(recursive=True) if p.pid not in before]
        assert not [c for p in family for c in p.net_connections("all")]
        assert set(this.net_connections("all")) == doors
        pids.add(pid)
    assert len(pids) == 4 and os.getpid() not in pids
    working = [p for p in this.children(recursive=True) if p.pid not in before]
    assert not [p for p in working if "resource_tracker" not in " ".join(p.cmdline())]


@pytest.mark.slow
def test_a_task_that_kills_its_workers_is_reported_and_all_others_are_done(tmp_path: Path) -> None:
    """Three workers die of it; and one while it compiles, for which another begins again."""
    tasks = [die, *(partial(number_into, tmp_path, n, 0.2) for n in range(6))]
    ends = dict(in_processes(tasks, 2, warm=partial(die_once, tmp_path / "died")))
    with pytest.raises(InsufficientDataError, match="every worker that had the task died"):
        raise ends.pop(0)
    assert all(isinstance(end, int) for end in ends.values())
    assert sorted(content(tmp_path)) == [f"{n}.txt" for n in range(6)]
    assert (tmp_path / "died").read_text() == "once, and done"


DASK_CLIENT = """
import sys, pathlib
from functools import partial
from cluster_tasks import number_into
from roomfit.base.errors import RoomfitError
from roomfit.batch.cluster import on_cluster

tasks = [partial(number_into, pathlib.Path(sys.argv[2]), n, 0.3) for n in range(100)]
try:
    for _, end in on_cluster(tasks, sys.argv[1]):
        pass
except RoomfitError as error:
    print(error, file=sys.stderr)
"""


@pytest.mark.slow
def test_what_dask_itself_says_of_a_dead_scheduler_is_not_printed(tmp_path: Path) -> None:
    """One sentence of ours, and no traceback of a library."""
    helpers = Path(__file__).parent / "helpers"
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(helpers), *sys.path]),
        "NUMBA_NUM_THREADS": "1",
        "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "5s",  # a cut connection is given up soon
    }
    place, space, out = (tmp_path / name for name in ("scheduler.json", "space", "out"))
    out.mkdir()
    common = ["--host", "127.0.0.1", "--dashboard-address", "127.0.0.1:0", "--scheduler-file"]
    one = ["--nworkers", "1", "--nthreads", "1", "--memory-limit", "500MB"]
    running = []

    def started(*command: object, **pipes: object) -> subprocess.Popen[str]:
        words = [sys.executable, *map(str, command)]
        running.append(subprocess.Popen(words, env=environment, text=True, **pipes))  # type: ignore[call-overload]
        return running[-1]

    def until(done: Callable[[], bool]) -> None:
        deadline = time.monotonic() + 240.0
        while not done():
            assert time.monotonic() < deadline and running[-1].poll() is None
            time.sleep(0.1)

    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    try:
        scheduler = started(
            "-m", "distributed.cli.dask_scheduler", "--port", "0", *common, place, **silent
        )
        until(lambda: place.exists() and place.read_text().strip().endswith("}"))
        worker = [*one, "--local-directory", space, *common, place]
        started("-m", "distributed.cli.dask_worker", *worker, **silent)
        until(lambda: any(space.rglob("worker-*")))
        address = json.loads(place.read_text())["address"]
        client = started("-c", DASK_CLIENT, address, out, stderr=subprocess.PIPE)
        until(lambda: len(content(out)) >= 3)
        scheduler.kill()
        _, said = client.communicate(timeout=240)
    finally:
        for process in reversed(running):
            process.terminate()
            process.wait(60)
    assert "the connection to the scheduler is lost" in said
    assert "Traceback" not in said and "distributed" not in said, said
