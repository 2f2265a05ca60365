"""Image sources far in time: how many, how long they take, and another program beside them.

    python benchmarks/images.py [--receivers N] [--theirs SECONDS]

One source and eight receivers on one core. The box goes once through the lattice and once, as a
room like any other, through the tree of beams; every other room is compared with a simulator that
mirrors the room instead of the source: paths that only one of the two has are counted. Then the
images of pyroomacoustics' polyhedral rooms, one pair, from the highest order that it does within
some seconds: the two of one line have the same orders and see the same images.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from roomfit.base.typing import FloatArray
from roomfit.demo.polyhedra import Cells, cell_images
from roomfit.room.mesh import corners_m
from roomfit.room.scene import Room
from roomfit.tracing.image_sources import expected_images, limits_of, polyhedron_images
from roomfit.tracing.paths import ImageSet
from simulated_rooms.polyhedral_rooms import (
    box_room_cells,
    cell_volume_m3,
    l_shaped_cells,
    paper_cells,
    room_of,
    slanted_cells,
)

SPEED_M_S = 343.0
ALL_ORDERS = 1000
ROOMS: dict[str, tuple[Cells, float, list[float], list[list[float]]]] = {
    "box": (
        box_room_cells((6.1, 4.7, 2.8)),
        0.2,
        [1.23, 1.51, 1.13],
        [[1.0, 1.0, 0.6], [5.2, 3.8, 2.2]],
    ),
    "paper's": (paper_cells(), 0.25, [9.82, 6.05, 1.7], [[1, 1, 0.6], [14, 9, 2.5]]),
    "slanted": (slanted_cells(), 0.2, [1.2, 1.3, 1.1], [[1, 1, 0.6], [4.7, 3.6, 2.2]]),
    "L": (l_shaped_cells(), 0.2, [5.9, 1.2, 1.3], [[0.7, 0.7, 0.6], [3.2, 5.2, 2.2]]),
}


def timed(call: Callable[[], Any], repetitions: int = 1) -> tuple[Any, float]:
    """Return what a call gives, and the least processor time that it took."""
    least = np.inf
    for _ in range(repetitions):
        start = time.process_time()
        result = call()
        least = min(least, time.process_time() - start)
    return result, float(least)


def only_in_one(found: list[ImageSet], expected: list[tuple[FloatArray, Any]]) -> int:
    """Return how many paths one of two ways has and the other has not, by length and hits."""
    missing = 0
    for images, (lengths, hits) in zip(found, expected, strict=True):
        own = {
            (round(d, 7), *h) for d, h in zip(images.length_m, images.hits.tolist(), strict=True)
        }
        theirs = {(round(d, 7), *h) for d, h in zip(lengths, hits.tolist(), strict=True)}
        missing += len(own ^ theirs)
    return missing


def their_images(room: Room, source: FloatArray, receiver: FloatArray, order: int) -> int:
    """Return how many images pyroomacoustics sees."""
    import pyroomacoustics as pra

    walls = [
        pra.wall_factory(triangle.T, [0.1], [0.0], f"triangle {i}")
        for i, triangle in enumerate(corners_m(room.mesh))
    ]
    theirs = pra.Room(walls, fs=16000, max_order=order, air_absorption=False)
    theirs.add_source(source)
    theirs.add_microphone(receiver)
    theirs.image_source_model()
    return int(np.sum(np.asarray(theirs.visibility[0][0]).astype(bool)))


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--receivers", type=int, default=8)
    parser.add_argument("--theirs", type=float, default=5.0)
    asked = parser.parse_args()
    rng = np.random.default_rng(3)
    places = {
        name: rng.uniform(low, high, (asked.receivers, 3))
        for name, (_, _, _, (low, high)) in ROOMS.items()
    }
    for name, (cells, _, source, _) in ROOMS.items():  # compiles
        polyhedron_images(room_of(cells), np.array(source), places[name], limits_of(2, 30.0))
        cell_images(cells, np.array(source), places[name], 10.0)
    print("room      m3     s  images a pair  expected  s a source  simulator s  only in one")
    for name, (cells, duration_s, source, _) in ROOMS.items():
        room, start, reach_m = room_of(cells), np.array(source), duration_s * SPEED_M_S
        found, took = timed(
            lambda: polyhedron_images(room, start, places[name], limits_of(ALL_ORDERS, reach_m))  # noqa: B023
        )
        expected, theirs = timed(
            lambda: cell_images(cells, start, places[name], reach_m)  # noqa: B023
        )
        mean = np.mean([len(images.length_m) for images in found])
        volume = cell_volume_m3(cells)
        print(
            f"{name:8} {volume:5.0f} {duration_s:5.2f} {mean:13.0f} "
            f"{expected_images(volume, reach_m):9.0f} {took:11.2f} {theirs:12.2f} "
            f"{only_in_one(found, expected):12d}",
            flush=True,
        )
    print("\nroom     order  images  theirs     ms  their ms  ratio")
    for name, (cells, _, source, _) in ROOMS.items():
        room, start = room_of(cells), np.array(source)
        for order in range(3, 20):
            count, theirs = timed(
                lambda: their_images(room, start, places[name][0], order)  # noqa: B023
            )
            own, took = timed(
                lambda: polyhedron_images(room, start, places[name][:1], limits_of(order, 1e4)),  # noqa: B023
                3,
            )
            if 6.0 * theirs > asked.theirs:
                break
        print(
            f"{name:8} {order:5d} {len(own[0].length_m):7d} {count:7d} {1e3 * took:6.1f} "
            f"{1e3 * theirs:9.1f} {theirs / took:6.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
