"""The next wall of a ray: the planes of a convex room, or a tree of boxes around facets.

A binary tree of boxes is cut top-down by the surface area heuristic [1]_, all cuts along all axes
being tried. Boxes are wider than their facets by more than the rounding, so that the answer is bit
for bit that of testing every facet.

References
----------
.. [1] J. D. MacDonald, K. S. Booth, "Heuristics for ray tracing using space subdivision", Visual
       Computer 6, 153-166 (1990).
"""

# ruff: noqa: ARG001, ARG005 -- numba matches functions by the names of all their arguments
from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numba.extending import overload

from roomfit.base.kernels import kernel
from roomfit.base.typing import FloatArray, IntArray
from roomfit.room.inside import Vector
from roomfit.room.scene import Room
from roomfit.tracing.walls import (
    EDGE_M,
    Facets,
    Planes,
    convex_planes,
    facet_distance,
    facets_of,
    material_in_plane,
    nearest_plane,
)

# Testing a node costs this much of testing a facet, and a leaf has at most so many facets: quickest
# in halls of 1,000 to 100,000 triangles.
_NODE_COST, _MAX_LEAF = 0.7, 4
# Deeper nodes are cut in half, so that no tree has more than this and log2(n_facets) levels and a
# walk never keeps more than `WAITING` nodes.
_MAX_LEVEL, WAITING = 32, 64
# Share of the room's size by which boxes are widened, far above the rounding.
_WIDER = 1e-12
_TINY = 1e-18


class Tree(NamedTuple):
    """Facets and the boxes around them."""

    table: FloatArray  # As in `Facets`, in the order of the leaves, like the next two
    normal: FloatArray
    material: IntArray
    box_m: FloatArray  # (n_nodes, 6), lowest x, y, z, then the highest; node 0 is the root
    # int32 (n_nodes,): the first of two children that stand together, or of a leaf
    # ``-1 - 8 first_facet - n_facets``
    child: IntArray


def tree_of(facets: Facets, box_m: FloatArray) -> Tree:
    """Return the tree over facets whose boxes are given, shape (n_facets, 2, 3)."""
    n = len(box_m)
    low, high = box_m[:, 0].min(axis=0), box_m[:, 1].max(axis=0)
    wider = _WIDER * float(np.linalg.norm(high - low)) + 2.0 * EDGE_M
    # sorted once along each axis; every cut keeps the three orders of both parts
    orders = np.argsort(box_m[:, 0] + box_m[:, 1], axis=0, kind="stable").T
    order, boxes, child = np.empty(n, dtype=np.int64), [], []
    waiting = [(orders, 0, 0)]
    for orders, level, first in waiting:  # children are added behind, so all nodes come in turn
        own, count = box_m[orders[0]], orders.shape[1]
        boxes.append(np.append(own[:, 0].min(axis=0) - wider, own[:, 1].max(axis=0) + wider))
        axis, cut = _best_cut(box_m, orders)
        if cut == 0:
            child.append(-1 - 8 * first - count)
            order[first : first + count] = orders[0]
            continue
        cut = count // 2 if level >= _MAX_LEVEL else cut
        child.append(len(waiting))
        is_before = np.zeros(n, dtype=np.bool_)
        is_before[orders[axis, :cut]] = True
        is_before = is_before[orders]
        waiting.append((orders[is_before].reshape(3, -1), level + 1, first))
        waiting.append((orders[~is_before].reshape(3, -1), level + 1, first + cut))
    return Tree(
        facets.table[order],
        facets.normal[order],
        facets.material[order],
        np.array(boxes),
        np.array(child, dtype=np.int32),
    )


def _best_cut(box_m: FloatArray, orders: IntArray) -> tuple[int, int]:
    """Return the axis to cut across and how many facets come first; 0 of them for a leaf."""
    n = orders.shape[1]
    if n == 1:
        return 0, 0
    low, high = box_m[orders, 0], box_m[orders, 1]  # (3 axes, n, 3)
    before = _half_area(np.minimum.accumulate(low, 1), np.maximum.accumulate(high, 1))
    back = slice(None), slice(None, None, -1)
    after = _half_area(
        np.minimum.accumulate(low[back], 1)[back], np.maximum.accumulate(high[back], 1)[back]
    )
    count = np.arange(1, n)
    cost = before[:, :-1] * count + after[:, 1:] * (n - count)
    axis, cut = np.unravel_index(int(np.argmin(cost)), cost.shape)
    whole = before[0, -1]
    if n <= _MAX_LEAF and _NODE_COST * whole + cost[axis, cut] >= whole * n:
        return 0, 0
    return int(axis), int(cut) + 1


def _half_area(low: FloatArray, high: FloatArray) -> FloatArray:
    x, y, z = np.moveaxis(high - low, -1, 0)
    return np.asarray(x * y + y * z + z * x)


@kernel(allocates=False)
def _inverse(x: float) -> float:
    return 1.0 / (math.copysign(_TINY, x) if abs(x) < _TINY else x)


@kernel(allocates=False, inlined=True)
def _entry(box_m: FloatArray, node: int, o: Vector, inverse: Vector) -> float:
    """Return the distance at which a ray enters a box, 0 or more; infinity for a miss."""
    enter, leave = 0.0, np.inf
    for axis in range(3):
        a = (box_m[node, axis] - o[axis]) * inverse[axis]
        b = (box_m[node, 3 + axis] - o[axis]) * inverse[axis]
        enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
    return enter if enter <= leave else np.inf


@kernel(allocates=False, inlined=True)
def nearest_in_tree(
    tree: Tree, o: Vector, d: Vector, last: int, waiting: IntArray
) -> tuple[float, int]:
    """Return distance and number of the facet that a ray meets first; infinity and -1 for none.

    Of facets at the same distance the one with the lowest number counts.
    """
    left = (0.0, 0.0, 0.0)
    if last >= 0:
        left = (tree.normal[last, 0], tree.normal[last, 1], tree.normal[last, 2])
    inverse = (_inverse(d[0]), _inverse(d[1]), _inverse(d[2]))
    best, hit = np.inf, -1
    n, node = 0, 0
    while True:
        child = tree.child[node]
        if child < 0:
            leaf = -1 - child
            for i in range(leaf >> 3, (leaf >> 3) + (leaf & 7)):
                t = facet_distance(tree.table, i, o, d, left, best)
                if t < best or (t == best and i < hit):
                    best, hit = t, i
        else:
            near, far = child, child + 1
            a, b = _entry(tree.box_m, near, o, inverse), _entry(tree.box_m, far, o, inverse)
            if b < a:
                near, far, a, b = far, near, b, a
            if b <= best and b < np.inf:
                waiting[n] = far
                n += 1
            if a <= best and a < np.inf:
                node = near
                continue
        if n == 0:
            return best, hit
        n -= 1
        node = waiting[n]


Walls: TypeAlias = Planes | Tree


def walls_of(room: Room) -> Walls:
    """Return the structure that suits a room: planes where it is convex with few of them."""
    planes = convex_planes(room)
    return tree_of(*facets_of(room)) if planes is None else planes


def next_wall(
    walls: Walls, o: Vector, d: Vector, last: int, waiting: IntArray
) -> tuple[float, int]:
    """Return distance and number of the wall that a ray from `o` meets first.

    Only for use in kernels, where the type of `walls` selects the method. Infinity and -1 where the
    ray meets nothing: it has left through a leak.
    """
    raise TypeError("only compiled code may call this")


def wall_material(walls: Walls, wall: int, p: Vector) -> int:
    """Return the material of a wall at one of its points; only for use in kernels."""
    raise TypeError("only compiled code may call this")


@overload(next_wall, strict=False)
def _next_wall(walls: Any, o: Any, d: Any, last: Any, waiting: Any) -> Any:
    if walls.instance_class is Planes:
        return lambda walls, o, d, last, waiting: nearest_plane(walls, o, d)
    return lambda walls, o, d, last, waiting: nearest_in_tree(walls, o, d, last, waiting)


@overload(wall_material, strict=False)
def _wall_material(walls: Any, wall: Any, p: Any) -> Any:
    if walls.instance_class is Planes:
        return lambda walls, wall, p: material_in_plane(walls, wall, p)
    return lambda walls, wall, p: walls.material[wall]
