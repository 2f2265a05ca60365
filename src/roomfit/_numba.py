"""Compiled kernels, and the threads that run them.

Every kernel is compiled under the same rules, and linear algebra keeps to one thread so that it and
the kernels do not wait for each other.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numba
from threadpoolctl import threadpool_limits

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
