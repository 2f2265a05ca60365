"""The nearest wall in a large mesh: a tree of boxes with eight children each.

Boxes are tested in float32 and made wider by more than that can be wrong, facets in float64, so
the answer is bit for bit that of looking at every facet. The layout follows Embree's [1]_.

References
----------
.. [1] I. Wald, S. Woop, C. Benthin, G. S. Johnson, M. Ernst, "Embree: a kernel framework for
       efficient CPU ray tracing", ACM Trans. Graphics 33 (4), 143 (2014).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roomfit.compiled import kernel
from roomfit.tracing.bounce import Vector
from roomfit.tracing.facets import EDGE_M, Facets, facet_distance
from roomfit.tracing.tree_build import binary_tree, folded
from roomfit.tracing.vector import WIDTH, boxes_hit, local_floats, local_ints, lowest_bit
from roomfit.typing import FloatArray, IntArray

# Share of the room's size by which boxes are widened. The planes, the start and the product of
# both with the inverse direction are each rounded to 6e-8 of it.
_WIDER = 2e-6
_TINY = 1e-18
# a distance in float32 is never less than it was in float64 times this
_LATER = 1.0 + 2e-7


class Tree(NamedTuple):
    """Facets and the boxes around them.

    Attributes
    ----------
    table, normal, material
        As in `Facets`, in the order of the leaves.
    bounds : float32 array, flat
        For each node the lowest x, y and z of its eight children and then the highest, about
        `centre_m`.
    child : int32 array, flat
        Eight for each node: a node, or for a leaf ``-1 - 8 first_facet - n_facets``.
    centre_m : float array, shape (3,)
    """

    table: FloatArray
    normal: FloatArray
    material: IntArray
    bounds: np.ndarray[tuple[int], np.dtype[np.float32]]
    child: IntArray
    centre_m: FloatArray


def tree_of(facets: Facets, box_m: FloatArray) -> Tree:
    """Return the tree over facets whose boxes are given, shape (n_facets, 2, 3)."""
    low, high = box_m[:, 0].min(axis=0), box_m[:, 1].max(axis=0)
    centre = 0.5 * (low + high)
    wider = _WIDER * float(np.linalg.norm(high - low)) + 2.0 * EDGE_M
    binary = binary_tree(box_m)
    boxes, child = folded(binary)
    boxes = boxes - centre
    boxes[:, :, 0] -= wider
    boxes[:, :, 1] += wider
    return Tree(
        facets.table[binary.order],
        facets.normal[binary.order],
        facets.material[binary.order],
        boxes.transpose(0, 2, 3, 1).astype(np.float32).reshape(-1),
        child.astype(np.int32).reshape(-1),
        centre,
    )


@kernel(allocates=False)
def _inverse(x: float) -> np.float32:
    return np.float32(1.0 / (math.copysign(_TINY, x) if abs(x) < _TINY else x))


@kernel(allocates=False, inlined=True)
def nearest_in_tree(tree: Tree, o: Vector, d: Vector, last: int) -> tuple[float, int]:
    """Return distance and number of the facet that a ray meets first; infinity and -1 for none.

    Of facets at the same distance the one with the lowest number counts.
    """
    left = (0.0, 0.0, 0.0)
    if last >= 0:
        left = (tree.normal[last, 0], tree.normal[last, 1], tree.normal[last, 2])
    waiting, entry, at = local_ints(), local_floats(), local_floats()
    inverse_x, inverse_y, inverse_z = _inverse(d[0]), _inverse(d[1]), _inverse(d[2])
    shift_x = np.float32(o[0] - tree.centre_m[0]) * inverse_x
    shift_y = np.float32(o[1] - tree.centre_m[1]) * inverse_y
    shift_z = np.float32(o[2] - tree.centre_m[2]) * inverse_z
    near_x = 0 if inverse_x > 0.0 else 3
    near_y = 1 if inverse_y > 0.0 else 4
    near_z = 2 if inverse_z > 0.0 else 5
    best, hit, limit = np.inf, -1, np.float32(np.inf)
    n, node = 0, 0
    while True:
        bits = boxes_hit(
            *(tree.bounds, node, near_x, near_y, near_z),
            *(inverse_x, inverse_y, inverse_z, shift_x, shift_y, shift_z, limit, at),
        )
        bottom = n
        while bits:  # children wait in order, the one entered first on top
            k = lowest_bit(bits)
            bits &= bits - 1
            place = n
            while place > bottom and entry[place - 1] < at[k]:
                entry[place], waiting[place] = entry[place - 1], waiting[place - 1]
                place -= 1
            entry[place], waiting[place] = at[k], tree.child[WIDTH * node + k]
            n += 1
        node = -1
        while n > 0 and node < 0:
            n -= 1
            if entry[n] > limit:
                continue
            node = waiting[n]
            if node < 0:
                leaf = -1 - node
                for i in range(leaf >> 3, (leaf >> 3) + (leaf & 7)):
                    t = facet_distance(tree.table, i, o, d, left, best)
                    if t < best or (t == best and i < hit):
                        best, hit, limit = t, i, np.float32(t * _LATER)
        if node < 0:
            return best, hit
