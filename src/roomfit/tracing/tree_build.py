"""Boxes within boxes, so that a ray need only look at a few of the facets.

A binary tree is cut top-down where the surface area heuristic [1]_ says, all cuts along all axes
being tried, and then folded so that every node has up to eight children.

References
----------
.. [1] J. D. MacDonald, K. S. Booth, "Heuristics for ray tracing using space subdivision", Visual
       Computer 6, 153-166 (1990).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roomfit.compiled import kernel
from roomfit.tracing.vector import WIDTH
from roomfit.typing import BoolArray, FloatArray, IntArray

# Looking at a node costs this much of looking at a facet, and a leaf holds at most so many facets:
# quickest in halls of 1,000 to 100,000 triangles.
NODE_COST = 0.7
MAX_LEAF = 4
# Deeper nodes are cut in half, so that no tree has more than this and log2(n_facets) levels and a
# walk never keeps more than `roomfit.tracing.vector.STACK` nodes waiting.
_MAX_LEVEL = 32


class BinaryTree(NamedTuple):
    """Boxes cut in two again and again; node 0 holds everything.

    Attributes
    ----------
    left : int64 array, shape (n_nodes,)
        First child, the second stands next to it; -1 for a leaf.
    first, n_facets : int64 arrays, shape (n_nodes,)
        A node holds the facets ``order[first : first + n_facets]``.
    box_m : float array, shape (n_nodes, 2, 3)
    order : int64 array, shape (n_facets,)
    """

    left: IntArray
    first: IntArray
    n_facets: IntArray
    box_m: FloatArray
    order: IntArray


@kernel()
def binary_tree(box_m: FloatArray) -> BinaryTree:
    """Return the tree over facets with the given boxes, shape (n_facets, 2, 3)."""
    n = len(box_m)
    size = max(2 * n - 1, 1)
    left, level = np.full(size, -1, np.int64), np.zeros(size, np.int64)
    first, n_facets = np.zeros(size, np.int64), np.zeros(size, np.int64)
    boxes = np.zeros((size, 2, 3))
    # sorted once along each axis; every cut keeps the three orders of both parts
    orders = np.empty((3, n), np.int64)
    for axis in range(3):
        middle = box_m[:, 0, axis] + box_m[:, 1, axis]
        orders[axis] = np.argsort(middle, kind="mergesort")
    areas, spare, goes_left = np.empty(n), np.empty(n, np.int64), np.zeros(n, np.bool_)
    n_facets[0], used = n, 1
    node = 0
    while node < used:  # children are added behind, so all nodes come in turn
        a, b = first[node], first[node] + n_facets[node]
        _surround(box_m, orders[0, a:b], boxes[node])
        axis, cut = _best_cut(box_m, orders[:, a:b], boxes[node], areas[a:b])
        if cut > 0 and level[node] >= _MAX_LEVEL:
            cut = (b - a) // 2
        if cut > 0:
            _divide(orders[:, a:b], axis, cut, goes_left, spare)
            left[node] = used
            level[used : used + 2] = level[node] + 1
            first[used], n_facets[used] = a, cut
            first[used + 1], n_facets[used + 1] = a + cut, b - a - cut
            used += 2
        node += 1
    return BinaryTree(left[:used], first[:used], n_facets[:used], boxes[:used], orders[0])


@kernel()
def _surround(box_m: FloatArray, members: IntArray, box: FloatArray) -> None:
    box[0], box[1] = np.inf, -np.inf
    for i in members:
        _widen(box, box_m, i)


@kernel(allocates=False)
def _widen(box: FloatArray, box_m: FloatArray, i: int) -> None:
    for axis in range(3):
        box[0, axis] = min(box[0, axis], box_m[i, 0, axis])
        box[1, axis] = max(box[1, axis], box_m[i, 1, axis])


@kernel(allocates=False)
def _half_area(box: FloatArray) -> float:
    x, y, z = box[1, 0] - box[0, 0], box[1, 1] - box[0, 1], box[1, 2] - box[0, 2]
    return float(x * y + y * z + z * x)


@kernel()
def _best_cut(
    box_m: FloatArray, orders: IntArray, box: FloatArray, areas: FloatArray
) -> tuple[int, int]:
    """Return the axis to cut across and how many facets come first; 0 of them for a leaf."""
    n = orders.shape[1]
    best, best_axis, cut = np.inf, 0, 0
    growing = np.empty((2, 3))
    for axis in range(3):
        growing[0], growing[1] = np.inf, -np.inf
        for k in range(n - 1, 0, -1):
            _widen(growing, box_m, orders[axis, k])
            areas[k] = _half_area(growing)
        growing[0], growing[1] = np.inf, -np.inf
        for k in range(1, n):
            _widen(growing, box_m, orders[axis, k - 1])
            cost = _half_area(growing) * k + areas[k] * (n - k)
            if cost < best:
                best, best_axis, cut = cost, axis, k
    area = _half_area(box)
    if n <= MAX_LEAF and NODE_COST * area + best >= area * n:
        return best_axis, 0
    return best_axis, cut


@kernel(allocates=False)
def _divide(orders: IntArray, axis: int, cut: int, goes_left: BoolArray, spare: IntArray) -> None:
    """Bring the first `cut` facets along one axis to the front of all three orders."""
    n = orders.shape[1]
    for k in range(n):
        goes_left[orders[axis, k]] = k < cut
    for other in range(3):
        front, back = 0, cut
        for k in range(n):
            i = orders[other, k]
            if goes_left[i]:
                spare[front] = i
                front += 1
            else:
                spare[back] = i
                back += 1
        for k in range(n):
            orders[other, k] = spare[k]


@kernel()
def folded(tree: BinaryTree) -> tuple[FloatArray, IntArray]:
    """Return the nodes of the same tree with up to eight children each.

    Starting from its two children, the widest child of a node is replaced by that one's own, until
    there are eight or only leaves.

    Returns
    -------
    box_m : float array, shape (n_nodes, 8, 2, 3)
        Of the children; upside down (lowest over highest) where there is none.
    child : int64 array, shape (n_nodes, 8)
        Number of a node; or, for a leaf, minus one minus eight times its first facet minus its
        number of facets.
    """
    size = max(len(tree.left) // 2, 1)
    box_m = np.empty((size, WIDTH, 2, 3))
    box_m[:, :, 0], box_m[:, :, 1] = np.inf, -np.inf
    child = np.full((size, WIDTH), -1, np.int64)
    root = np.zeros(size, np.int64)  # binary node behind each wide one
    slots = np.empty(WIDTH, np.int64)
    used, node = 1, 0
    while node < used:
        n = _opened(tree, root[node], slots)
        for k in range(n):
            b = slots[k]
            box_m[node, k] = tree.box_m[b]
            if tree.left[b] >= 0:
                root[used] = b
                child[node, k] = used
                used += 1
            else:
                child[node, k] = -1 - 8 * tree.first[b] - tree.n_facets[b]
        node += 1
    return box_m[:used], child[:used]


@kernel(allocates=False)
def _opened(tree: BinaryTree, root: int, slots: IntArray) -> int:
    """Write the binary nodes that become the children of a wide one; return their number."""
    slots[0], n = root, 1
    while n < WIDTH:
        widest, place = -1.0, -1
        for k in range(n):
            area = _half_area(tree.box_m[slots[k]])
            if tree.left[slots[k]] >= 0 and area > widest:
                widest, place = area, k
        if place < 0:
            break
        b = slots[place]
        slots[place], slots[n] = tree.left[b], tree.left[b] + 1
        n += 1
    return n
