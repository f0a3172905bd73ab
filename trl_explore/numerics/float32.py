"""Sine and cosine of small angles in float32, as numpy's vector code computes them.

For |x| <= π/4 these are the polynomials in x² of numpy/_core/src/umath/loops_trigonometric (cosine
to x⁸, sine to x⁹), every sum and product of which is one fused operation. They differ from the
rounded true value in the last bit, once in a thousand; an environment that keeps a float32 state
shows them in its observation. Where a processor has no fused operations numpy calls the C library.
"""

from __future__ import annotations

import numpy as np

from trl_explore.envs.kernels.kernel import kernel_function

_COSINE = "-0x1p-1", "0x1.55553cp-5", "-0x1.6c06dcp-10", "0x1.98e616p-16"
_SINE = "-0x1.555556p-3", "0x1.11119ap-7", "-0x1.a06bbap-13", "0x1.7d3bbcp-19"
_C2, _C4, _C6, _C8 = (np.float32(float.fromhex(c)) for c in _COSINE)
_S3, _S5, _S7, _S9 = (np.float32(float.fromhex(s)) for s in _SINE)


@kernel_function
def _fused(a, b, c):
    """The sum a b + c, rounded once: the product of two float32 numbers is exact in float64."""
    return np.float32(np.float64(a) * np.float64(b) + np.float64(c))


@kernel_function
def cos32(x):
    """The cosine of a float32 number |x| <= π/4."""
    square = np.float32(x * x)
    return _fused(
        _fused(_fused(_fused(_C8, square, _C6), square, _C4), square, _C2), square, np.float32(1)
    )


@kernel_function
def sin32(x):
    """The sine of a float32 number |x| <= π/4."""
    square = np.float32(x * x)
    factor = _fused(_fused(_fused(_S9, square, _S7), square, _S5), square, _S3)
    return _fused(np.float32(factor * square), x, x)
