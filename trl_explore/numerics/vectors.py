"""Vector instructions that a compiler does not find by itself, because they change an order.

A sum must run in the order in which it is written; here it is written as eight sums side by side.
The order is fixed, and nothing depends on where in memory the numbers lie.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numba as nb
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

WIDTH = 8
"""Numbers side by side; arrays are taken in whole groups of so many."""
MOST_COLUMNS = 16
"""Up to so many columns, rows of a matrix are read as one vector and sorted in registers."""

_INT32, _DOUBLE = ir.IntType(32), ir.DoubleType()


@intrinsic
def dot(typingctx: Any, x: Any, y: Any, groups: Any) -> Any:
    """Σ_i x_i y_i over WIDTH · groups numbers, in double: eight sums, added pairwise in the end."""

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
    """A compiled ``take(x, start, out, groups)``: out[k, f] = x[start + f, k], for f < 8 groups.

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
    """The ``size`` numbers from place ``first`` on; numbers are aligned, vectors need not be."""
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
