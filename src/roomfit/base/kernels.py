"""Compiled kernels, and the threads that run them.

Every kernel is compiled under the same rules, and linear algebra keeps to one thread so that it and
the kernels do not wait for each other.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise
from typing import Any, ParamSpec, TypeVar, cast

import numba
from numba.core.types import unliteral
from threadpoolctl import threadpool_limits

from roomfit.base.errors import InputError

P = ParamSpec("P")
R = TypeVar("R")

_THREADS = "ROOMFIT_THREADS"


def kernel(
    *, allocates: bool = True, inlined: bool = False
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Compile a module-level function with numba and keep the machine code on disk.

    Strict IEEE arithmetic in float64 and no fast-math, so that the same input gives the same bits
    on every run. It is compiled once for each type of its arguments; a number written into a call
    is not, as it is for numba by itself, one of its own.

    `allocates`: whether the function, or one that it calls, makes arrays. Where none does, False
    spares the counting of references, which costs more than a short function that takes tuples of
    arrays. `inlined`: whether the function is copied into each function that calls it. Every array
    of a tuple is handed over as seven numbers or more, so that a call can cost as much as its work.
    """

    options: dict[str, Any] = {
        "cache": True,
        "nogil": True,
        "error_model": "numpy",
        "fastmath": False,
        "_nrt": allocates,
        "no_cfunc_wrapper": True,
        "forceinline": inlined,
    }

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        made = numba.njit(**options)(function)
        typed = made.get_call_template
        made.get_call_template = lambda given, named: typed([*map(unliteral, given)], named)
        return cast(Callable[P, R], made)

    return decorate


def in_threads(
    loop: Callable[..., None], n: int, *arguments: object, worth_it: bool = True
) -> None:
    """Call a compiled ``loop(begin, end, *arguments)`` for parts of 0 to n, one in each thread.

    It must write what belongs to each step to its own place and never sum across steps: the bits
    are then the same for any number of threads, and for none where they are not worth it. To start
    one takes a tenth of a millisecond. numba's own parallel loops take seconds to compile.
    """
    n_parts = max(min(numba.get_num_threads(), n), 1) if worth_it else 1
    if n_parts == 1:
        loop(0, n, *arguments)
        return
    ends = [n * i // n_parts for i in range(n_parts + 1)]
    with ThreadPoolExecutor(n_parts) as pool:
        others = [pool.submit(loop, a, b, *arguments) for a, b in pairwise(ends[1:])]
        loop(0, ends[1], *arguments)
        for other in others:
            other.result()


def each_in_threads(function: Callable[[int], R], n: int, *, worth_it: bool = True) -> list[R]:
    """Return what a function makes of 0 to n - 1, in as many threads as kernels may have.

    For functions that spend their time in kernels, which let other threads run; each has one.
    """
    n_threads = min(numba.get_num_threads(), n) if worth_it else 1
    if n_threads < 2:
        return [function(i) for i in range(n)]
    with ThreadPoolExecutor(n_threads, initializer=numba.set_num_threads, initargs=(1,)) as pool:
        return list(pool.map(function, range(n)))


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


@contextmanager
def at_most_threads(wanted: int | None = None) -> Iterator[None]:
    """Let kernels called from this thread, and copies of this process, take so many cores.

    `wanted`: 1 or more, of which there are no more than the machine has. Left out: as the variable
    ``ROOMFIT_THREADS`` of the environment says; without it, as it is.
    """
    most: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
    said = os.environ.get(_THREADS, "") if wanted is None else str(wanted)
    if said and not (said.isascii() and said.isdigit() and int(said) > 0):
        what = "the number of threads is no whole number from 1 up"
        needed = f"1 to {most}, the cores of this machine"
        hint = "leave it out, and all cores are used"
        raise InputError(
            what, where=f"{_THREADS} in the environment", found=repr(said), needed=needed, hint=hint
        )
    before = numba.get_num_threads()
    numba.set_num_threads(min(int(said or before), most))
    try:
        yield
    finally:
        numba.set_num_threads(before)
