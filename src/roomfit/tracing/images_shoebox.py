"""Image sources of a box: a lattice, every image of which is visible from everywhere."""

from __future__ import annotations

import math

import numpy as np

from roomfit.scene.room import Room
from roomfit.tracing.images_set import ImageSet, reflections_in_order
from roomfit.tracing.paths import Reflections
from roomfit.typing import FloatArray, IntArray


def shoebox_images(
    room: Room,
    source_m: FloatArray,
    receiver_m: FloatArray,
    order: int,
    max_length_m: float,
    *,
    with_reflections: bool = False,
    with_unfolding: bool = False,
) -> ImageSet:
    """Return all images up to an order and a distance.

    Image i along an axis of length L stands at ``i L + x`` for even i and ``i L + L - x`` for odd
    i, and its path has \\|i\\| hits on that axis, the two walls in turn: from i > 0 it comes last
    from the far wall [1]_.

    Parameters
    ----------
    room : Room
        With `shoebox_m`.
    source_m, receiver_m : float array, shape (3,)
    order : int
        Most hits of a path, 0 or more.
    max_length_m : float
    with_reflections, with_unfolding : bool
        Return the ordered hits, and the product of the reflections, as well.

    References
    ----------
    .. [1] J. B. Allen, D. A. Berkley, "Image method for efficiently simulating small-room
           acoustics", J. Acoust. Soc. Am. 65, 943-950 (1979).
    """
    lengths = np.array(room.shoebox_m, dtype=np.float64)
    index = lattice_indices(lengths, source_m, receiver_m, order, max_length_m)
    to_receiver = receiver_m - image_positions_m(index, lengths, source_m)
    distance = np.linalg.norm(to_receiver, axis=1)
    near = np.argsort(distance, kind="stable")
    index, to_receiver, distance = index[near], to_receiver[near], distance[near]
    arrival = to_receiver / distance[:, None]
    # every hit on an axis turns that component of the direction
    turned = np.where(index % 2 == 0, 1.0, -1.0)
    departure = arrival * turned
    hits = np.zeros((len(index), len(room.materials)), dtype=np.uint16)
    for wall in range(6):
        hits[:, room.surface_material[wall]] += wall_hits(index, wall).astype(np.uint16)
    reflections = _reflections(room, index, receiver_m, to_receiver) if with_reflections else None
    unfolding = turned[:, :, None] * np.eye(3) if with_unfolding else None
    return ImageSet(distance, hits, departure, arrival, reflections, unfolding)


def count_of_shoebox_images(
    lengths_m: tuple[float, float, float], order: int, max_length_m: float
) -> float:
    """Return an upper bound of how many images lie within an order and a distance."""
    octahedron = (2 * order + 1) * (2 * order**2 + 2 * order + 3) / 3
    # cells that a sphere about the receiver touches
    reach = max_length_m + math.hypot(*lengths_m)
    return min(octahedron, 4.0 / 3.0 * math.pi * reach**3 / math.prod(lengths_m))


def lattice_indices(
    lengths: FloatArray, source: FloatArray, receiver: FloatArray, order: int, max_length_m: float
) -> IntArray:
    """Return the indices (n, 3) of the images within order and distance, slice by slice in x.

    See `shoebox_images` for what an index means.
    """
    # image i is at least |i| - 1 lengths away
    last = np.minimum(order, np.floor(max_length_m / lengths).astype(np.int64) + 1)
    y, z = (np.arange(-n, n + 1) for n in last[1:])
    slices = []
    for i in range(-int(last[0]), int(last[0]) + 1):
        j, k = (g.ravel() for g in np.meshgrid(y, z, indexing="ij"))
        low = abs(i) + np.abs(j) + np.abs(k) <= order
        index = np.column_stack([np.full(int(low.sum()), i), j[low], k[low]])
        away = np.linalg.norm(image_positions_m(index, lengths, source) - receiver, axis=1)
        slices.append(index[away <= max_length_m])
    return np.concatenate(slices)


def image_positions_m(index: IntArray, lengths: FloatArray, source: FloatArray) -> FloatArray:
    """Return where the images of these indices stand, (n, 3)."""
    mirrored = np.where(index % 2 == 0, source, lengths - source)
    return np.asarray(index * lengths + mirrored)


def wall_hits(index: IntArray, wall: int) -> IntArray:
    """Return how often each path hits a wall: 2 axis for the one at 0, 2 axis + 1 for the other."""
    i = index[:, wall // 2]
    # of |i| hits the wall on the image's side has the odd one
    on_this_side = (i > 0) == (wall % 2 == 1)
    return np.asarray((np.abs(i) + on_this_side) // 2)


def _reflections(
    room: Room, index: IntArray, receiver: FloatArray, to_receiver: FloatArray
) -> Reflections:
    """Follow the straight line from each image to the receiver through the walls' images."""
    lengths = np.array(room.shoebox_m)
    distance = np.linalg.norm(to_receiver, axis=1)
    parts: list[tuple[IntArray, FloatArray, IntArray, FloatArray]] = []
    for axis in range(3):
        counts = np.abs(index[:, axis])
        path = np.repeat(np.arange(len(index)), counts)
        # hits counted outwards from the receiver: 0 is the last one of the path
        back = np.arange(len(path)) - np.repeat(np.cumsum(counts) - counts, counts)
        beyond = index[path, axis] > 0
        plane = np.where(beyond, back + 1, -back) * lengths[axis]
        share = (plane - receiver[axis]) / -to_receiver[path, axis]
        wall = 2 * axis + (beyond == (back % 2 == 0))
        cosine = np.abs(to_receiver[path, axis]) / distance[path]
        parts.append((path, -share, room.surface_material[wall], cosine))
    path, place, material, cosine = (np.concatenate(column) for column in zip(*parts, strict=True))
    return reflections_in_order(path, place, material, cosine, len(index))
