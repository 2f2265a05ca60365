"""The lattice of image sources of a box, which may stand anywhere and have doors in its walls.

Every image of a box is visible from everywhere and stands at a place known in closed form. Which
material a path strikes on a wall of several is looked up where it crosses the wall's images.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from roomfit.base.kernels import kernel
from roomfit.base.typing import FloatArray, IntArray
from roomfit.room.inside import deepest
from roomfit.room.mesh import Box, box_of, corners_m
from roomfit.room.scene import Room, triangle_material
from roomfit.tracing.paths import ImageSet

# Indices of a lattice that are in memory at a time, one slice in x at least.
_AT_ONCE = 10_000


class Lattice(NamedTuple):
    """A box and the triangles of its walls, one wall after the other."""

    box: Box
    first: IntArray  # int64 (7,), where the triangles of each wall begin, and the end
    triangle: IntArray  # int64 (n_triangles,), index in the mesh
    corners_m: FloatArray  # (n_triangles, 3 corners, 3), along the box's axes from its corner


def lattice_of(room: Room) -> Lattice | None:
    """Return the lattice of a room that is a box, see `roomfit.room.mesh.box_of`, or None."""
    box = box_of(room.mesh)
    if box is None:
        return None
    order = np.argsort(box.wall, kind="stable")
    first = np.searchsorted(box.wall[order], np.arange(7))
    corners = (corners_m(room.mesh)[order] - box.origin_m) @ box.axes.T
    return Lattice(box, first, order, corners)


def box_images(
    room: Room,
    lattice: Lattice,
    source_m: FloatArray,
    receiver_m: FloatArray,
    order: int,
    max_length_m: float,
    *,
    with_image_transforms: bool = False,
    with_triangles: bool = False,
) -> ImageSet:
    """Return all images up to an order and a distance.

    Image i along an axis of length L stands at ``i L + x`` for even i and ``i L + L - x`` for odd
    i, and its path has \\|i\\| hits on that axis, the two walls in turn: from i > 0 it comes last
    from the far wall [1]_. On a wall of several materials, hits are those of the triangles in which
    the path, folded back into the box, lies deepest.

    Shapes: `source_m, receiver_m` (3,).

    References
    ----------
    .. [1] J. B. Allen, D. A. Berkley, "Image method for efficiently simulating small-room
           acoustics", J. Acoust. Soc. Am. 65, 943-950 (1979).
    """
    origin, axes, lengths, _ = lattice.box
    source, receiver = axes @ (source_m - origin), axes @ (receiver_m - origin)
    index, to_receiver = images_within(lengths, source, receiver, order, max_length_m)
    distance = np.linalg.norm(to_receiver, axis=1)
    near = np.argsort(distance, kind="stable")
    index, to_receiver, distance = index[near], to_receiver[near], distance[near]
    arrival = to_receiver / distance[:, None]
    # every hit on an axis turns that component of the direction
    turned = np.where(index % 2 == 0, 1.0, -1.0)
    hits = np.zeros((len(index), len(room.materials)), dtype=np.uint16)
    owner = triangle_material(room)[lattice.triangle]
    struck = []
    for wall in range(6):
        first, stop = lattice.first[wall : wall + 2]
        if not with_triangles and np.all(owner[first:stop] == owner[first]):
            hits[:, owner[first]] += wall_hits(index, wall).astype(np.uint16)
            continue
        rays = index, receiver, to_receiver, lengths
        struck.append(_struck(*rays, wall, lattice.corners_m, first, stop))
        np.add.at(hits, (struck[-1][0], owner[struck[-1][2]]), 1)
    images = ImageSet(distance, hits, (arrival * turned) @ axes, arrival @ axes)
    if with_image_transforms:
        product = np.einsum("ki,pk,kj->pij", axes, turned, axes)
        images = replace(images, image_transform=product)
    if with_triangles:
        path, share, piece = (np.concatenate(own) for own in zip(*struck, strict=True))
        first_hit = np.append(0, np.cumsum(np.abs(index).sum(axis=1)))
        triangle = lattice.triangle[piece[np.lexsort((-share, path))]]
        images = replace(images, first_hit=first_hit, triangle=triangle)
    return images


@kernel()
def _struck(
    index: IntArray,
    receiver: FloatArray,
    to_receiver: FloatArray,
    lengths: FloatArray,
    wall: int,
    corners_m: FloatArray,
    first: int,
    stop: int,
) -> tuple[IntArray, FloatArray, IntArray]:
    """Return the hits on a wall: of which path, which share of it later, and on which triangle.

    The straight line from the receiver to an image crosses planes of the lattice, each an image of
    a wall; where it does is folded back into the box. Nothing adds up from hit to hit.
    """
    axis, side = wall // 2, wall % 2
    normal = (0.0 + (axis == 0), 0.0 + (axis == 1), 0.0 + (axis == 2))
    if side == 0:
        normal = (-normal[0], -normal[1], -normal[2])
    most = 0
    for p in range(len(index)):
        most += (abs(index[p, axis]) + 1) // 2
    path, share, piece = np.empty(most, np.int64), np.empty(most), np.empty(most, np.int64)
    n, x = 0, np.empty(3)
    for p in range(len(index)):
        i = index[p, axis]
        # planes 1 to i above the box, 0 to i + 1 below; odd ones are images of the upper wall
        for plane in range(min(i + 1, 1), max(i + 1, 1)):
            if plane % 2 != side:
                continue
            path[n] = p
            share[n] = (receiver[axis] - plane * lengths[axis]) / to_receiver[p, axis]
            for k in range(3):
                x[k] = receiver[k] - share[n] * to_receiver[p, k]
                cell = math.floor(x[k] / lengths[k])
                x[k] -= cell * lengths[k]
                if cell % 2 == 1:
                    x[k] = lengths[k] - x[k]
            x[axis] = side * lengths[axis]
            piece[n] = deepest(corners_m, first, stop, normal, (x[0], x[1], x[2]), -math.inf)
            n += 1
    return path[:n], share[:n], piece[:n]


def count_of_box_images(lengths_m: FloatArray, order: int, max_length_m: float) -> float:
    """Return an upper bound of how many images lie within an order and a distance."""
    octahedron = (2 * order + 1) * (2 * order**2 + 2 * order + 3) / 3
    # cells that a sphere about the receiver touches
    reach = max_length_m + math.hypot(*lengths_m)
    return min(octahedron, 4.0 / 3.0 * math.pi * reach**3 / math.prod(lengths_m))


def images_within(
    lengths: FloatArray, source: FloatArray, receiver: FloatArray, order: int, max_length_m: float
) -> tuple[IntArray, FloatArray]:
    """Return index (n, 3) of images within order and distance, and vector to the receiver in m.

    See `box_images` for what an index means. Some slices in x are taken at a time.
    """
    # image i is at least |i| - 1 lengths away
    last = np.minimum(order, np.floor(max_length_m / lengths).astype(np.int64) + 1)
    y, z = (np.arange(-n, n + 1) for n in last[1:])
    indices, vectors = [], []
    # of few images all slices at once
    x = np.arange(-last[0], last[0] + 1)
    n_at_once = max(_AT_ONCE // (y.size * z.size), 1)
    for first in range(0, x.size, n_at_once):
        part = x[first : first + n_at_once]
        n_hits = np.abs(part)[:, None, None] + np.abs(y)[:, None] + np.abs(z)
        i, j, k = np.nonzero(n_hits <= order)
        index = np.column_stack([part[i], y[j], z[k]])
        mirrored = np.where(index % 2 == 0, source, lengths - source)
        to_receiver = receiver - (index * lengths + mirrored)
        near = np.linalg.norm(to_receiver, axis=1) <= max_length_m
        indices.append(index[near])
        vectors.append(to_receiver[near])
    return np.concatenate(indices), np.concatenate(vectors)


def wall_hits(index: IntArray, wall: int) -> IntArray:
    """Return how often each path hits a wall: 2 axis for the one at 0, 2 axis + 1 for the other."""
    i = index[:, wall // 2]
    # of |i| hits the wall on the image's side has the odd one
    on_this_side = (i > 0) == (wall % 2 == 1)
    return np.asarray((np.abs(i) + on_this_side) // 2)
