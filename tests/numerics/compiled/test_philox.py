from __future__ import annotations

import numba as nb
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trl_explore.numerics.compiled.philox import STATE_SIZE, begin, philox_block, random
from trl_explore.numerics.streams import Stream, generator, key


@nb.njit
def draw(stream_key, episode, trial, out):
    rng = np.empty(STATE_SIZE, dtype=np.uint64)
    begin(rng, stream_key, episode, trial)
    for i in range(len(out)):
        out[i] = random(rng)


@settings(max_examples=50, deadline=None)
@given(
    seed=st.integers(0, 2**70),
    stream=st.sampled_from(Stream),
    trial=st.integers(0, 2**40),
    episode=st.integers(0, 2**40),
)
def test_it_is_numpys_generator_bit_for_bit(seed, stream, trial, episode):
    out = np.empty(41)
    draw(key(seed, stream), episode, trial, out)
    np.testing.assert_array_equal(out, generator(seed, stream, trial, episode).random(41))


@pytest.mark.parametrize(
    ("counter", "philox_key", "expected"),
    [
        # The known answers of the authors' own test vectors (Random123, kat_vectors).
        (
            [0, 0, 0, 0],
            [0, 0],
            [0x16554D9ECA36314C, 0xDB20FE9D672D0FDC, 0xD7E772CEE186176B, 0x7E68B68AEC7BA23B],
        ),
        (
            [2**64 - 1] * 4,
            [2**64 - 1] * 2,
            [0x87B092C3013FE90B, 0x438C3C67BE8D0224, 0x9CC7D7C69CD777B6, 0xA09CAEBF594F0BA0],
        ),
    ],
)
def test_known_answers(counter, philox_key, expected):
    words = philox_block(*(np.uint64(w) for w in philox_key), *(np.uint64(w) for w in counter))
    assert [int(word) for word in words] == expected
