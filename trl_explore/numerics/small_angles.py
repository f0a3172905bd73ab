"""Sine and cosine of small angles in float64, as the C library computes them, without a call.

For 2^-26 < |x| < 0.855 the functions below are those of the GNU C library on processors with fused
multiplication and addition (sysdeps/ieee754/dbl-64/s_sin.c, ``do_sin`` and ``do_cos``), operation
by operation: a table of sine and cosine at multiples of 1/128, each in two parts, and polynomials
in the rest; for the sine of |x| < 0.126, a Taylor polynomial. The same bits matter, since a
balanced pole multiplies what is rounded differently by e^0.08 in every step. And as they neither
branch nor call, a loop over episodes becomes vector instructions.

Another library may round otherwise: ``agree`` says whether this one does not.
"""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numba as nb
import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from trl_explore.envs.kernels.kernel import kernel_function

LIMIT = 0.85
"""The largest |x| that is served."""

_BIG = 1.5 * 2.0**45
"""A number plus this one has the nearest multiple of 1/128 in its low bits."""
_TAYLOR = 0.126
_T3, _T5, _T7, _T9, _T11 = (
    float.fromhex(c)
    for c in (
        *("-0x1.5555555555555p-3", "0x1.1111111110ecep-7", "-0x1.a01a019db08b8p-13"),
        *("0x1.71de27b9a7ed9p-19", "-0x1.addffc2fcdf59p-26"),
    )
)
_S3, _S5 = -1.66666666666664880952546298448555e-01, 8.33333214285722277379541354343671e-03
_C2, _C4, _C6 = (
    4.99999999999999999999950396842453e-01,
    -4.16666666666664434524222570944589e-02,
    1.38888874007937613028114285595617e-03,
)


def _table() -> tuple[NDArray[np.float64], ...]:
    """Sine and cosine of k/128 for k < 128, each as the nearest float64 and the rest [128]."""
    one = 1 << 192  # integers in place of fractions of 2^192
    rows = []
    for k in range(128):
        sums, term, n = [0, 0], one, 0
        while term:
            sums[n % 2] += term if n % 4 < 2 else -term
            n += 1
            term = term * k // (128 * n)
        parts = []
        for value in (sums[1], sums[0]):
            high = value / one
            parts += [high, (value - int(math.ldexp(high, 192))) / one]
        rows.append(parts)
    return tuple(np.array(column) for column in zip(*rows, strict=True))


_SIN, _SIN_REST, _COS, _COS_REST = _table()


@intrinsic
def _fma(typingctx, a, b, c):
    """The sum a b + c, rounded once."""

    def codegen(context, builder, signature, args):
        return builder.fma(*args)

    return types.float64(types.float64, types.float64, types.float64), codegen


@intrinsic
def _bits(typingctx, x):
    """The bits of a float64."""

    def codegen(context, builder, signature, args):
        return builder.bitcast(args[0], ir.IntType(64))

    return types.int64(types.float64), codegen


@kernel_function
def cos_sin(x: Any) -> Any:
    """Cosine and sine of |x| <= LIMIT."""
    size = abs(x)
    place = _BIG + size
    k = _bits(place) & 127
    r = size - (place - _BIG)
    rr = r * r
    s = _fma(r * rr, _fma(rr, _S5, _S3), r)  # sin r
    c = rr * _fma(rr, _fma(rr, _C6, _C4), _C2)  # 1 − cos r
    sin, sin_rest, cos, cos_rest = _SIN[k], _SIN_REST[k], _COS[k], _COS_REST[k]
    of_cos = cos + _fma(-sin, s, _fma(-cos, c, _fma(-s, sin_rest, cos_rest)))
    of_sin = sin + _fma(cos, s, _fma(-sin, c, _fma(s, cos_rest, sin_rest)))
    xx = x * x
    p = _fma(_fma(_fma(_fma(_T11, xx, _T9), xx, _T7), xx, _T5), xx, _T3)
    near = x + (p * x) * xx
    return of_cos, near if size < _TAYLOR else math.copysign(of_sin, x)


@nb.njit(cache=True)
def _differences(angles):
    count = 0
    for x in angles:
        cos, sin = cos_sin(x)
        count += cos != math.cos(x) or sin != math.sin(x)
    return count


@lru_cache(maxsize=1)
def agree() -> bool:
    """Whether ``cos_sin`` gives the bits of this machine's C library, at 20,000 angles."""
    near, far = np.linspace(-0.25, 0.25, 10_001), np.linspace(-LIMIT, LIMIT, 10_001)
    return _differences(np.concatenate([near, far])) == 0
