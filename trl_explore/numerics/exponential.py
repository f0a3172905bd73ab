"""Exponential and logarithm of float32 numbers without branches, calls or tables.

The C library's functions are called for one number at a time. These are additions, products and
operations on bits, in a fixed order, so that a loop over an array becomes vector instructions and
a number's result does not depend on where it stands. The polynomials are those of Moshier's Cephes
(expf.c, logf.c), which Eigen and others use in the same way.
"""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from trl_explore.envs.kernels.kernel import kernel_function

_ZERO, _HALF, _ONE = map(np.float32, (0.0, 0.5, 1.0))
_INF, _NAN = np.float32(np.inf), np.float32(np.nan)

# log 2 in two parts: the first has nine bits, so that its product with an exponent is exact.
_LN2_HIGH, _LN2_LOW = np.float32(0.693359375), np.float32(-2.12194440e-4)
_LOG2_E = np.float32(1.4426950408889634)
_ROUNDER = np.float32(1.5 * 2**23)
"""A number plus this one has the nearest integer in its low bits."""
_LOWEST, _HIGHEST = np.float32(-104.0), np.float32(89.0)
"""Behind these, e^x is 0 or infinite in float32."""
_E0, _E1, _E2, _E3, _E4, _E5 = map(
    np.float32,
    (
        *(5.0000001201e-1, 1.6666665459e-1, 4.1665795894e-2),
        *(8.3334519073e-3, 1.3981999507e-3, 1.9875691500e-4),
    ),
)

_TINY, _GROWTH, _GROWN = np.float32(2.0**-126), np.float32(2.0**23), np.float32(23.0)
"""Numbers below the first have fewer bits; the second, 2 to the third, makes them normal."""
_SQRT2_1 = np.float32(0.41421356)
_L0, _L1, _L2, _L3, _L4, _L5, _L6, _L7, _L8 = map(
    np.float32,
    (
        *(3.3333331174e-1, -2.4999993993e-1, 2.0000714765e-1, -1.6668057665e-1),
        *(1.4249322787e-1, -1.2420140846e-1, 1.1676998740e-1, -1.1514610310e-1, 7.0376836292e-2),
    ),
)

_I32, _F32 = ir.IntType(32), ir.FloatType()


@intrinsic
def _scaled(typingctx, x, rounded):
    """The product x 2^n, for the n in the low bits of n + _ROUNDER; rounded once."""

    def codegen(context, builder, signature, args):
        bits = builder.bitcast(args[1], _I32)
        n = builder.sub(bits, ir.Constant(_I32, int(_ROUNDER.view(np.int32))))
        half = builder.ashr(n, ir.Constant(_I32, 1))  # 2^n itself need not be a float32
        result = args[0]
        for part in (half, builder.sub(n, half)):
            biased = builder.add(part, ir.Constant(_I32, 127))
            power = builder.bitcast(builder.shl(biased, ir.Constant(_I32, 23)), _F32)
            result = builder.fmul(result, power)
        return result

    return types.float32(types.float32, types.float32), codegen


@intrinsic
def _split(typingctx, x):
    """The pair (n, m) with x = 2^n m and m in [√½, √2), for a normal x > 0."""

    def codegen(context, builder, signature, args):
        bits = builder.bitcast(args[0], _I32)
        root = ir.Constant(_I32, int(np.float32(np.sqrt(0.5)).view(np.int32)))
        place = ir.Constant(_I32, 23)
        n = builder.ashr(builder.sub(bits, root), place)
        m = builder.bitcast(builder.sub(bits, builder.shl(n, place)), _F32)
        return context.make_tuple(builder, signature.return_type, (builder.sitofp(n, _F32), m))

    return types.UniTuple(types.float32, 2)(types.float32), codegen


@kernel_function
def exp32(x):
    """The exponential e^x of any float32, within 2 units in the last place; NaN stays NaN.

    It is e^r 2^n, where n is the integer nearest to x / log 2 and r = x − n log 2.
    """
    x = _LOWEST if x < _LOWEST else x
    x = _HIGHEST if x > _HIGHEST else x
    rounded = x * _LOG2_E + _ROUNDER
    n = rounded - _ROUNDER
    r = (x - n * _LN2_HIGH) - n * _LN2_LOW
    p = _E0 + r * (_E1 + r * (_E2 + r * (_E3 + r * (_E4 + r * _E5))))
    return _scaled(_ONE + (r + r * r * p), rounded)


@kernel_function
def log32(x):
    """The natural logarithm of any float32, within 2 units in the last place.

    Infinite at infinity, −∞ at 0, NaN below. It is log m + n log 2, where x = 2^n m.
    """
    small = x < _TINY
    n, m = _split(x * _GROWTH if small else x)
    n = n - _GROWN if small else n
    y = _log(m - _ONE, n)
    y = y if x < _INF else x
    return y if x > _ZERO else (-_INF if x == _ZERO else _NAN)


@kernel_function
def log1p32(x):
    """The logarithm of 1 + x for 0 <= x <= 1, within 2 units in the last place; NaN stays NaN.

    Where x is small, so is log (1 + x), and 1 + x has lost what matters.
    """
    large = x > _SQRT2_1
    return _log((x - _ONE) * _HALF if large else x, _ONE if large else _ZERO)


@kernel_function
def _log(f, n):
    """The sum of log (1 + f) and n log 2, for √½ <= 1 + f < √2."""
    z = f * f
    p = _L4 + f * (_L5 + f * (_L6 + f * (_L7 + f * _L8)))
    p = _L0 + f * (_L1 + f * (_L2 + f * (_L3 + f * p)))
    y = (f * z * p + n * _LN2_LOW) - _HALF * z
    return (f + y) + n * _LN2_HIGH
