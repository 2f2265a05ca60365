"""Work spread over processes, each with one thread, that stops cleanly."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from typing import TypeVar

from roomfit.errors import InputError
from roomfit.threads import keep_one_blas_thread
from roomfit.typing import Progress

T = TypeVar("T")


@contextmanager
def worker_pool(n_workers: int) -> Iterator[Executor]:
    """Give an executor with so many processes; 1 stays in this process.

    When the block is left early, tasks that have not begun are dropped and those that run are
    waited for, so that nothing is left behind; an interrupt ends those that run as well.

    Notes
    -----
    Processes are spawned, not forked, because compiled threads do not survive a fork. A script
    that asks for more than one must therefore guard its main part with
    ``if __name__ == "__main__":``.
    """
    if n_workers < 1:
        raise InputError("number of workers is out of range", found=str(n_workers), needed="1 up")
    pool: Executor
    if n_workers == 1:
        pool = ThreadPoolExecutor(1)
    else:
        pool = ProcessPoolExecutor(
            n_workers, mp_context=get_context("spawn"), initializer=_become_worker
        )
    try:
        yield pool
    except KeyboardInterrupt:
        # nobody waits for what runs now; what tasks write is put in its place when it is whole
        for worker in list((getattr(pool, "_processes", None) or {}).values()):
            worker.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def in_pool(
    pool: Executor, tasks: Sequence[Callable[[], T]], progress: Progress | None = None
) -> list[T]:
    """Return the results of all tasks in their order; the first failure ends the wait.

    With processes, a task is a `functools.partial` of a function at module level.
    """
    futures = [pool.submit(task) for task in tasks]
    for done, future in enumerate(as_completed(futures), start=1):
        future.result()
        if progress is not None:
            progress(done / len(futures))
    return [future.result() for future in futures]


def _become_worker() -> None:
    # an interrupt reaches the whole group; only the parent decides what happens then
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    keep_one_blas_thread()
    import numba

    numba.set_num_threads(1)
