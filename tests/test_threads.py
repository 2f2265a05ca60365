"""Linear algebra with one thread where compiled kernels have theirs."""

from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from roomfit.base.kernels import keep_one_blas_thread, one_blas_thread


def blas_threads() -> set[int]:
    return {p["num_threads"] for p in threadpool_info() if p["user_api"] == "blas"}


pytestmark = pytest.mark.skipif(not blas_threads(), reason="a BLAS that takes no orders")


@one_blas_thread
def inside(scale: float) -> tuple[set[int], float]:
    """Return the threads and a product that they made."""
    return blas_threads(), float(scale * np.ones(3) @ np.ones(3))


def test_linear_algebra_has_one_thread_inside_and_its_own_afterwards():
    with threadpool_limits(limits=2, user_api="blas"):
        assert blas_threads() == {2}
        assert inside(2.0) == ({1}, 6.0)
        assert blas_threads() == {2}


def test_a_worker_keeps_one_thread():
    with threadpool_limits(limits=2, user_api="blas"):
        keep_one_blas_thread()
        assert blas_threads() == {1}
