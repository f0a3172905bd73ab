"""Compiled Philox4x64-10 with the bits of numpy's ``Generator(Philox(key, counter)).random()``.

Salmon, Moraes, Dror & Shaw (2011), "Parallel random numbers: as easy as 1, 2, 3".
"""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

import numba as nb
import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

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
