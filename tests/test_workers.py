"""Tasks reach every worker once, whatever dies on the way, and nothing listens to the world."""

from __future__ import annotations

import os
import time
from functools import partial
from pathlib import Path

import pytest

from cluster_tasks import die, number_into
from roomfit.base.errors import InsufficientDataError
from roomfit.batch.cluster import cluster_client, completed, result_of


def content(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.glob("*.txt")}


@pytest.mark.slow
def test_an_own_cluster_listens_on_the_loopback_alone_and_ends_with_its_block(
    tmp_path: Path,
) -> None:
    psutil = pytest.importorskip("psutil")
    this = psutil.Process()
    before = {p.pid for p in this.children(recursive=True)}
    trimming = os.getenv("MALLOC_TRIM_THRESHOLD_")
    with cluster_client(n_workers=2) as executor:
        family = [this, *(p for p in this.children(recursive=True) if p.pid not in before)]
        listening = [c for p in family for c in p.net_connections("inet") if c.status == "LISTEN"]
        assert {c.laddr.ip for c in listening} == {"127.0.0.1"}
        tasks = [partial(number_into, tmp_path, n, 0.2) for n in range(10)]
        pids = [result_of(future) for _, future in completed(executor, tasks)]
        # dask's own value has every array given back to the system
        assert executor.submit(os.getenv, "MALLOC_TRIM_THRESHOLD_").result() == trimming
    assert len(set(pids)) == 2
    assert os.getpid() not in pids
    deadline = time.monotonic() + 60.0
    while {p.pid for p in this.children(recursive=True)} - before - _trackers(this):
        assert time.monotonic() < deadline
        time.sleep(0.1)


def _trackers(process: object) -> set[int]:
    """Return the helpers of multiprocessing, which stay as long as the process does."""
    found = process.children(recursive=True)  # type: ignore[attr-defined]
    return {
        p.pid
        for p in found
        if any(w in " ".join(p.cmdline()) for w in ("resource_tracker", "forkserver"))
    }


@pytest.mark.slow
def test_a_task_that_kills_its_workers_is_reported_and_all_others_are_done(tmp_path: Path) -> None:
    """Three workers die of it, and alone three more; none of the others is blamed."""
    with cluster_client(n_workers=2) as client:
        tasks = [die, *(partial(number_into, tmp_path, n, 0.2) for n in range(6))]
        ends = dict(completed(client, tasks))
        with pytest.raises(InsufficientDataError, match="every worker that had the task died"):
            result_of(ends.pop(0))
        assert all(isinstance(result_of(future), int) for future in ends.values())
    assert sorted(content(tmp_path)) == [f"{n}.txt" for n in range(6)]
