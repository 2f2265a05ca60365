"""Processes of a dask cluster that carry out tasks: its own, on this machine, or a running one.

A task is a `functools.partial` of a function at module level. It leaves its results in files that
are written whole, so that doing one twice is harmless, and returns little: nothing large travels
between processes.
"""

from __future__ import annotations

import asyncio
import logging
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from importlib import import_module
from importlib.metadata import version
from itertools import islice
from multiprocessing import resource_tracker
from typing import Any

from roomfit.base.errors import InputError, InsufficientDataError, StoreError
from roomfit.base.forks import end_with_parent, interrupts_deferred

_LOG, _NOTICE = logging.getLogger("roomfit"), 25

# In the hands of the scheduler at once, for each thread of its workers: what waits costs it memory,
# and so many keep a thread busy until others are handed on.
TASKS_A_THREAD = 4
_CONNECTING_S = 20
# What a worker of the own cluster is given to end by itself.
_ENDING_S = 0.5
# Memory that libraries do not give back goes with the process.
_LIFETIME_S = 3600
# A task that has taken so many workers with it is not given to another.
_MOST_DEATHS = 2
# A room takes 310 to 370 MB, and dask ends a worker at 95 % of its limit.
LEAST_MEMORY_BYTES = 400_000_000
# After so long without an end of a task, a message names who is waited for.
_SILENCE_S = 60.0
_OWN_CLUSTER: Mapping[str, object] = {
    "distributed.scheduler.allowed-failures": _MOST_DEATHS,
    # a task that waits at a worker would be blamed for its death, too
    "distributed.scheduler.worker-saturation": 1.0,
    # dask's 64 kB gives every array back to the system: two million page faults and half as much
    # time again for a room
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
    # a hundred interruptions a second, for a page that nobody looks at
    "distributed.worker.profile.enabled": False,
    # a worker that dies is always started again; if it was just starting so long after a death,
    # dask would take it for lost
    "distributed.deploy.lost-worker-timeout": "365 days",
    # a worker that pauses for want of memory waits for ever, since its only task holds it: it is
    # ended at 95 %, and its task given to another
    "distributed.worker.memory.pause": False,
    "distributed.worker.preload": ["roomfit.batch.cluster"],
}


def dask_setup(_: object) -> None:
    """Prepare a worker of dask's own cluster on this machine, which loads this module first."""
    end_with_parent()


def completed(client: Any, tasks: Iterable[Callable[[], object]]) -> Iterator[tuple[int, Any]]:
    """Yield the number and dask's future of each task as it ends.

    Tasks are taken from their iterable as others end, so that at most `TASKS_A_THREAD` for each
    thread of the workers are submitted and not yet yielded. When the iterator is closed, those that
    wait are dropped. After a minute in which none ends, a message says so.

    Dask blames a worker's death on every task that was given to it, those that only waited there
    included. A task given up for it is therefore tried once more when no other is left that could
    be the cause.
    """
    distributed = _distributed()
    waiting = enumerate(tasks)
    running: dict[Any, tuple[int, Callable[[], object]]] = {}
    given_up: deque[tuple[int, Callable[[], object]]] = deque()
    since, alone = time.strftime("%H:%M:%S"), False
    try:
        while True:
            n_threads = max(1, sum(client.nthreads().values()))
            for number, task in islice(waiting, max(0, TASKS_A_THREAD * n_threads - len(running))):
                running[client.submit(task, pure=False)] = number, task
            alone = alone or not running
            if given_up and not running:
                number, task = given_up.popleft()
                running[client.submit(task, pure=False)] = number, task
            if not running:
                return
            try:
                with client.as_current():
                    done, _ = distributed.wait([*running], _SILENCE_S, "FIRST_COMPLETED")
            except TimeoutError:
                _LOG.log(_NOTICE, "waiting for %d tasks since %s", len(running), since)
                continue
            since = time.strftime("%H:%M:%S")
            for future in done:
                number, task = running.pop(future)
                if not alone and _died(future):
                    given_up.append((number, task))
                else:
                    yield number, future
    except (CancelledError, OSError) as error:  # also of dask itself, when its scheduler is gone
        what = "the connection to the scheduler is lost"
        hint = "run the same command again: what is done is not done again"
        raise StoreError(what, found="tasks were cancelled", hint=hint) from error
    finally:
        with suppress(Exception):
            client.cancel([*running])


def _died(future: Any) -> bool:
    """Whether all workers that had a task have died."""
    return future.status == "error" and type(future.exception()).__name__ == "KilledWorker"


def result_of(future: Any) -> Any:
    """Return what a task returned, or raise what it raised."""
    if _died(future):
        deaths = getattr(future.exception(), "allowed_failures", _MOST_DEATHS) + 1
        what = "every worker that had the task died"
        hint = "memory is the usual reason: fewer workers on a machine leave more for each"
        raise InsufficientDataError(what, found=f"{deaths} of them", hint=hint)
    return future.result()


@contextmanager
def cluster_client(
    *, scheduler: str | None = None, n_workers: int = 1, warm: Callable[[], object] | None = None
) -> Iterator[Any]:
    """Give a client of dask, for `completed`.

    A task whose worker dies is given to another, up to three times, and then alone as often. Dask's
    own configuration (``distributed.comm.tls``, ``distributed.scheduler.allowed-failures``) holds,
    as files or as variables of the environment.

    `scheduler`: address of a running scheduler, as ``tcp://10.0.0.1:8786`` or ``tls://...``.
    Without it, a cluster of processes on this machine is started, which listens on the loopback
    alone and ends with the block. `n_workers`: processes of that own cluster, one thread each,
    renewed every hour. `warm`: called once on each machine before the first task: compiles what is
    kept on disk.
    """
    if n_workers < 1:
        what, hint = "number of workers is out of range", "give the number of cores"
        raise InputError(what, found=str(n_workers), needed="1 or more", hint=hint)
    distributed = _distributed()
    with _without_dasks_messages(), ExitStack() as stack:
        address = scheduler if scheduler is not None else _own_cluster(stack, n_workers)
        try:
            client = stack.enter_context(
                distributed.Client(address, timeout=_CONNECTING_S, set_as_default=False)
            )
        except (OSError, ValueError) as error:
            raise InputError(
                "no scheduler answers",
                where=str(scheduler),
                found=" ".join(str(error).split())[:200],
                needed="the address of a running dask scheduler, as tcp://10.0.0.1:8786",
                hint="start one with: dask scheduler --host 127.0.0.1",
            ) from error
        if scheduler is None:
            # dask cannot end workers that are just starting
            wait_for_all = partial(client.wait_for_workers, n_workers, timeout=_CONNECTING_S)
            stack.callback(_quietly, wait_for_all)
        _check_alike(client, scheduler)
        if warm is not None:
            found = client.scheduler_info(n_workers=-1)["workers"]
            one_a_machine = {worker["host"]: address for address, worker in found.items()}
            client.run(warm, workers=list(one_a_machine.values()))
        yield client


def _distributed() -> Any:
    try:
        return import_module("distributed")
    except ImportError as error:
        what = "a cluster needs a package that is not installed"
        hint = "pip install 'roomfit[cluster]'"
        raise InputError(what, found=str(error), needed="dask.distributed", hint=hint) from error


@contextmanager
def _without_dasks_messages() -> Iterator[None]:
    """Leave out what dask itself logs in this process: whatever ends a task is reported by us."""
    handlers = logging.getLogger("distributed").handlers
    others = [logging.getLogger(name) for name in ("tornado.application", "asyncio")]
    before = [h.level for h in handlers], [logger.disabled for logger in others]
    for handler in handlers:
        handler.setLevel(logging.CRITICAL + 1)
    for logger in others:
        logger.disabled = True
    try:
        yield
    finally:
        for handler, level in zip(handlers, before[0], strict=True):
            handler.setLevel(level)
        for logger, was in zip(others, before[1], strict=True):
            logger.disabled = was


def _own_cluster(stack: ExitStack, n_workers: int) -> Any:
    """Return a cluster of processes on this machine that ends with a stack."""
    import dask
    from distributed.system import MEMORY_LIMIT

    each_bytes = int(MEMORY_LIMIT / n_workers)
    check_memory(each_bytes, f"--workers {n_workers}", "fewer workers leave more for each")
    message = "%d workers, each with up to %.1f GB of this machine's memory"
    _LOG.log(_NOTICE, message, n_workers, 1e-9 * each_bytes)
    stack.enter_context(dask.config.set(dict(_OWN_CLUSTER)))
    # the thread that starts workers, now and after deaths, is made here and passes on that it gets
    # no interrupts; it would get them again if it were the first to start this tracker
    resource_tracker.ensure_running()
    of_each = ("NUMBA", "OMP", "OPENBLAS", "MKL")
    with interrupts_deferred():
        cluster = _distributed().LocalCluster(
            n_workers=n_workers,
            memory_limit=each_bytes,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            # without an address its web server would listen to the whole network
            dashboard_address="127.0.0.1:0",
            env={f"{name}_NUM_THREADS": "1" for name in of_each},
            lifetime=f"{_LIFETIME_S} seconds",
            lifetime_stagger=f"{_LIFETIME_S // 10} seconds",
            lifetime_restart=True,
            silence_logs=50,  # a worker that dies is reported by us
        )
    stack.callback(_quietly, cluster.close)
    stack.callback(_quietly, partial(cluster.sync, _ended_at_once, cluster))
    return cluster


async def _ended_at_once(cluster: Any) -> None:
    """End workers whatever they are doing, which dask by itself waits four seconds for."""
    await asyncio.gather(*(nanny.close(timeout=_ENDING_S) for nanny in cluster.workers.values()))


def _quietly(end: Callable[[], object]) -> None:
    """Dask's book of workers may be in disorder after deaths, and fail; all results are there."""
    with suppress(Exception):
        end()


def check_memory(limit_bytes: int, where: str, hint: str) -> None:
    """Refuse a worker whose limit of memory is below what a room takes; 0 is no limit."""
    if 0 < limit_bytes < LEAST_MEMORY_BYTES:
        what = "a worker has too little memory for a room"
        found = f"{1e-6 * limit_bytes:.0f} MB for each worker"
        needed = f"{1e-6 * LEAST_MEMORY_BYTES:.0f} MB: a room takes 310 to 370"
        raise InputError(what, where=where, found=found, needed=needed, hint=hint)


def about_this_process() -> dict[str, str]:
    """Return the versions that decide numbers."""
    names = ("roomfit", "numba", "numpy", "scipy")
    python = ".".join(map(str, sys.version_info[:2]))
    return {"Python": python, **{name: version(name) for name in names}}


def _check_alike(client: Any, scheduler: str | None) -> None:
    """Refuse workers whose answers may differ from those of this process."""
    try:
        # those of a job array come one by one: the first are enough to begin
        client.wait_for_workers(1, timeout=_CONNECTING_S)
    except TimeoutError:
        raise InputError(
            "the scheduler has no workers",
            where=str(scheduler),
            found="none within the time it was waited for",
            needed="one worker or more",
            hint="start one on every machine: dask worker ADDRESS --nthreads 1 --nworkers N",
        ) from None
    try:
        found = client.run(about_this_process)
    except Exception as error:
        raise InputError(
            "the workers cannot load roomfit",
            where=str(scheduler),
            found=f"{type(error).__name__}: {error}"[:200],
            needed="the same roomfit on every worker as here",
            hint="install it in the workers' environment",
        ) from error
    if scheduler is not None:
        for address, own in client.scheduler_info(n_workers=-1)["workers"].items():
            hint = "start it with more: dask worker ADDRESS --memory-limit 2GB"
            check_memory(int(own.get("memory_limit") or 0), str(address), hint)
    here = about_this_process()
    for address, there in found.items():
        other = [name for name in here if there.get(name) != here[name]]
        if other:
            raise InputError(
                "a worker runs other versions than this process",
                where=str(address),
                found=", ".join(f"{name} {there.get(name, 'missing')}" for name in other),
                needed=", ".join(f"{name} {here[name]}" for name in other),
                hint="install the same on both sides; answers would depend on who computed them",
            )
