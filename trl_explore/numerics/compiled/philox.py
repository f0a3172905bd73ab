"""Random numbers, compiled: uniform ones by Philox4x64-10, and normal ones from these.

The uniform numbers have the bits of numpy's ``Generator(Philox(key, counter)).random()``: Salmon,
Moraes, Dror & Shaw (2011), "Parallel random numbers: as easy as 1, 2, 3". The inverse of the normal
distribution function consists of torch's operations.
"""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

import math

import numba as nb
import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from trl_explore.numerics.compiled.cache import kernel_function

STATE_SIZE = 11
"""Words of a stream's state: key [2], counter [4], block [4], index in the block."""

_M0, _M1 = np.uint64(0xD2E7470EE14C6C93), np.uint64(0xCA5A826395121157)
_W0, _W1 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBB67AE8584CAA73B)
_ZERO, _ONE, _FOUR, _SIX = np.uint64(0), np.uint64(1), np.uint64(4), np.uint64(6)
_ELEVEN = np.uint64(11)


@intrinsic
def _multiply(typingctx, a, b):
    """The upper and the lower 64 bits of a 128-bit product (one machine instruction)."""

    def codegen(context, builder, signature, args):
        wide, word = ir.IntType(128), ir.IntType(64)
        product = builder.mul(*(builder.zext(arg, wide) for arg in args))
        high = builder.trunc(builder.lshr(product, ir.Constant(wide, 64)), word)
        parts = high, builder.trunc(product, word)
        return context.make_tuple(builder, signature.return_type, parts)

    return types.UniTuple(types.uint64, 2)(types.uint64, types.uint64), codegen


@nb.njit(error_model="numpy", forceinline=True)
def philox_block(k0, k1, c0, c1, c2, c3):
    """Block of key (k0, k1) at counter (c0, c1, c2, c3); twin: ``streams.generator``."""
    for _ in range(10):
        h0, l0 = _multiply(_M0, c0)
        h1, l1 = _multiply(_M1, c2)
        c0, c1, c2, c3 = h1 ^ c1 ^ k0, l1, h0 ^ c3 ^ k1, l0
        k0 += _W0
        k1 += _W1
    return c0, c1, c2, c3


@nb.njit(error_model="numpy", forceinline=True)
def to_unit(word):
    """A number in [0, 1) from the upper 53 bits of a word; twin: ``streams.generator``."""
    return np.float64(word >> _ELEVEN) * (1.0 / 9007199254740992.0)


@nb.njit(error_model="numpy", forceinline=True)
def begin(rng, key, episode, trial):
    """Set ``rng`` [STATE_SIZE] to the start of a stream; twin: ``streams.generator``."""
    rng[0], rng[1] = key[0], key[1]
    rng[2], rng[3], rng[4], rng[5] = _ZERO, _ZERO, np.uint64(episode), np.uint64(trial)
    rng[10] = _FOUR


@nb.njit(error_model="numpy", forceinline=True)
def random(rng):
    """The next number of a stream, uniform in [0, 1); twin: ``streams.generator``."""
    if rng[10] == _FOUR:
        rng[2] += _ONE  # no carry: an episode cannot use 2^64 blocks
        block = philox_block(rng[0], rng[1], rng[2], rng[3], rng[4], rng[5])
        rng[6], rng[7], rng[8], rng[9] = block
        rng[10] = _ZERO
    word = rng[_SIX + rng[10]]
    rng[10] += _ONE
    return to_unit(word)


_TAIL = 0.13533528323661269189
"""e^-2; below it, and above 1 − e^-2, the approximation is in 1 / √(−2 log y)."""
_SQRT_2PI = 2.50662827463100050242

# The coefficients of Moshier's Cephes (ndtri.c), which torch uses too (ATen/native/Math.h).
_P0 = np.array(
    (-59.9633501014107895267, 98.0010754185999661536, -56.6762857469070293439,
     13.9312609387279679503, -1.23916583867381258016)
)  # fmt: skip
_Q0 = np.array(
    (1.0, 1.95448858338141759834, 4.67627912898881538453, 86.3602421390890590575,
     -225.462687854119370527, 200.260212380060660359, -82.0372256168333339912,
     15.9056225126211695515, -1.18331621121330003142)
)  # fmt: skip
_P1 = np.array(
    (4.05544892305962419923, 31.5251094599893866154, 57.1628192246421288162, 44.0805073893200834700,
     14.6849561928858024014, 2.18663306850790267539, -1.40256079171354495875e-1,
     -3.50424626827848203418e-2, -8.57456785154685413611e-4)
)  # fmt: skip
_Q1 = np.array(
    (1.0, 15.7799883256466749731, 45.3907635128879210584, 41.3172038254672030440,
     15.0425385692907503408, 2.50464946208309415979, -1.42182922854787788574e-1,
     -3.80806407691578277194e-2, -9.33259480895457427372e-4)
)  # fmt: skip
_P2 = np.array(
    (3.23774891776946035970, 6.91522889068984211695, 3.93881025292474443415,
     1.33303460815807542389, 2.01485389549179081538e-1, 1.23716634817820021358e-2,
     3.01581553508235416007e-4, 2.65806974686737550832e-6, 6.23974539184983293730e-9)
)  # fmt: skip
_Q2 = np.array(
    (1.0, 6.02427039364742014255, 3.67983563856160859403, 1.37702099489081330271,
     2.16236993594496635890e-1, 1.34204006088543189037e-2, 3.28014464682127739104e-4,
     2.89247864745380683936e-6, 6.79019408009981274425e-9)
)  # fmt: skip


@kernel_function
def _polynomial(x, coefficients):
    result = 0.0
    for k in range(len(coefficients)):
        result = result * x + coefficients[k]
    return result


@kernel_function
def ndtri(p):
    """The z with Φ(z) = p, for p in (0, 1); twin: ``torch.special.ndtri``."""
    upper = p > 1 - _TAIL
    y = 1 - p if upper else p
    if y > _TAIL:
        y -= 0.5
        square = y * y
        central = y + y * (square * _polynomial(square, _P0) / _polynomial(square, _Q0))
        return central * _SQRT_2PI
    x = math.sqrt(-2 * math.log(y))
    z = 1 / x
    if x < 8:
        change = z * _polynomial(z, _P1) / _polynomial(z, _Q1)
    else:
        change = z * _polynomial(z, _P2) / _polynomial(z, _Q2)
    x = x - math.log(x) / x - change
    return x if upper else -x
