"""Exponential, logarithm, sine and cosine without branches or library calls.

The C library's functions take one number per call. These functions consist of sums, products and
bit operations in a fixed order, so that a loop over an array becomes vector instructions, and a
number's result does not depend on its place in the array.
"""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from trl_explore.numerics.compiled.cache import compiled, kernel_function

# Exponential and logarithm in float32: the polynomials of Moshier's Cephes (expf.c, logf.c), which
# Eigen and others also use.

_ZERO, _HALF, _ONE = map(np.float32, (0.0, 0.5, 1.0))
_INF, _NAN = np.float32(np.inf), np.float32(np.nan)

# log 2 in two parts: the first has nine bits, so that its product with an exponent n is exact.
_LN2_HIGH, _LN2_LOW = np.float32(0.693359375), np.float32(-2.12194440e-4)
_LOG2_E = np.float32(1.4426950408889634)
_ROUNDER = np.float32(1.5 * 2**23)
"""x plus this constant has the integer nearest to x in its low bits."""
_LOWEST, _HIGHEST = np.float32(-104.0), np.float32(89.0)
"""Outside these bounds, e^x is 0 or infinite in float32."""
_E0, _E1, _E2, _E3, _E4, _E5 = map(
    np.float32,
    (
        *(5.0000001201e-1, 1.6666665459e-1, 4.1665795894e-2),
        *(8.3334519073e-3, 1.3981999507e-3, 1.9875691500e-4),
    ),
)

_TINY, _GROWTH, _GROWN = np.float32(2.0**-126), np.float32(2.0**23), np.float32(23.0)
"""Numbers below _TINY are subnormal; the factor _GROWTH = 2^_GROWN makes them normal."""
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
    """The product x 2^n, rounded once; ``rounded`` is n + _ROUNDER."""

    def codegen(context, builder, signature, args):
        bits = builder.bitcast(args[1], _I32)
        n = builder.sub(bits, ir.Constant(_I32, int(_ROUNDER.view(np.int32))))
        half = builder.ashr(n, ir.Constant(_I32, 1))  # 2^n alone may be out of range
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
    """The exponential of a float32; twin: ``numpy.exp``.

    The error is at most 2 units in the last place; NaN stays NaN. It is e^r 2^n, where n is the
    integer nearest to x / log 2, and r = x − n log 2.
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
    """The natural logarithm of a float32; twin: ``numpy.log``.

    The error is at most 2 units in the last place; ∞ at ∞, −∞ at 0, NaN below 0. It is
    log m + n log 2, where x = 2^n m.
    """
    small = x < _TINY
    n, m = _split(x * _GROWTH if small else x)
    n = n - _GROWN if small else n
    y = _log(m - _ONE, n)
    y = y if x < _INF else x
    return y if x > _ZERO else (-_INF if x == _ZERO else _NAN)


@kernel_function
def log1p32(x):
    """The logarithm of 1 + x for a float32 0 <= x <= 1; twin: ``numpy.log1p``.

    The error is at most 2 units in the last place; NaN stays NaN. For small x, computing 1 + x
    first would lose the significant bits.
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


# Sine and cosine of small angles in float64. For 2^-26 < |x| < 0.855 they perform the same
# operations as the GNU C library on processors with fused multiply-add
# (sysdeps/ieee754/dbl-64/s_sin.c, do_sin and do_cos): a table of sine and cosine at multiples of
# 1/128, each in two parts, and polynomials in the remainder; for the sine of |x| < 0.126, a Taylor
# polynomial. Equal bits matter, because a balanced pole amplifies a rounding difference by e^0.08
# per step. Another C library may round differently; ``agree`` tests the one in use.

MAX_ANGLE = 0.85
"""The largest |x| that ``cos_sin`` supports."""

_BIG = 1.5 * 2.0**45
"""x plus this constant has the multiple of 1/128 nearest to x in its low bits."""
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
    """Sine and cosine of k/128 for k < 128, each as the nearest float64 and remainder [128]."""
    one = 1 << 192  # fixed-point numbers: integers in units of 2^-192
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
    """The value a b + c, rounded once."""

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
    """Cosine and sine of |x| <= MAX_ANGLE; twins: ``math.cos`` and ``math.sin``."""
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


@compiled()
def _differences(angles):
    count = 0
    for x in angles:
        cos, sin = cos_sin(x)
        count += cos != math.cos(x) or sin != math.sin(x)
    return count


@lru_cache(maxsize=1)
def agree() -> bool:
    """Whether ``cos_sin`` gives the same bits as this machine's C library, at 20,000 angles."""
    near, far = np.linspace(-0.25, 0.25, 10_001), np.linspace(-MAX_ANGLE, MAX_ANGLE, 10_001)
    return _differences(np.concatenate([near, far])) == 0


# Sine and cosine of small angles in float32, as in numpy's vector code. For |x| <= π/4 these are
# the polynomials in x² of numpy/_core/src/umath/loops_trigonometric (cosine to x⁸, sine to x⁹),
# with every product and sum fused. In one case of a thousand the last bit differs from the
# correctly rounded value; it is visible in the observation of an environment with a float32 state.
# On processors without fused operations numpy calls the C library.

_COSINE = "-0x1p-1", "0x1.55553cp-5", "-0x1.6c06dcp-10", "0x1.98e616p-16"
_SINE = "-0x1.555556p-3", "0x1.11119ap-7", "-0x1.a06bbap-13", "0x1.7d3bbcp-19"
_COS2, _COS4, _COS6, _COS8 = (np.float32(float.fromhex(c)) for c in _COSINE)
_SIN3, _SIN5, _SIN7, _SIN9 = (np.float32(float.fromhex(s)) for s in _SINE)


@kernel_function
def _fused(a, b, c):
    """The value a b + c with an exact product: that of two float32 numbers fits into float64."""
    return np.float32(np.float64(a) * np.float64(b) + np.float64(c))


@kernel_function
def cos32(x):
    """The cosine of a float32 number |x| <= π/4; twin: ``numpy.cos``."""
    square = np.float32(x * x)
    return _fused(
        _fused(_fused(_fused(_COS8, square, _COS6), square, _COS4), square, _COS2),
        square,
        np.float32(1),
    )


@kernel_function
def sin32(x):
    """The sine of a float32 number |x| <= π/4; twin: ``numpy.sin``."""
    square = np.float32(x * x)
    factor = _fused(_fused(_fused(_SIN9, square, _SIN7), square, _SIN5), square, _SIN3)
    return _fused(np.float32(factor * square), x, x)
