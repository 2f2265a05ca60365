"""Workers end with whoever started them, and whoever waits for one is told for which."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from cluster_more import keep_memory
from cluster_tasks import fill_memory, number_into
from roomfit import workers
from roomfit.batch import identify_rooms, room_tasks, rooms_text
from roomfit.cache import locked
from roomfit.errors import FolderInUseError, InputError
from roomfit.workers import check_memory, cluster_pool, completed, result_of

HELPERS = Path(__file__).parent / "helpers"


def test_a_limit_of_memory_below_what_a_room_takes_is_refused_with_both_figures() -> None:
    for enough in (0, workers.LEAST_MEMORY_BYTES, 10**10):
        check_memory(enough, "worker", "more")
    with pytest.raises(InputError) as refused:
        check_memory(workers.LEAST_MEMORY_BYTES - 1, "tcp://10.0.0.1:1", "start it with more")
    assert "400 MB" in str(refused.value.found) and "400 MB" in str(refused.value.needed)
    assert refused.value.where == "tcp://10.0.0.1:1" and refused.value.hint == "start it with more"


def test_more_workers_than_the_memory_is_for_are_refused_before_any_starts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    system = pytest.importorskip("distributed.system")
    monkeypatch.setattr(system, "MEMORY_LIMIT", 10**9)
    with pytest.raises(InputError, match=r"--workers 3[\s\S]*333 MB"), cluster_pool(n_workers=3):
        pass


class Client:
    """Takes tasks as dask's client does, and says of its workers what dask's would."""

    def __init__(self) -> None:
        self.sent: list[Future[Any]] = []

    def submit(self, _: Callable[[], object], *, pure: bool) -> Future[Any]:
        assert not pure
        self.sent.append(Future())
        return self.sent[-1]

    def nthreads(self) -> dict[str, int]:
        return {"tcp://a": 1, "tcp://b": 1, "tcp://c": 1}

    def processing(self) -> dict[str, tuple[str, ...]]:
        return {"tcp://a": ("task",), "tcp://b": (), "tcp://c": ("task",)}

    def scheduler_info(self, *, n_workers: int) -> dict[str, Any]:
        assert n_workers == -1  # all of them
        now = time.time()
        return {
            "workers": {
                "tcp://a": {"status": "paused", "last_seen": now},
                "tcp://b": {"status": "running", "last_seen": now},
                "tcp://c": {"status": "running", "last_seen": now - 600.0},
            }
        }


def test_whoever_waits_is_told_for_which_worker_since_when_and_what_ails_it(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(workers, "_SILENCE_S", 0.1)
    client = Client()
    pool = workers._ClusterExecutor(client)
    threading.Timer(0.35, lambda: client.sent[0].set_result(7)).start()
    with caplog.at_level(logging.INFO, logger="roomfit"):
        ((number, future),) = completed(pool, [partial(int, 7)])
    assert (number, future.result()) == (0, 7)
    said = [r.getMessage() for r in caplog.records]
    assert 2 <= len(said) <= 3
    assert all("worker tcp://a, paused: its memory is full" in text for text in said)
    assert all("worker tcp://c, silent for 600 s since " in text for text in said)
    assert not any("tcp://b" in text for text in said)


def test_a_room_that_another_run_holds_is_elsewhere_and_leaves_no_record(tmp_path: Path) -> None:
    """It is neither refused nor failed, and the next run looks at it again."""
    text = '[room]\nshoebox = [6, 5, 3]\n[[measurements]]\nparameters = "measured.csv"\n'
    (tmp_path / "hall").mkdir()
    campaign = tmp_path / "hall" / "campaign.toml"
    campaign.write_text(text)
    campaign.with_name("measured.csv").write_text("source,receiver,parameter,1000\nS,R,T30,0.3\n")
    out = tmp_path / "out"
    place = out / "rooms" / room_tasks([campaign])[0].address
    place.parent.mkdir(parents=True)
    with locked(place):
        (row,) = identify_rooms([campaign], out)
    assert (row.status, row.message) == ("elsewhere", "another run is identifying this room")
    assert "1 rooms: 1 elsewhere." in rooms_text([row])
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
@pytest.mark.parametrize(("kind", "n"), [("pool", 2), ("cluster", 2), ("page", 1)])
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


@pytest.mark.slow
def test_a_worker_of_the_own_cluster_without_memory_ends_and_does_not_wait(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the least limit; the tasks beside the one that fills it are done."""
    system = pytest.importorskip("distributed.system")
    monkeypatch.setattr(system, "MEMORY_LIMIT", workers.LEAST_MEMORY_BYTES)
    monkeypatch.setattr(workers, "_CONNECTING_S", 120)
    tasks = [partial(fill_memory), partial(number_into, tmp_path, 1)]
    with cluster_pool() as pool:
        ends = dict(completed(pool, tasks))
        with pytest.raises(Exception, match="every worker that had the task died") as died:
            result_of(ends[0])
        assert "memory" in str(died.value)
        assert isinstance(result_of(ends[1]), int)


@pytest.mark.slow
def test_a_worker_with_nearly_all_of_its_memory_goes_on_and_does_not_pause(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At 87 % of the limit, where dask by itself gives it no further task, for ever."""
    system = pytest.importorskip("distributed.system")
    monkeypatch.setattr(system, "MEMORY_LIMIT", 500_000_000)
    monkeypatch.setattr(workers, "_CONNECTING_S", 45)
    with cluster_pool() as pool:
        first = pool.submit(keep_memory, 435e6)
        assert 430e6 < first.result(timeout=120) < 470e6
        tasks = [pool.submit(number_into, tmp_path, n) for n in range(3)]
        assert len({task.result(timeout=30) for task in tasks}) == 1
