"""Eight boxes against one ray at once, written in LLVM's vector instructions.

The compiler does not turn a loop over eight boxes into vector code by itself; without it the
search for the next wall in a large mesh takes about twice as long.
"""

# ruff: noqa: ARG001 -- numba calls these functions with the types or values of all arguments
# mypy: disable-error-code="import-untyped, no-untyped-call"

from __future__ import annotations

import platform
from collections.abc import Callable
from typing import Any, cast

import llvmlite.binding as llvm
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from roomfit.typing import FloatArray, IntArray

WIDTH = 8
# lowest x, y, z of the eight children of a node, then the highest
ROWS = 6
NODE_FLOATS = ROWS * WIDTH
# more than a walk through any tree ever keeps waiting, see `roomfit.tracing.tree_build`
STACK = 512

_FLOATS = ir.VectorType(ir.FloatType(), WIDTH)


def _fuses() -> bool:
    """Whether multiply-add is one instruction here; where not, asking for it is slow."""
    return platform.machine() in ("arm64", "aarch64") or bool(
        llvm.get_host_cpu_features().get("fma", False)
    )


def _type_boxes_hit(
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

    Parameters
    ----------
    bounds : float32 array, flat
        `NODE_FLOATS` for each node.
    node : int
    near_x, near_y, near_z : int
        Row of the planes that the ray meets first along each axis: 0, 1, 2 where it runs towards
        higher coordinates and 3, 4, 5 otherwise.
    inverse_x, inverse_y, inverse_z : float32
        One over the direction, finite.
    shift_x, shift_y, shift_z : float32
        Start times `inverse`.
    limit : float32
        Boxes entered later are left out.
    entries : float32 array, shape (at least 8,)
        Receives the distance at which each box is entered.
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


def _type_lowest_bit(typingctx: Any, bits: Any) -> Any:
    """Return the number of the lowest set bit; only for use in kernels."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.cttz(arguments[0], ir.IntType(1)(1))

    return types.int64(types.int64), code


def _type_local_floats(typingctx: Any) -> Any:
    """Return `STACK` float32 on the function's own stack, not zeroed; only for use in kernels."""
    return _local(types.float32)


def _type_local_ints(typingctx: Any) -> Any:
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


boxes_hit = cast(Callable[..., int], intrinsic(_type_boxes_hit))
lowest_bit = cast(Callable[[int], int], intrinsic(_type_lowest_bit))
local_floats = cast(Callable[[], FloatArray], intrinsic(_type_local_floats))
local_ints = cast(Callable[[], IntArray], intrinsic(_type_local_ints))
