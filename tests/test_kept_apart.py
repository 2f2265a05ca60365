"""What must not be taken for another: keys of kept results, draws, orders, rows of tables."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np

from roomfit.base.air import Air
from roomfit.base.cache import write_bytes_atomically
from roomfit.base.workers import in_pool
from roomfit.room.mesh import shoebox_mesh
from roomfit.room.scene import Point, Scene, room_from_mesh


def scene() -> Scene:
    room = room_from_mesh(shoebox_mesh((3.0, 2.5, 2.0)), {})
    points = tuple((Point(name, at),) for name, at in (("S", (1, 1, 1)), ("R", (2, 2, 1))))
    return Scene(room, *points, np.array([[0, 0]]), Air())


def test_a_file_is_replaced_and_never_written_into(tmp_path: Path) -> None:
    """Who has the old one open, or under another name, keeps it whole."""
    path, other = tmp_path / "a.json", tmp_path / "b.json"
    path.write_bytes(b"old content")
    os.link(path, other)
    with path.open("rb") as reader:
        write_bytes_atomically(path, b"new")
        assert reader.read() == b"old content"
    assert other.read_bytes() == b"old content"
    assert path.read_bytes() == b"new"


def test_results_of_a_pool_stand_in_the_order_of_their_tasks() -> None:
    """The first task ends last."""

    def late(number: int) -> int:
        time.sleep(0.02 * (4 - number))
        return number

    said: list[float] = []
    tasks: list[Callable[[], int]] = [partial(late, n) for n in range(4)]
    with ThreadPoolExecutor(4) as pool:
        assert in_pool(pool, tasks, said.append) == [0, 1, 2, 3]
    assert said == [0.25, 0.5, 0.75, 1.0]
