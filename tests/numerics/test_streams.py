import contextlib
from itertools import product

import numpy as np
import pytest

from trl_explore.numerics.streams import Stream, generator, key


def test_streams_are_numbered_for_good():
    assert {stream.name: int(stream) for stream in Stream} == {
        "WEIGHTS": 0,
        "ENVIRONMENT": 1,
        "ACTION": 2,
        "STRATEGY": 3,
        "EVALUATION": 4,
    }


def test_generator_is_philox_at_a_counter():
    words = np.random.SeedSequence(3, spawn_key=(2,)).generate_state(2, np.uint64)
    counter = (7 << 192) | (5 << 128)  # words (block, 0, episode 5, trial 7), lowest first
    philox = np.random.Philox(key=int(words[0]) | int(words[1]) << 64, counter=counter)
    expected = np.random.Generator(philox).random(20)
    np.testing.assert_array_equal(generator(3, Stream.ACTION, 7, 5).random(20), expected)


def test_key_cannot_be_spoilt():
    first = key(0, Stream.ACTION).copy()
    with contextlib.suppress(ValueError):
        key(0, Stream.ACTION)[:] = 0
    np.testing.assert_array_equal(key(0, Stream.ACTION), first)
    assert first.dtype == np.uint64
    assert first.shape == (2,)


def test_a_stream_depends_on_nothing_but_its_coordinates():
    first = generator(1, Stream.ENVIRONMENT, 4, 2).random(8)
    np.random.default_rng().random()
    generator(1, Stream.ENVIRONMENT, 3, 2).random(1000)
    generator(1, Stream.ACTION, 4, 2).random(1000)
    np.testing.assert_array_equal(generator(1, Stream.ENVIRONMENT, 4, 2).random(8), first)
    np.testing.assert_array_equal(
        generator(np.int64(1), Stream.ENVIRONMENT, np.int64(4), np.int64(2)).random(8), first
    )


def test_no_two_streams_share_a_number():
    places = list(product((0, 1, 2, 30, 2**31), Stream, (0, 1, 2, 29), (0, 1, 2, 500)))
    draws = np.concatenate([generator(*place).integers(2**63, size=50) for place in places])
    assert len(np.unique(draws)) == len(places) * 50


def test_an_episode_does_not_run_into_the_next_one():
    long = generator(0, Stream.ACTION, 0, 0).integers(2**63, size=100_000)
    after = [(0, 1), (0, 2), (1, 0), (1, 1)]
    others = [generator(0, Stream.ACTION, *place).integers(2**63, size=1000) for place in after]
    assert not np.isin(np.concatenate(others), long).any()


def test_streams_of_neighbouring_trials_are_uniform_and_uncorrelated():
    draws = np.stack([generator(0, Stream.ACTION, trial).random(400) for trial in range(100)])
    assert draws.mean() == pytest.approx(0.5, abs=4 * np.sqrt(1 / 12 / draws.size))
    across = [draws[:, :-1] * draws[:, 1:], draws[:-1] * draws[1:]]  # in time, between trials
    for pairs in across:
        assert pairs.mean() == pytest.approx(0.25, abs=4 * np.sqrt(7 / 144 / pairs.size))


def test_seed_zero_is_a_seed():
    zero = generator(0, Stream.WEIGHTS, 0).random(4)
    assert len(set(zero)) == 4
    assert not np.array_equal(zero, generator(1, Stream.WEIGHTS, 0).random(4))


def test_seeds_beyond_32_bits_share_no_stream():
    seeds = (0, 5, 2**32, 5 + 2**32, 2**33, 2**64)
    assert len({tuple(key(seed, stream)) for seed in seeds for stream in Stream}) == 6 * len(Stream)


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ((-1, Stream.ACTION, 0, 0), "seed.*-1"),
        ((0, Stream.ACTION, -1, 0), "trial.*episode.*>= 0.*-1.*0"),
        ((0, Stream.ACTION, 0, -2), "trial.*episode.*>= 0.*0.*-2"),
    ],
)
def test_negative_coordinates(place, message):
    with pytest.raises(ValueError, match=message):
        generator(*place)
