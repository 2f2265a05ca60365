"""Processes that carry out tasks: of this machine, over pipes, or those of a running dask cluster.

A task is a `functools.partial` of a function at module level. It leaves its results in files that
are written whole, so that doing one twice is harmless, and returns little: nothing large travels
between processes. What it returns or raises comes back as its end.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import sys
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from importlib.metadata import version
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

from roomfit.base.errors import InputError, InsufficientDataError, RoomfitError, StoreError
from roomfit.base.forks import end_with_parent, interrupts_deferred

_LOG, _NOTICE = logging.getLogger("roomfit"), 25

Task = Callable[[], object]
_CONNECTING_S = 20
# A task that has taken so many workers with it is not given to another.
_MOST_DEATHS = 3
# A room takes 310 to 370 MB.
LEAST_MEMORY_BYTES = 400_000_000


def in_processes(
    tasks: Iterable[Task], n_workers: int, warm: Task | None = None
) -> Iterator[tuple[int, Any]]:
    """Yield the number and the end of each task as it ends, so many at once.

    Each has a process of its own, since libraries do not give memory back, and a pipe to it, which
    nobody else can reach. All end with the iterator. A task whose process dies begins again, three
    times in all. `warm`: done once before the others: compiles what is kept on disk.
    """
    each_bytes = _memory_bytes() // n_workers
    if 0 < each_bytes < LEAST_MEMORY_BYTES:
        what, where = "a worker has too little memory for a room", f"--workers {n_workers}"
        found, hint = f"{1e-6 * each_bytes:.0f} MB for each", "fewer workers leave more for each"
        needed = f"{1e-6 * LEAST_MEMORY_BYTES:.0f} MB: a room takes 310 to 370"
        raise InputError(what, where=where, found=found, needed=needed, hint=hint)
    if warm is not None:
        _LOG.log(_NOTICE, "%d workers, each with up to %.1f GB", n_workers, 1e-9 * each_bytes)
        list(in_processes([warm], 1))  # where it fails, rooms say why
    waiting, deaths = deque(enumerate(tasks)), Counter[int]()
    busy: dict[Any, tuple[BaseProcess, int, Task]] = {}
    try:
        while waiting or busy:
            while waiting and len(busy) < n_workers:
                number, task = waiting.popleft()
                process, receiving = _started(task)
                busy[receiving] = process, number, task
            for pipe in list[Any](wait([*busy])):
                process, number, task = busy.pop(pipe)
                try:
                    yield number, pipe.recv()
                except (EOFError, OSError):
                    deaths[number] += 1
                    if deaths[number] < _MOST_DEATHS:
                        waiting.append((number, task))
                    else:
                        yield number, _all_died(_MOST_DEATHS)
                process.join()
    finally:
        for process, *_ in busy.values():
            process.kill()
            process.join()


def _started(task: Task) -> tuple[BaseProcess, Connection]:
    """Return a process that carries out a task, without interrupts, and what its end comes by."""
    context = multiprocessing.get_context("spawn")
    receiving, sending = context.Pipe(duplex=False)
    process = context.Process(target=_carry_out, args=(task, sending, os.getpid()), daemon=True)
    with interrupts_deferred():
        process.start()
    sending.close()
    return process, receiving


def _carry_out(task: Task, sending: Connection, parent: int) -> None:
    """Send what a task returns or raises, in a process of its own."""
    end_with_parent(parent)
    try:
        end = task()
    except Exception as error:  # noqa: BLE001 -- the end of this task, and of no other
        end = error
    sending.send(end)


def _memory_bytes() -> int:
    """Return the memory of this machine; 0 where the system does not say."""
    with suppress(AttributeError, OSError, ValueError):
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return 0


def _all_died(deaths: int) -> RoomfitError:
    what = "every worker that had the task died"
    hint = "memory is the usual reason: fewer workers on a machine leave more for each"
    return InsufficientDataError(what, found=f"{deaths} of them", hint=hint)


def on_cluster(
    tasks: Iterable[Task], scheduler: str, warm: Task | None = None
) -> Iterator[tuple[int, Any]]:
    """Yield the number and the end of each task as it ends, carried out by a running dask cluster.

    A task whose worker dies is given to another as dask's own configuration has it
    (``distributed.scheduler.allowed-failures``, three times), and then alone as often. That
    configuration holds (``distributed.comm.tls``), as files or as variables of the environment.

    `scheduler`: its address, as ``tcp://10.0.0.1:8786`` or ``tls://...``. `warm`: called once on
    each machine before the first task: compiles what is kept on disk.
    """
    with _client(scheduler) as client:
        _check_alike(client, scheduler)
        if warm is not None:
            found = client.scheduler_info(n_workers=-1)["workers"]
            one_a_machine = {worker["host"]: address for address, worker in found.items()}
            # one that dies meanwhile is started again, and compiles with its first task
            client.run(warm, workers=list(one_a_machine.values()), on_error="return")
        yield from _completed(client, tasks)


def _completed(client: Any, tasks: Iterable[Task]) -> Iterator[tuple[int, Any]]:
    """Yield the number and the end of each task as it ends; those that wait end with the iterator.

    Dask blames a worker's death on every task that was given to it, those that only waited there
    included: a task given up for it is tried once more.
    """
    running = {client.submit(task, pure=False): (n, task, False) for n, task in enumerate(tasks)}
    ends = _distributed().as_completed([*running], loop=client.loop)
    try:
        for future in ends:
            number, task, is_second = running.pop(future)
            end = _end_of(future)
            if isinstance(end, InsufficientDataError) and not is_second:
                again = client.submit(task, pure=False)
                running[again] = number, task, True
                ends.add(again)
            else:
                yield number, end
    except (CancelledError, OSError) as error:  # also of dask itself, when its scheduler is gone
        what = "the connection to the scheduler is lost"
        hint = "run the same command again: what is done is not done again"
        raise StoreError(what, found="tasks were cancelled", hint=hint) from error
    finally:
        with suppress(Exception):
            client.cancel([*running])


def _end_of(future: Any) -> Any:
    """Return what a task returned, or the error that it raised."""
    error = future.exception() if future.status == "error" else None
    if type(error).__name__ == "KilledWorker":  # all workers that had it
        return _all_died(getattr(error, "allowed_failures", _MOST_DEATHS - 1) + 1)
    return error or future.result()


@contextmanager
def _client(scheduler: str) -> Iterator[Any]:
    """Give a client of a running dask cluster; whatever ends a task is reported by us alone."""
    distributed = _distributed()
    with ExitStack() as stack:
        for handler in logging.getLogger("distributed").handlers:
            stack.callback(handler.setLevel, handler.level)
            handler.setLevel(logging.CRITICAL + 1)
        for logger in map(logging.getLogger, ("tornado.application", "asyncio")):
            stack.callback(setattr, logger, "disabled", logger.disabled)
            logger.disabled = True
        try:
            client = distributed.Client(scheduler, timeout=_CONNECTING_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(
                "no scheduler answers",
                where=scheduler,
                found=" ".join(str(error).split())[:200],
                needed="the address of a running dask scheduler, as tcp://10.0.0.1:8786",
                hint="start one with: dask scheduler --host 127.0.0.1",
            ) from error
        yield stack.enter_context(client)


def _distributed() -> Any:
    try:
        return import_module("distributed")
    except ImportError as error:
        what = "a cluster needs a package that is not installed"
        hint = "pip install 'roomfit[cluster]'"
        raise InputError(what, found=str(error), needed="dask.distributed", hint=hint) from error


def about_this_process() -> dict[str, str]:
    """Return the versions that decide numbers."""
    names = ("roomfit", "numba", "numpy", "scipy")
    python = ".".join(map(str, sys.version_info[:2]))
    return {"Python": python, **{name: version(name) for name in names}}


def _check_alike(client: Any, scheduler: str) -> None:
    """Refuse workers whose answers may differ from those of this process."""
    try:
        # those of a job array come one by one: the first are enough to begin
        client.wait_for_workers(1, timeout=_CONNECTING_S)
    except TimeoutError:
        raise InputError(
            "the scheduler has no workers",
            where=scheduler,
            found="none within the time it was waited for",
            needed="one worker or more",
            hint="start one on every machine: dask worker ADDRESS --nthreads 1 --nworkers N",
        ) from None
    here = about_this_process()
    for address, own in client.run(about_this_process, on_error="return").items():
        there = own if isinstance(own, dict) else {}  # else it cannot load roomfit
        other = [name for name in here if there.get(name) != here[name]]
        if other:
            raise InputError(
                "a worker runs other versions than this process",
                where=str(address),
                found=", ".join(f"{name} {there.get(name, 'missing')}" for name in other),
                needed=", ".join(f"{name} {here[name]}" for name in other),
                hint="install the same on both sides; answers would depend on who computed them",
            )
