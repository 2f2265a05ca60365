"""Compiled kernels, and the threads and processes that run them.

Every kernel is compiled under the same rules, linear algebra keeps to one thread so that it and the
kernels do not wait for each other, and work spread over processes stops cleanly.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import active_children, get_context
from typing import Any, ParamSpec, TypeVar, cast

import numba
from threadpoolctl import threadpool_limits

from roomfit.errors import InputError
from roomfit.typing import Progress

P = ParamSpec("P")
R = TypeVar("R")


def kernel(
    *, parallel: bool = False, allocates: bool = True, inlined: bool = False
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Compile a module-level function with numba and keep the machine code on disk.

    Strict IEEE arithmetic in float64 and no fast-math, so that the same input gives the same bits
    on every run and for any number of threads. A parallel kernel must write each thread's result
    to its own place and never sum across threads.

    Parameters
    ----------
    parallel : bool
        Whether `numba.prange` loops are spread over threads.
    allocates : bool
        Whether the function, or one that it calls, makes arrays. Where none does, False spares the
        counting of references, which costs more than a short function that takes tuples of arrays.
    inlined : bool
        Whether the function is copied into each function that calls it. Every array of a tuple is
        handed over as seven numbers or more, so that a call can cost as much as its work.
    """

    options: dict[str, Any] = {
        "cache": True,
        "nogil": True,
        "error_model": "numpy",
        "parallel": parallel,
        "fastmath": False,
        "_nrt": allocates,
        "forceinline": inlined,
    }

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        return cast(Callable[P, R], numba.njit(**options)(function))

    return decorate


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that runs with one thread for linear algebra.

    Its matrices are small. On two cores, BLAS's threads and those of the compiled kernels, both
    waiting in loops, took 41 s for what takes 25 s with one of BLAS, and 31 s without any. It also
    makes sums the same on machines of any number of cores.
    """

    limited: Callable[P, R] = threadpool_limits.wrap(limits=1, user_api="blas")(function)
    return limited


def keep_one_blas_thread() -> None:
    """Give linear algebra one thread in this process from now on."""
    threadpool_limits(limits=1, user_api="blas")


T = TypeVar("T")


@contextmanager
def worker_pool(n_workers: int) -> Iterator[Executor]:
    """Give an executor with so many processes; 1 stays in this process.

    When the block is left early, tasks that have not started are dropped and running ones are
    waited for, so that nothing is left behind; an interrupt ends running ones as well.

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
    others = set(active_children())
    try:
        yield pool
    except KeyboardInterrupt:
        # Running tasks may be ended: what they write is moved to its place only when it is whole.
        # A worker that was just starting is not among the pool's own yet, and would be waited for
        # without end.
        for worker in set(active_children()) - others:
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
    with _interrupts_deferred():
        futures = [pool.submit(task) for task in tasks]
    for done, future in enumerate(as_completed(futures), start=1):
        future.result()
        if progress is not None:
            progress(done / len(futures))
    return [future.result() for future in futures]


@contextmanager
def _interrupts_deferred() -> Iterator[None]:
    """Hold interrupts until the block ends; processes that start within it never get any.

    Control-C reaches the whole group, also workers that still load and would print a traceback.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _become_worker() -> None:
    # an interrupt reaches the whole group; only the parent decides what happens then
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    keep_one_blas_thread()
    numba.set_num_threads(1)
