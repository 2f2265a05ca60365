"""What a tree of beams may take, and what it finds, in arrays that grow."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roomfit.compiled import kernel
from roomfit.typing import FloatArray, IntArray

DONE, TOO_MUCH_WORK, TOO_MUCH_MEMORY = 0, 1, 2


class Limits(NamedTuple):
    """What ends the tree: its rules, and how much it may take.

    Attributes
    ----------
    order : int
    length_m : float
    work : int
        Walls held against beams.
    n_hits : int
        Hits and paths kept, together.
    """

    order: int
    length_m: float
    work: int
    n_hits: int


class Found(NamedTuple):
    """Visible images in the order in which they were found, one after the other.

    Attributes
    ----------
    receiver, order : int32 arrays, shape (n_images,)
    position_m : float array, shape (n_images, 3)
    matrix : float array, shape (n_images, 9)
        Product of the reflections, see `roomfit.tracing.paths`.
    triangle : int32 array, shape (n_hits,)
        First hit first, path after path.
    cosine : float array, shape (n_hits,)
    ending : int
        DONE, or what there was too much of.
    work : int
        How many walls were held against beams.
    """

    receiver: IntArray
    order: IntArray
    position_m: FloatArray
    matrix: FloatArray
    triangle: IntArray
    cosine: FloatArray
    ending: int
    work: int


@kernel()
def nothing() -> Found:
    """Return no images, with room for some."""
    return _room_for(256, 4096)


@kernel()
def _room_for(n_images: int, n_hits: int) -> Found:
    return Found(
        np.empty(n_images, dtype=np.int32),
        np.empty(n_images, dtype=np.int32),
        np.empty((n_images, 3)),
        np.empty((n_images, 9)),
        np.empty(n_hits, dtype=np.int32),
        np.empty(n_hits),
        DONE,
        0,
    )


@kernel()
def with_room(found: Found, n_images: int, n_hits: int) -> Found:
    """Return the same images with room for so many images and hits."""
    have_images, have_hits = len(found.receiver), len(found.triangle)
    if n_images <= have_images and n_hits <= have_hits:
        return found
    wider = _room_for(max(have_images, 2 * n_images), max(have_hits, 2 * n_hits))
    wider.receiver[:have_images] = found.receiver
    wider.order[:have_images] = found.order
    wider.position_m[:have_images] = found.position_m
    wider.matrix[:have_images] = found.matrix
    wider.triangle[:have_hits] = found.triangle
    wider.cosine[:have_hits] = found.cosine
    return wider


@kernel()
def cut_to(found: Found, n_images: int, n_hits: int, ending: int, work: int) -> Found:
    """Return the images and hits found so far, without the room for more."""
    return Found(
        found.receiver[:n_images].copy(),
        found.order[:n_images].copy(),
        found.position_m[:n_images].copy(),
        found.matrix[:n_images].copy(),
        found.triangle[:n_hits].copy(),
        found.cosine[:n_hits].copy(),
        ending,
        work,
    )
