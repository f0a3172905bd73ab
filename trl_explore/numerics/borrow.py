"""Arrays in compiled code without the cost of counting references, or of memory from the heap."""

from __future__ import annotations

import math
from typing import Any

import numba as nb
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.errors import TypingError
from numba.extending import intrinsic
from numba.np.numpy_support import as_dtype


@intrinsic
def borrow(typingctx, array):
    """The same array, not owned: rows taken from it cost no atomic reference counts.

    The caller's array must outlive it; arguments of a function do.
    """
    if not isinstance(array, types.Array):
        raise TypingError(f"borrow takes an array, got {array}")

    def codegen(context, builder, signature, args):
        view = context.make_array(signature.return_type)(context, builder, value=args[0])
        view.meminfo = cgutils.get_null_value(view.meminfo.type)
        return view._getvalue()

    return array(array), codegen


@intrinsic
def lane(typingctx, array, j):
    """Column j of an array [size, lanes], not owned."""
    if not isinstance(array, types.Array) or array.ndim != 2:
        raise TypingError(f"lane takes an array with two dimensions, got {array}")
    column = types.Array(array.dtype, 1, "A")

    def codegen(context, builder, signature, args):
        whole = context.make_array(array)(context, builder, value=args[0])
        view = context.make_array(column)(context, builder)
        context.populate_array(
            view,
            data=builder.gep(whole.data, [args[1]]),
            shape=cgutils.unpack_tuple(builder, whole.shape, 2)[:1],
            strides=cgutils.unpack_tuple(builder, whole.strides, 2)[:1],
            itemsize=whole.itemsize,
            meminfo=None,
        )
        return view._getvalue()

    return column(array, types.intp), codegen


STACK_BYTES = 1 << 15
"""Larger arrays are not for the stack, which ends somewhere; to compile them takes minutes."""


def on_stack(dtype: types.Type, *shape: int) -> Any:
    """A compiled function that returns an array on the stack of the function that calls it.

    No other array overlaps it, and its sizes are constants: the compiler knows both, and turns
    loops over it into vector instructions. One of more than ``STACK_BYTES`` is on the heap.
    """
    array, item = types.Array(dtype, len(shape), "C"), as_dtype(dtype)
    if item.itemsize * math.prod(shape) > STACK_BYTES:
        return nb.njit(nogil=True)(lambda: np.zeros(shape, item))

    @intrinsic
    def make(typingctx):
        def codegen(context, builder, signature, args):
            item = context.get_data_type(dtype)
            size = context.get_abi_sizeof(item)
            memory = cgutils.alloca_once(builder, ir.ArrayType(item, math.prod(shape)))
            memory.align = 64
            whole = context.make_array(array)(context, builder)
            strides = [size * math.prod(shape[i + 1 :]) for i in range(len(shape))]
            context.populate_array(
                whole,
                data=builder.bitcast(memory, item.as_pointer()),
                shape=[context.get_constant(types.intp, n) for n in shape],
                strides=[context.get_constant(types.intp, n) for n in strides],
                itemsize=context.get_constant(types.intp, size),
                meminfo=None,
            )
            return whole._getvalue()

        return array(), codegen

    return make


@intrinsic
def one_by_one(typingctx):
    """Keeps the loop that it stands in from becoming vector instructions."""

    def codegen(context, builder, signature, args):
        nothing = ir.FunctionType(ir.VoidType(), [])
        builder.asm(nothing, "", "", [], side_effect=True)
        return context.get_dummy_value()

    return types.none(), codegen
