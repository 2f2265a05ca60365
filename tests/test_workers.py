"""Tasks reach every worker once, whatever dies on the way, and nothing listens to the world."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from cluster_tasks import die, number_into
from roomfit.base.errors import InsufficientDataError
from roomfit.batch.cluster import cluster_client, completed, result_of

HELPERS = Path(__file__).parent / "helpers"


class Cluster:
    """A scheduler and its workers, each a process of its own, on the loopback."""

    def __init__(self, folder: Path, *, n_workers: int = 4, memory: str = "500MB") -> None:
        self._environment = os.environ | {
            "PYTHONPATH": os.pathsep.join([str(HELPERS), *sys.path]),
            "NUMBA_NUM_THREADS": "1",
            "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "2",
            "DASK_DISTRIBUTED__SCHEDULER__WORKER_SATURATION": "1.0",
            # a cut connection is given up soon
            "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "5s",
        }
        place = folder / "scheduler.json"
        module = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
        loopback = ["--host", "127.0.0.1", "--dashboard-address", "127.0.0.1:0"]
        self.scheduler = self._run([*module, *loopback, "--port", "0", "--scheduler-file", place])
        module = [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", place]
        options = ["--nworkers", n_workers, "--nthreads", 1, "--memory-limit", memory]
        self.workers = self._run(
            [*module, *loopback, *options, "--local-directory", folder / "space"]
        )
        self.address = self._address(place)

    def _run(self, command: list[object]) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [str(word) for word in command],
            env=self._environment,
            start_new_session=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def _address(self, place: Path) -> str:
        import json

        deadline = time.monotonic() + 300.0
        while time.monotonic() < deadline:
            if place.exists() and (text := place.read_text()).strip().endswith("}"):
                return str(json.loads(text)["address"])
            time.sleep(0.1)
        raise TimeoutError("no scheduler")

    def close(self) -> None:
        for process in (self.workers, self.scheduler):
            process.terminate()
            try:
                process.wait(5)
            except subprocess.TimeoutExpired:  # a nanny may wait for a worker that was killed
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


def content(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.glob("*.txt")}


@pytest.mark.slow
def test_an_own_cluster_listens_on_the_loopback_alone_and_ends_with_its_block(
    tmp_path: Path,
) -> None:
    psutil = pytest.importorskip("psutil")
    this = psutil.Process()
    before = {p.pid for p in this.children(recursive=True)}
    trimming = os.getenv("MALLOC_TRIM_THRESHOLD_")
    with cluster_client(n_workers=2) as executor:
        family = [this, *(p for p in this.children(recursive=True) if p.pid not in before)]
        listening = [c for p in family for c in p.net_connections("inet") if c.status == "LISTEN"]
        assert {c.laddr.ip for c in listening} == {"127.0.0.1"}
        tasks = [partial(number_into, tmp_path, n, 0.2) for n in range(10)]
        pids = [result_of(future) for _, future in completed(executor, tasks)]
        # dask's own value has every array given back to the system
        assert executor.submit(os.getenv, "MALLOC_TRIM_THRESHOLD_").result() == trimming
    assert len(set(pids)) == 2
    assert os.getpid() not in pids
    deadline = time.monotonic() + 60.0
    while {p.pid for p in this.children(recursive=True)} - before - _trackers(this):
        assert time.monotonic() < deadline
        time.sleep(0.1)


def _trackers(process: object) -> set[int]:
    """Return the helpers of multiprocessing, which stay as long as the process does."""
    found = process.children(recursive=True)  # type: ignore[attr-defined]
    return {
        p.pid
        for p in found
        if any(w in " ".join(p.cmdline()) for w in ("resource_tracker", "forkserver"))
    }


@pytest.mark.slow
def test_a_task_that_kills_its_workers_is_reported_and_all_others_are_done(tmp_path: Path) -> None:
    """Three workers die of it, and alone three more; none of the others is blamed."""
    with cluster_client(n_workers=2) as client:
        tasks = [die, *(partial(number_into, tmp_path, n, 0.2) for n in range(6))]
        ends = dict(completed(client, tasks))
        with pytest.raises(InsufficientDataError, match="every worker that had the task died"):
            result_of(ends.pop(0))
        assert all(isinstance(result_of(future), int) for future in ends.values())
    assert sorted(content(tmp_path)) == [f"{n}.txt" for n in range(6)]


@pytest.mark.slow
def test_what_dask_itself_says_of_a_dead_scheduler_is_not_printed(tmp_path: Path) -> None:
    """One sentence of ours, and no traceback of a library."""
    program = (
        "import sys, pathlib\n"
        "from functools import partial\n"
        "from cluster_tasks import number_into\n"
        "from roomfit.batch import cluster as workers\n"
        "from roomfit.base.errors import RoomfitError\n"
        "workers._CONNECTING_S = 120\n"
        "folder = pathlib.Path(sys.argv[2])\n"
        "tasks = [partial(number_into, folder, n, 0.3) for n in range(100)]\n"
        "try:\n"
        "    with workers.cluster_client(scheduler=sys.argv[1]) as pool:\n"
        "        for _, future in workers.completed(pool, tasks):\n"
        "            workers.result_of(future)\n"
        "except RoomfitError as error:\n"
        "    print(error, file=sys.stderr)\n"
    )
    (tmp_path / "out").mkdir()
    made = Cluster(tmp_path, n_workers=1)
    try:
        client = subprocess.Popen(
            [sys.executable, "-c", program, made.address, str(tmp_path / "out")],
            env=made._environment,
            stderr=subprocess.PIPE,
            text=True,
        )
        deadline = time.monotonic() + 240.0
        while len(content(tmp_path / "out")) < 3:
            assert time.monotonic() < deadline and client.poll() is None
            time.sleep(0.1)
        made.scheduler.kill()
        _, said = client.communicate(timeout=240)
    finally:
        made.close()
    assert "the connection to the scheduler is lost" in said
    assert "Traceback" not in said and "distributed" not in said, said
