"""One typed door to numba, so that every kernel is compiled under the same rules."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numba

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
