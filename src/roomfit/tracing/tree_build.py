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
from roomfit.typing import FloatArray, IntArray

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
    first, count = np.zeros(size, np.int64), np.zeros(size, np.int64)
    boxes = np.zeros((size, 2, 3))
    order = np.arange(n)
    count[0], used = n, 1
    node = 0
    while node < used:  # children are added behind, so all nodes come in turn
        a, b = first[node], first[node] + count[node]
        boxes[node] = _around(box_m, order[a:b])
        cut = _best_cut(box_m, order[a:b], boxes[node], level[node])
        if cut > 0:
            left[node] = used
            for child in range(2):
                level[used + child] = level[node] + 1
            first[used], count[used] = a, cut
            first[used + 1], count[used + 1] = a + cut, b - a - cut
            used += 2
        node += 1
    return BinaryTree(left[:used], first[:used], count[:used], boxes[:used], order)


@kernel()
def _around(box_m: FloatArray, members: IntArray) -> FloatArray:
    box = np.empty((2, 3))
    box[0], box[1] = np.inf, -np.inf
    for i in members:
        for axis in range(3):
            box[0, axis] = min(box[0, axis], box_m[i, 0, axis])
            box[1, axis] = max(box[1, axis], box_m[i, 1, axis])
    return box


@kernel()
def _half_area(box: FloatArray) -> float:
    x, y, z = box[1, 0] - box[0, 0], box[1, 1] - box[0, 1], box[1, 2] - box[0, 2]
    return float(x * y + y * z + z * x)


@kernel()
def _best_cut(box_m: FloatArray, members: IntArray, box: FloatArray, level: int) -> int:
    """Sort the members and return how many go to the first child; 0 for a leaf."""
    n = len(members)
    if n == 1:
        return 0
    middle = np.empty(n)
    areas = np.empty(n)
    best, cut = np.inf, n // 2
    best_members = members.copy()
    for axis in range(3):
        for i in range(n):
            middle[i] = box_m[members[i], 0, axis] + box_m[members[i], 1, axis]
        along = members[np.argsort(middle, kind="mergesort")]
        _growing_areas(box_m, along, areas)
        backward = _growing_areas_backward(box_m, along)
        for k in range(1, n):
            cost = areas[k - 1] * k + backward[k] * (n - k)
            if cost < best:
                best, cut = cost, k
                best_members[:] = along
    area = _half_area(box)
    if n <= MAX_LEAF and NODE_COST * area + best >= area * n:
        return 0
    members[:] = best_members
    return n // 2 if level >= _MAX_LEVEL else cut


@kernel()
def _growing_areas(box_m: FloatArray, members: IntArray, areas: FloatArray) -> None:
    """Write half the surface of the box around the first 1, 2, ... members."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for i, member in enumerate(members):
        for axis in range(3):
            low[axis] = min(low[axis], box_m[member, 0, axis])
            high[axis] = max(high[axis], box_m[member, 1, axis])
        x, y, z = high[0] - low[0], high[1] - low[1], high[2] - low[2]
        areas[i] = x * y + y * z + z * x


@kernel()
def _growing_areas_backward(box_m: FloatArray, members: IntArray) -> FloatArray:
    areas = np.empty(len(members))
    _growing_areas(box_m, members[::-1], areas)
    return areas[::-1]


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
