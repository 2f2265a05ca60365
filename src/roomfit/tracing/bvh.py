"""The next wall of a ray: the planes of a convex room, or a bounding volume hierarchy of facets.

A binary tree of boxes is cut top-down by the surface area heuristic [1]_, all cuts along all axes
being tried, and then folded so that every node has up to eight children; the layout follows
Embree's [2]_. Boxes are tested in float32 and made wider by more than the rounding, facets in
float64, so the answer is bit for bit that of testing every facet. Eight boxes are tested against a
ray at once in LLVM's vector instructions: the compiler does not vectorise that loop by itself, and
without them the search in a large mesh takes about twice as long.

References
----------
.. [1] J. D. MacDonald, K. S. Booth, "Heuristics for ray tracing using space subdivision", Visual
       Computer 6, 153-166 (1990).
.. [2] I. Wald, S. Woop, C. Benthin, G. S. Johnson, M. Ernst, "Embree: a kernel framework for
       efficient CPU ray tracing", ACM Trans. Graphics 33 (4), 143 (2014).
"""

# ruff: noqa: ARG001, ARG005 -- numba matches functions by the names of all their arguments
# mypy: disable-error-code="import-untyped, no-untyped-call"
from __future__ import annotations

import math
import platform
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, cast

import llvmlite.binding as llvm
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload
from numba.np.arrayobj import populate_array

from roomfit.base.kernels import kernel
from roomfit.base.typing import BoolArray, FloatArray, IntArray
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

WIDTH = 8
NODE_FLOATS = 6 * WIDTH  # lowest x, y, z of the eight children of a node, then the highest
STACK = 512  # more nodes than a walk through any tree keeps waiting, see `_MAX_LEVEL`

_FLOATS = ir.VectorType(ir.FloatType(), WIDTH)


def _fuses() -> bool:
    """Whether multiply-add is one instruction here; where not, asking for it is slow."""
    return platform.machine() in ("arm64", "aarch64") or bool(
        llvm.get_host_cpu_features().get("fma", False)
    )


@intrinsic
def _boxes_hit(
    typingctx: Any,
    bounds: Any,
    node: Any,
    near_x: Any,
    near_y: Any,
    near_z: Any,
    inverse_x: Any,
    inverse_y: Any,
    inverse_z: Any,
    shift_x: Any,
    shift_y: Any,
    shift_z: Any,
    limit: Any,
    entries: Any,
) -> Any:
    """Return which of the eight boxes of a node a ray enters, as bits; only for use in kernels.

    Shapes: `entries` (at least 8,).
    """
    single = types.float32
    return types.int64(bounds, *[types.int64] * 4, *[single] * 7, entries), _code_boxes_hit


def _code_boxes_hit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    array = context.make_array(signature.args[0])(context, builder, arguments[0])
    node, *rows = arguments[1:5]
    inverses = [_spread(builder, x) for x in arguments[5:8]]
    shifts = [_spread(builder, x) for x in arguments[8:11]]
    long = node.type
    base = builder.mul(node, long(NODE_FLOATS))

    def planes(row: Any) -> Any:
        place = builder.add(base, builder.mul(row, long(WIDTH)))
        pointer = builder.bitcast(builder.gep(array.data, [place]), _FLOATS.as_pointer())
        return builder.load(pointer, align=4)

    enter = ir.Constant(_FLOATS, [0.0] * WIDTH)
    leave = _spread(builder, arguments[11])
    for axis, (row, inverse, shift) in enumerate(zip(rows, inverses, shifts, strict=True)):
        far_row = builder.sub(long(2 * axis + 3), row)
        near = _times_minus(builder, planes(row), inverse, shift)
        far = _times_minus(builder, planes(far_row), inverse, shift)
        enter = builder.select(builder.fcmp_ordered(">", near, enter), near, enter)
        leave = builder.select(builder.fcmp_ordered("<", far, leave), far, leave)
    entries = context.make_array(signature.args[12])(context, builder, arguments[12])
    out = builder.bitcast(entries.data, _FLOATS.as_pointer())
    builder.store(enter, out, align=4)
    hit = builder.fcmp_ordered("<=", enter, leave)
    return builder.zext(builder.bitcast(hit, ir.IntType(WIDTH)), long)


def _spread(builder: Any, x: Any) -> Any:
    one = builder.insert_element(ir.Constant(_FLOATS, ir.Undefined), x, ir.IntType(32)(0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(one, ir.Constant(_FLOATS, ir.Undefined), zeros)


def _times_minus(builder: Any, a: Any, b: Any, c: Any) -> Any:
    if _fuses():
        kind = ir.FunctionType(_FLOATS, [_FLOATS] * 3)
        fma = cgutils.get_or_insert_function(builder.module, kind, f"llvm.fma.v{WIDTH}f32")
        return builder.call(fma, [a, b, builder.fneg(c)])
    return builder.fsub(builder.fmul(a, b), c)


@intrinsic
def _lowest_bit(typingctx: Any, bits: Any) -> Any:
    """Return the number of the lowest set bit; only for use in kernels."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.cttz(arguments[0], ir.IntType(1)(1))

    return types.int64(types.int64), code


@intrinsic
def _local_floats(typingctx: Any) -> Any:
    """Return `STACK` float32 on the function's own stack, not zeroed; only for use in kernels."""
    return _local(types.float32)


@intrinsic
def _local_ints(typingctx: Any) -> Any:
    """Return `STACK` int32 on the function's own stack, not zeroed; only for use in kernels."""
    return _local(types.int32)


def _local(item: Any) -> Any:
    kind = types.Array(item, 1, "C")

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        length, size = (context.get_constant(types.intp, n) for n in (STACK, item.bitwidth // 8))
        data = cgutils.alloca_once(builder, context.get_data_type(item), size=STACK)
        array = context.make_array(kind)(context, builder)
        populate_array(array, data, [length], [size], size, None)
        return array._getvalue()

    return kind(), code


boxes_hit = cast(Callable[..., int], _boxes_hit)
lowest_bit = cast(Callable[[int], int], _lowest_bit)
local_floats = cast(Callable[[], FloatArray], _local_floats)
local_ints = cast(Callable[[], IntArray], _local_ints)


# Testing a node costs this much of testing a facet, and a leaf has at most so many facets: quickest
# in halls of 1,000 to 100,000 triangles.
NODE_COST = 0.7
MAX_LEAF = 4
# Deeper nodes are cut in half, so that no tree has more than this and log2(n_facets) levels and a
# walk never keeps more than `STACK` nodes waiting.
_MAX_LEVEL = 32


class BinaryTree(NamedTuple):
    """Boxes cut in two recursively; node 0 is the root."""

    left: IntArray  # int64 (n_nodes,), first child, the second stands next to it; -1 for a leaf
    first: IntArray  # int64 (n_nodes,), facets of a node: ``order[first : first + n_facets]``
    n_facets: IntArray  # int64 (n_nodes,)
    box_m: FloatArray  # (n_nodes, 2, 3)
    order: IntArray  # int64 (n_facets,)


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

    Shapes: box_m (n_nodes, 8, 2, 3), child (n_nodes, 8).
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


# Share of the room's size by which boxes are widened. The planes, the start and the product of
# both with the inverse direction are each rounded to 6e-8 of it.
_WIDER = 2e-6
_TINY = 1e-18
# a distance in float32 is never less than it was in float64 times this
_LATER = 1.0 + 2e-7


class Tree(NamedTuple):
    """Facets and the boxes around them."""

    table: FloatArray  # As in `Facets`, in the order of the leaves, like the next two
    normal: FloatArray
    material: IntArray
    bounds: np.ndarray[tuple[int], np.dtype[np.float32]]  # `NODE_FLOATS` a node, about `centre_m`
    child: IntArray  # int32, eight a node: a node, or of a leaf ``-1 - 8 first_facet - n_facets``
    centre_m: FloatArray  # (3,)


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
            tree.bounds,
            node,
            near_x,
            near_y,
            near_z,
            inverse_x,
            inverse_y,
            inverse_z,
            shift_x,
            shift_y,
            shift_z,
            limit,
            at,
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


Walls: TypeAlias = Planes | Tree


def walls_of(room: Room) -> Walls:
    """Return the structure that suits a room: planes where it is convex with few of them.

    A tree is quicker than trying every facet even where there are only eight.
    """
    planes = convex_planes(room)
    if planes is not None:
        return planes
    return tree_of(*facets_of(room))


def next_wall(walls: Walls, o: Vector, d: Vector, last: int) -> tuple[float, int]:
    """Return distance and number of the wall that a ray from `o` meets first.

    Only for use in kernels, where the type of `walls` selects the method. Infinity and -1 where the
    ray meets nothing: it has left through a leak.
    """
    raise TypeError("only compiled code may call this")


def wall_material(walls: Walls, wall: int, p: Vector) -> int:
    """Return the material of a wall at one of its points; only for use in kernels."""
    raise TypeError("only compiled code may call this")


def _kind(walls: Any) -> Any:
    return getattr(walls, "instance_class", None)


@overload(next_wall, strict=False)
def _next_wall(walls: Any, o: Any, d: Any, last: Any) -> Any:
    if _kind(walls) is Planes:
        return lambda walls, o, d, last: nearest_plane(walls, o, d)
    if _kind(walls) is Tree:
        return lambda walls, o, d, last: nearest_in_tree(walls, o, d, last)
    return None


@overload(wall_material, strict=False)
def _wall_material(walls: Any, wall: Any, p: Any) -> Any:
    if _kind(walls) is Planes:
        return lambda walls, wall, p: material_in_plane(walls, wall, p)
    if _kind(walls) is Tree:
        return lambda walls, wall, p: walls.material[wall]
    return None
