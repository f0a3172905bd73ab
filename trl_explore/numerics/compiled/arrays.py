"""Arrays in compiled code without reference counts or heap memory, and explicit vectors.

A compiler may not vectorise a sum, because that changes its order. ``dot`` is therefore written as
eight sums side by side. The order is fixed and does not depend on the numbers' place in memory.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numba as nb
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.errors import TypingError
from numba.extending import intrinsic
from numba.np.numpy_support import as_dtype

WIDTH = 8
"""Numbers per vector; arrays are processed in whole groups of this size."""
MOST_COLUMNS = 16
"""With at most this many columns, rows are read as one vector and transposed in registers."""
STACK_BYTES = 1 << 15
"""Larger arrays go to the heap: the stack is limited, and they would take minutes to compile."""

_INT32, _DOUBLE = ir.IntType(32), ir.DoubleType()


@intrinsic
def borrow(typingctx, array):
    """A view without ownership: taking rows from it costs no atomic reference counts.

    The caller's array must outlive the view; function arguments do.
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
    """Column j of an array [size, SIMD lanes], without ownership."""
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


def on_stack(dtype: types.Type, *shape: int) -> Any:
    """A compiled function that returns an array on its caller's stack.

    The compiler knows that no other array overlaps it, and that its sizes are constants, so it
    vectorises loops over it. An array larger than ``STACK_BYTES`` is on the heap.
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
    """Prevent vectorisation of the enclosing loop."""

    def codegen(context, builder, signature, args):
        nothing = ir.FunctionType(ir.VoidType(), [])
        builder.asm(nothing, "", "", [], side_effect=True)
        return context.get_dummy_value()

    return types.none(), codegen


@intrinsic
def dot(typingctx: Any, x: Any, y: Any, groups: Any) -> Any:
    """Σ_i x_i y_i over WIDTH · groups numbers, in double; twin: ``numpy.dot``.

    It keeps eight partial sums and adds them pairwise at the end.
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        double = ir.VectorType(_DOUBLE, WIDTH)
        arrays = [_data(context, builder, signature.args[j], args[j]) for j in (0, 1)]
        total = cgutils.alloca_once_value(builder, ir.Constant(double, [0.0] * WIDTH))
        with cgutils.for_range(builder, args[2]) as loop:
            factors, first = [], _times(builder, loop.index, WIDTH)
            for array in arrays:
                numbers = _load(builder, array, first, WIDTH)
                exact = numbers.type == double
                factors.append(numbers if exact else builder.fpext(numbers, double))
            builder.store(builder.fadd(builder.load(total), builder.fmul(*factors)), total)
        sums, size = builder.load(total), WIDTH
        while size > 1:
            size //= 2
            halves = [_pick(builder, sums, range(low, low + size)) for low in (0, size)]
            sums = builder.fadd(*halves)
        return builder.extract_element(sums, ir.Constant(_INT32, 0))

    return types.float64(x, y, types.intp), codegen


@lru_cache(maxsize=32)
def columns(n: int) -> Callable[..., None]:
    """A compiled ``take(x, start, out, groups)``; twin: ``numpy.transpose``.

    out[k, f] = x[start + f, k], for f < 8 groups.

    Args:
        n: the number of columns of x [*, n]; ``out`` is [n, *].
    """
    return _take_vectors(n) if n <= MOST_COLUMNS else _take


@nb.njit(nogil=True, error_model="numpy", forceinline=True)
def _take(x, start, out, groups):
    for k in range(x.shape[1]):
        for f in range(WIDTH * groups):
            out[k, f] = x[start + f, k]


def _take_vectors(n: int) -> Callable[..., None]:
    @intrinsic
    def take(typingctx: Any, x: Any, start: Any, out: Any, groups: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            source = _data(context, builder, signature.args[0], args[0])
            source = builder.gep(source, [_times(builder, args[1], n)])
            target = context.make_array(signature.args[2])(context, builder, value=args[2])
            length = builder.extract_value(target.shape, 1)
            with cgutils.for_range(builder, args[3]) as loop:
                first = _times(builder, loop.index, WIDTH)
                numbers = _load(builder, source, _times(builder, first, n), WIDTH * n)
                for k in range(n):
                    column = _pick(builder, numbers, range(k, WIDTH * n, n))
                    place = builder.add(first, _times(builder, length, k))
                    pointer = builder.gep(target.data, [place])
                    pointer = builder.bitcast(pointer, column.type.as_pointer())
                    builder.store(column, pointer, align=_bytes(column))
            return context.get_dummy_value()

        return types.void(x, types.intp, out, types.intp), codegen

    return take


def _data(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    """A pointer to the first number of an array."""
    return context.make_array(kind)(context, builder, value=array).data


def _load(builder: Any, pointer: Any, first: Any, size: int) -> Any:
    """The ``size`` numbers from index ``first`` on; only single numbers need be aligned."""
    kind = ir.VectorType(pointer.type.pointee, size)
    loaded = builder.load(builder.bitcast(builder.gep(pointer, [first]), kind.as_pointer()))
    loaded.align = _bytes(loaded)
    return loaded


def _times(builder: Any, index: Any, factor: int) -> Any:
    return builder.mul(index, ir.Constant(index.type, factor))


def _bytes(vector: Any) -> int:
    return 8 if vector.type.element == _DOUBLE else 4


def _pick(builder: Any, vector: Any, places: Any) -> Any:
    places = list(places)
    mask = ir.Constant(ir.VectorType(_INT32, len(places)), places)
    return builder.shuffle_vector(vector, vector, mask)
