"""Blocks of rays: room for what they record, traced, and packed into path arrays."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from roomfit.tracing.acceleration import Walls
from roomfit.tracing.ray_kernels import CHUNK_RAYS, ESCAPES_KEPT, Caught, Job, Tally, trace_chunks
from roomfit.tracing.spheres import Spheres
from roomfit.typing import FloatArray, IntArray

Float32Array: TypeAlias = np.ndarray[tuple[int, int], np.dtype[np.float32]]


class Piece(NamedTuple):
    """Part of the arrays of `Paths`, in their order; the first axis is the path."""

    pair: IntArray
    length_m: FloatArray
    weight_per_m2: FloatArray
    hits_specular: IntArray
    hits_diffuse: IntArray
    departure: Float32Array
    arrival: Float32Array
    batch: IntArray


def bytes_per_path(n_materials: int) -> int:
    """Return the memory of one recorded path in bytes."""
    return 48 + 4 * n_materials


def new_tally(n_chunks: int) -> Tally:
    """Return zeroed counters for so many chunks."""
    return Tally(
        np.zeros(n_chunks, np.int64),
        np.zeros(n_chunks, np.int64),
        np.zeros(n_chunks, np.int64),
        np.zeros(n_chunks),
        np.zeros(n_chunks),
        np.zeros((n_chunks, ESCAPES_KEPT, 3)),
        np.zeros((n_chunks, ESCAPES_KEPT, 3)),
    )


def trace_block(
    walls: Walls,
    spheres: Spheres,
    job: Job,
    directions: FloatArray,
    rays: range,
    capacity: int,
) -> tuple[Caught, Tally]:
    """Trace the rays of a block and return what they recorded and counted.

    Parameters
    ----------
    directions : float array, shape (n_rays, 3)
        Of all rays of the source.
    rays : range
        Those of this block.
    capacity : int
        Crossings that each chunk is expected to find at most. Where one finds more, the block is
        traced a second time with room for all; its rays go the same ways.
    """
    n_chunks = -(-len(rays) // CHUNK_RAYS)
    own = directions[rays.start : rays.stop]
    while True:
        caught, tally = _new_caught(n_chunks, capacity, len(job.scattering)), new_tally(n_chunks)
        trace_chunks(walls, spheres, job, own, rays.start, caught, tally)
        found = int(caught.found.max(initial=0))
        if found <= capacity:
            return caught, tally
        capacity = found


def packed(caught: Caught, spheres: Spheres, directions: FloatArray, n_batches: int) -> Piece:
    """Return the recorded crossings of a block as paths, in the order of chunks."""
    filled = np.arange(caught.ray.shape[1]) < caught.found[:, None]
    ray, sphere = caught.ray[filled], caught.sphere[filled]
    share = 1.0 / (len(directions) * 4.0 / 3.0 * np.pi * spheres.radius_m**3)
    return Piece(
        spheres.pair[sphere],
        caught.length_m[filled],
        caught.chord_m[filled] * share[sphere],
        caught.hits_specular[filled],
        caught.hits_diffuse[filled],
        directions[ray].astype(np.float32),
        np.asarray(caught.arrival[filled], dtype=np.float32),
        (ray % n_batches).astype(np.int32),
    )


def joined(pieces: list[Piece], n_materials: int) -> Piece:
    """Join pieces array by array, emptying the list and letting go of each array once copied."""
    columns = [list(column) for column in zip(_no_paths(n_materials), *pieces, strict=True)]
    pieces.clear()
    arrays = []
    for column in columns:
        arrays.append(np.concatenate(column))
        column.clear()
    return Piece(*arrays)


def _no_paths(n_materials: int) -> Piece:
    return Piece(
        np.empty(0, np.int32),
        np.empty(0),
        np.empty(0),
        np.empty((0, n_materials), np.uint16),
        np.empty((0, n_materials), np.uint16),
        np.empty((0, 3), np.float32),
        np.empty((0, 3), np.float32),
        np.empty(0, np.int32),
    )


def _new_caught(n_chunks: int, capacity: int, n_materials: int) -> Caught:
    size = (n_chunks, capacity)
    return Caught(
        np.zeros(n_chunks, np.int64),
        np.empty(size, np.int32),
        np.empty(size, np.int64),
        np.empty(size),
        np.empty(size),
        np.empty((*size, n_materials), np.uint16),
        np.empty((*size, n_materials), np.uint16),
        np.empty((*size, 3), np.float32),
    )
