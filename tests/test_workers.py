"""Tasks reach every worker once, whatever dies on the way, and nothing listens to the world."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from importlib import metadata
from pathlib import Path

import pytest

from cluster_tasks import die, die_once, fail, fill_memory, number_into
from roomfit import workers
from roomfit.errors import InputError, InsufficientDataError, StoreError
from roomfit.workers import bundled, cluster_pool, completed, in_pool, result_of

HELPERS = Path(__file__).parent / "helpers"


def test_no_more_than_four_tasks_a_thread_are_submitted_at_once() -> None:
    submitted, yielded = 0, 0

    def tasks() -> Iterator[Callable[[], int]]:
        nonlocal submitted
        for number in range(50):
            submitted += 1
            assert submitted - yielded <= 3 * workers.TASKS_A_THREAD
            yield partial(int, number)

    with ThreadPoolExecutor(3) as pool:
        found = {}
        for number, future in completed(pool, tasks()):
            found[number] = future.result()
            yielded += 1
    assert found == {n: n for n in range(50)}


def test_tasks_that_have_not_begun_are_dropped_when_nobody_waits_for_them() -> None:
    with ThreadPoolExecutor(1) as pool:
        ends = completed(pool, [partial(time.sleep, 0.05)] * 30)
        next(ends)
        begin = time.monotonic()
        ends.close()
        pool.shutdown(wait=True)
    assert time.monotonic() - begin < 1.0  # 29 of them take 1.5 s


def test_bundles_hold_every_task_once_and_last_long_enough() -> None:
    known: list[float] = []
    tasks = [partial(int, n) for n in range(40)]
    sizes, numbers = [], []
    for bundle in bundled(tasks, lambda: known[-1] if known else None):
        numbers += bundle()
        sizes.append(len(bundle.args[0]))
        if len(sizes) == 2:
            known.append(0.4)
    assert numbers == list(range(40))
    assert sizes[:2] == [1, 1]
    assert all(size * 0.4 >= workers.SHORTEST_TASK_S for size in sizes[2:-1])


def test_without_the_package_or_a_scheduler_the_message_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(workers, "_CONNECTING_S", 0.5)
    with (
        pytest.raises(InputError, match=r"no scheduler answers[^§]*dask scheduler"),
        cluster_pool(scheduler="tcp://127.0.0.1:9"),
    ):
        pass
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"roomfit\[cluster\]"), cluster_pool():
        pass


class KilledWorker(Exception):  # noqa: N818 -- dask calls it so
    """What dask raises for a task whose workers died; known by its name."""


class Carried(Future[object]):
    """A future as dask's own: what it says of itself is known before its result is fetched."""

    fetched: BaseException | None = None

    @property
    def status(self) -> str:
        if self.cancelled():
            return "cancelled"
        return "finished" if self.exception() is None else "error"

    def result(self, timeout: float | None = None) -> object:
        if self.fetched is not None:
            raise self.fetched
        return super().result(timeout)


class Client:
    """Takes tasks as dask's client does, and ends each as the test says, the newest first."""

    def __init__(self, end: Callable[[Callable[[], object], Future[object]], None]) -> None:
        self.end = end
        self.threads = {"tcp://a": 1, "tcp://b": 1}
        self.sent: list[tuple[Callable[[], object], Future[object]]] = []
        self.futures: list[weakref.ref[Future[object]]] = []
        self.most = 0

    def submit(self, task: Callable[[], object], *, pure: bool) -> Future[object]:
        assert not pure
        future: Future[object] = Carried()
        self.sent.append((task, future))
        self.futures.append(weakref.ref(future))
        self.most = max(self.most, len(self.sent))
        threading.Timer(0.02, self.end_one).start()
        return future

    def end_one(self) -> None:
        self.end(*self.sent.pop())

    def nthreads(self) -> dict[str, int]:
        return self.threads


def done(task: Callable[[], object], future: Future[object]) -> None:
    future.set_result(task())


def test_a_cluster_is_handed_a_window_of_its_threads_which_grows_with_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """All tasks end, once; without the window, the client would have had 200 at once."""
    client = Client(done)
    pool = workers._ClusterExecutor(client)
    ends = completed(pool, (partial(int, n) for n in range(200)))
    found = [next(ends) for _ in range(100)]
    assert client.most <= 2 * workers.TASKS_A_THREAD
    client.threads = {f"tcp://{n}": 1 for n in range(20)}
    monkeypatch.setattr(workers, "_THREADS_FOR_S", 0.0)
    found += [next(ends) for _ in range(20)]
    assert client.most > 2 * workers.TASKS_A_THREAD
    found += ends
    assert client.most <= 20 * workers.TASKS_A_THREAD
    assert {number: future.result() for number, future in found} == {n: n for n in range(200)}


def test_nothing_of_a_task_that_has_ended_waits_for_the_collector() -> None:
    """What the scheduler keeps of a task goes with the client's future of it."""
    client = Client(done)
    pool = workers._ClusterExecutor(client)
    gc.disable()
    try:
        for _ in completed(pool, (partial(int, n) for n in range(100))):
            pass
        time.sleep(0.1)  # the last thread of the client
        assert not any(future() for future in client.futures)
    finally:
        gc.enable()


def test_tasks_that_were_given_up_are_tried_once_more_alone_after_all_others() -> None:
    """More of them than the window holds; none keeps another from being handed out."""
    log: list[tuple[int, int]] = []

    def end(task: Callable[[], object], future: Future[object]) -> None:
        number = int(str(task()))
        tries = sum(own == number for own, _ in log)
        log.append((number, len(client.sent)))  # how many others are there
        if number % 3 == 0 and (tries == 0 or number == 9):
            future.set_exception(KilledWorker())
        else:
            future.set_result(number)

    client = Client(end)
    pool = workers._ClusterExecutor(client)
    ends = dict(completed(pool, [partial(int, n) for n in range(60)]))
    assert {n for n, future in ends.items() if failure(future) is not None} == {9}
    assert {n for n, future in ends.items() if failure(future) is None} == {*range(60)} - {9}
    assert sorted(number for number, _ in log[:60]) == list(range(60))
    assert sorted(log[60:]) == [(n, 0) for n in range(0, 60, 3)]


def cancel(future: Future[object]) -> None:
    assert future.cancel()


def test_a_connection_that_is_lost_ends_every_task_and_says_so() -> None:
    client = Client(lambda _, future: cancel(future))
    pool = workers._ClusterExecutor(client)
    for _, future in completed(pool, [partial(int, n) for n in range(30)]):
        with pytest.raises(StoreError, match="connection to the scheduler is lost"):
            result_of(future)
    assert client.most <= 2 * workers.TASKS_A_THREAD


def test_a_result_that_is_lost_on_its_way_is_a_lost_connection_and_an_error_of_a_task_is_not() -> (
    None
):
    """Both are an OSError where the task read a file; dask says which by the future's status."""

    def end(task: Callable[[], object], future: Future[object]) -> None:
        number = int(str(task()))
        assert isinstance(future, Carried)
        if number % 3 == 0:
            future.fetched = ConnectionResetError("in <TCP (closed)>")
        if number % 3 == 1:
            future.set_exception(FileNotFoundError("walls.wav"))
        else:
            future.set_result(number)

    pool = workers._ClusterExecutor(Client(end))
    for number, future in completed(pool, [partial(int, n) for n in range(30)]):
        if number % 3 == 2:
            assert result_of(future) == number
            continue
        error = FileNotFoundError if number % 3 else StoreError
        with pytest.raises(error, match="walls" if number % 3 else "scheduler is lost"):
            result_of(future)


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


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    made = Cluster(tmp_path_factory.mktemp("cluster"))
    try:
        yield made
    finally:
        made.close()


@pytest.fixture
def pool(cluster: Cluster, monkeypatch: pytest.MonkeyPatch) -> Iterator[Executor]:
    monkeypatch.setattr(workers, "_CONNECTING_S", 120)
    with cluster_pool(scheduler=cluster.address) as executor:
        yield executor


def failure(future: Future[object]) -> str | None:
    """Why a task was not done."""
    try:
        result_of(future)
    except (InsufficientDataError, ValueError) as error:
        return str(error)
    return None


def content(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.glob("*.txt")}


@pytest.mark.slow
def test_a_worker_killed_in_the_middle_loses_nothing_and_alters_no_bit(
    pool: Executor, tmp_path: Path
) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    there.mkdir()
    for number in range(40):
        number_into(here, number)
    tasks = [partial(number_into, there, number, 0.1) for number in range(40)]
    killed = None
    for _, future in completed(pool, tasks):
        assert failure(future) is None
        if killed is None:
            killed = future.result()
            os.kill(killed, signal.SIGKILL)
    assert killed is not None
    assert content(there) == content(here)


@pytest.mark.slow
@pytest.mark.parametrize("n_workers", [4, 1])
def test_a_task_that_takes_its_worker_with_it_is_given_up_and_the_others_are_done(
    n_workers: int, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """One dies once and is done again; one dies always; one raises.

    With one worker all of them wait there while it dies, and dask gives all of them up.
    """
    tasks = [
        partial(die),
        partial(die_once, tmp_path, 1),
        partial(number_into, tmp_path, 2),
        partial(fail, "on purpose"),
    ]
    with ExitStack() as stack:
        if n_workers == 1:
            pool = stack.enter_context(cluster_pool())
        else:
            pool = request.getfixturevalue("pool")
        failures = {number: failure(future) for number, future in completed(pool, tasks)}
    assert "3 of them" in str(failures[0])
    assert failures[1] is None
    assert failures[2] is None
    assert failures[3] == "on purpose"
    assert set(content(tmp_path)) == {"1.txt", "2.txt"}


@pytest.mark.slow
def test_a_worker_that_runs_out_of_memory_is_replaced(pool: Executor, tmp_path: Path) -> None:
    tasks = [partial(fill_memory), *(partial(number_into, tmp_path, n) for n in range(8))]
    failures = {number: failure(future) for number, future in completed(pool, tasks)}
    assert "memory" in str(failures[0])
    assert [failures[n] for n in range(1, 9)] == [None] * 8
    assert len(content(tmp_path)) == 8


@pytest.mark.slow
def test_workers_of_another_version_are_refused(
    cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    def other(name: str) -> str:
        return "0.1" if name == "numba" else metadata.version(name)

    monkeypatch.setattr(workers, "version", other)  # of this process alone
    monkeypatch.setattr(workers, "_CONNECTING_S", 120)
    with (
        pytest.raises(InputError, match=r"runs other versions[^§]*numba 0\.1"),
        cluster_pool(scheduler=cluster.address),
    ):
        pass


@pytest.mark.slow
def test_a_scheduler_that_dies_is_reported_and_what_is_done_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workers, "_CONNECTING_S", 120)
    (tmp_path / "out").mkdir()
    made = Cluster(tmp_path, n_workers=1)
    try:
        tasks = [partial(number_into, tmp_path / "out", n, 0.3) for n in range(100)]
        n_done = 0
        with (
            pytest.raises(StoreError, match="connection to the scheduler is lost"),
            cluster_pool(scheduler=made.address) as executor,
        ):
            for _, future in completed(executor, tasks):
                assert failure(future) is None
                n_done += 1
                if n_done == 3:
                    made.scheduler.kill()
    finally:
        made.close()
    assert 3 <= n_done < 100
    assert len(content(tmp_path / "out")) >= n_done


@pytest.mark.slow
def test_an_own_cluster_listens_on_the_loopback_alone_and_ends_with_its_block(
    tmp_path: Path,
) -> None:
    psutil = pytest.importorskip("psutil")
    this = psutil.Process()
    before = {p.pid for p in this.children(recursive=True)}
    trimming = os.getenv("MALLOC_TRIM_THRESHOLD_")
    with cluster_pool(n_workers=2) as executor:
        family = [this, *(p for p in this.children(recursive=True) if p.pid not in before)]
        listening = [c for p in family for c in p.net_connections("inet") if c.status == "LISTEN"]
        assert {c.laddr.ip for c in listening} == {"127.0.0.1"}
        pids = in_pool(executor, [partial(number_into, tmp_path, n, 0.2) for n in range(10)])
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
def test_what_dask_itself_says_of_a_dead_scheduler_is_not_printed(tmp_path: Path) -> None:
    """One sentence of ours, and no traceback of a library."""
    program = (
        "import sys, pathlib\n"
        "from functools import partial\n"
        "from cluster_tasks import number_into\n"
        "from roomfit import workers\n"
        "from roomfit.errors import RoomfitError\n"
        "workers._CONNECTING_S = 120\n"
        "folder = pathlib.Path(sys.argv[2])\n"
        "tasks = [partial(number_into, folder, n, 0.3) for n in range(100)]\n"
        "try:\n"
        "    with workers.cluster_pool(scheduler=sys.argv[1]) as pool:\n"
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
