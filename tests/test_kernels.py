"""Compiled kernels: loops in threads, and nothing compiled twice."""

from __future__ import annotations

import os
import subprocess
import sys

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


PROGRAM = """
from dataclasses import replace

import numpy as np

from roomfit.room import inside
from roomfit.materials.priors import uniform_scattering
from roomfit.room.scene import scene_of, shoebox_room
from roomfit.tracing import enclosure, rays
from roomfit.tracing.trace import TraceSettings, trace

room = shoebox_room((20.0, 15.0, 6.0), "plaster")
leaning = np.array([[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])  # a box needs no rays
enclosure.reached(replace(room.mesh, vertices_m=room.mesh.vertices_m @ leaning))
receivers = {f"R{i}": (4.0 + i, 3.0, 1.5) for i in range(12)}
scene = scene_of(room, {"S": (1.0, 1.0, 1.5)}, receivers)
settings = TraceSettings(duration_s=0.1, n_rays=500, image_order=1)
trace(scene, settings, uniform_scattering(("plaster",), 0.3))
for module in (enclosure, inside, rays):
    for name, found in vars(module).items():
        print(name, len(getattr(found, "signatures", ())))
"""


@pytest.mark.slow
def test_no_kernel_is_compiled_twice_for_a_trace(tmp_path):
    """int32 beside int64 compiles all that follows again."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)},
    )
    times = {name: int(n) for name, n in (line.split() for line in done.stdout.splitlines())}
    assert sum(n == 1 for n in times.values()) >= 10
    assert {name for name, n in times.items() if n > 1} == set()


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
