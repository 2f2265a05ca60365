"""Compiled kernels: loops in threads, and nothing compiled twice."""

from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from roomfit.base.kernels import in_threads, keep_one_blas_thread, kernel, one_blas_thread
from roomfit.base.typing import FloatArray


@kernel(allocates=False)
def _count(first: int, last: int, step: int, seen: FloatArray) -> None:
    for i in range(first, last):
        seen[i] += step * i


@pytest.mark.parametrize("worth_it", [True, False])
@pytest.mark.parametrize("n", [0, 1, 2, 7, 1000])
def test_threads_take_every_step_once(n, worth_it):
    seen = np.zeros(n)
    in_threads(_count, n, 3, seen, worth_it=worth_it)
    assert seen.tolist() == [3 * i for i in range(n)]


def blas_threads() -> set[int]:
    return {p["num_threads"] for p in threadpool_info() if p["user_api"] == "blas"}


_ORDERS = pytest.mark.skipif(not blas_threads(), reason="a BLAS that takes no orders")


@one_blas_thread
def inside(scale: float) -> tuple[set[int], float]:
    """Return the threads and a product that they made."""
    return blas_threads(), float(scale * np.ones(3) @ np.ones(3))


@_ORDERS
def test_linear_algebra_has_one_thread_inside_and_its_own_afterwards():
    with threadpool_limits(limits=2, user_api="blas"):
        assert blas_threads() == {2}
        assert inside(2.0) == ({1}, 6.0)
        assert blas_threads() == {2}


@_ORDERS
def test_a_worker_keeps_one_thread():
    with threadpool_limits(limits=2, user_api="blas"):
        keep_one_blas_thread()
        assert blas_threads() == {1}
