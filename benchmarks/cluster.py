"""What an engine for many rooms costs and gains: speed-up, overhead of a task, and where it ends.

    python benchmarks/cluster.py [--rooms 8] [--tasks 2000] [--sleepers 200]

Needs the extra cluster and as many idle cores as there are workers (two).
"""

from __future__ import annotations

import argparse
import tempfile
import time
from concurrent.futures import Executor
from functools import partial
from pathlib import Path

import numpy as np

from roomfit.base.workers import cluster_pool, completed, result_of
from roomfit.batch.rooms import identify_rooms
from roomfit.demo.boxes import demo_plan, write_measured_box
from roomfit.identify import compile_kernels

WORKERS = 2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rooms", type=int, default=8)
    parser.add_argument("--tasks", type=int, default=2000)
    parser.add_argument("--sleepers", type=int, default=200)
    wanted = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        campaigns = [written(folder / f"room {n}", n) for n in range(wanted.rooms)]
        compile_kernels()
        here_s = rooms_s(campaigns, folder / "here")
        print(f"{wanted.rooms} rooms in this process, its kernels on all cores: {here_s:.1f} s")
        with cluster_pool(n_workers=1, warm=compile_kernels) as pool:
            alone_s = rooms_s(campaigns, folder / "one", pool)
        print(f"one worker: {alone_s:.1f} s")
        with cluster_pool(n_workers=WORKERS, warm=compile_kernels) as pool:
            together_s = rooms_s(campaigns, folder / "two", pool)
            print(
                f"{WORKERS} workers: {together_s:.1f} s, {alone_s / together_s:.2f} times as fast "
                f"as one, {here_s / together_s:.2f} times as fast as this process"
            )
            each_s = duration_s(pool, wanted.tasks, 0.0) / wanted.tasks
        task_s = alone_s / wanted.rooms
        print(
            f"overhead of a task: {1e3 * each_s:.1f} ms, {100 * each_s / task_s:.2f} % of a room, "
            f"{100 * each_s / 5.0:.2f} % of the shortest bundle (5 s)"
        )
    with cluster_pool(n_workers=1) as pool:
        sleeping_s = duration_s(pool, wanted.sleepers, 0.02)
        print(
            f"{wanted.sleepers} tasks of 20 ms by one worker: "
            f"{100 * (sleeping_s / (0.02 * wanted.sleepers) - 1.0):.0f} % more than their sum"
        )
    print(
        f"on paper: one scheduler hands out {1.0 / each_s:.0f} tasks/s, so that it keeps "
        f"{5.0 / each_s:.0f} workers busy with bundles of 5 s and {task_s / each_s:.0f} with rooms"
    )


def rooms_s(campaigns: list[Path], folder: Path, pool: Executor | None = None) -> float:
    begin = time.perf_counter()
    identify_rooms(campaigns, folder, pool=pool)
    return time.perf_counter() - begin


def duration_s(pool: Executor, n_tasks: int, seconds: float) -> float:
    begin = time.perf_counter()
    for _, future in completed(pool, [partial(time.sleep, seconds)] * n_tasks):
        result_of(future)
    return time.perf_counter() - begin


def written(folder: Path, seed: int) -> Path:
    folder.mkdir()
    return write_measured_box(demo_plan(), folder, np.random.default_rng(seed))


if __name__ == "__main__":
    main()
