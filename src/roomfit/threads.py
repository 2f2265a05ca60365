"""One thread for linear algebra, so that it and the compiled kernels do not wait for each other."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

P = ParamSpec("P")
R = TypeVar("R")


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that runs with one thread for linear algebra.

    Its matrices are small. On two cores, BLAS's threads and those of the compiled kernels, both
    waiting in loops, took 41 s for what takes 25 s with one of BLAS, and 31 s without any. It also
    makes sums the same on machines of any number of cores.
    """

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited


def keep_one_blas_thread() -> None:
    """Give linear algebra one thread in this process from now on."""
    threadpool_limits(limits=1, user_api="blas")
