"""Random streams: seed, purpose, trial and episode determine every random number."""

from __future__ import annotations

from enum import IntEnum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray


class Stream(IntEnum):
    """The purposes for which a trial draws random numbers; each has a separate stream."""

    WEIGHTS = 0
    ENVIRONMENT = 1
    ACTION = 2
    STRATEGY = 3
    EVALUATION = 4


@lru_cache(maxsize=256)
def key(seed: int, stream: Stream) -> NDArray[np.uint64]:
    """The Philox key of a stream of a job: [2], from ``SeedSequence(seed, spawn_key=(stream,))``.

    Raises:
        ValueError: if the seed is negative.
    """
    if seed < 0:
        raise ValueError(f"seed must be >= 0, got {seed}")
    sequence = np.random.SeedSequence(seed, spawn_key=(int(stream),))
    words = sequence.generate_state(2, np.uint64).astype(np.uint64)
    words.flags.writeable = False
    return words


def generator(seed: int, stream: Stream, trial: int, episode: int = 0) -> np.random.Generator:
    """The stream of random numbers of one episode of one trial.

    Philox4x64-10 (Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3") with

        key = SeedSequence(seed, spawn_key=(stream,)),   counter = (block, 0, episode, trial).

    A counter-based generator has no state to carry: the numbers of any episode of any trial are
    directly accessible. So a trial does not depend on other trials, on the length of their
    episodes, or on numbers drawn for another purpose, and a resumed run needs no generator states.
    An episode has 2^64 blocks of four numbers before it would overflow into the next counter word.

    Args:
        seed: seed of the job, >= 0.
        stream: the purpose.
        trial: index of the trial, counted over all trials of the seed (``first_trial`` included).
        episode: index of the episode within the trial, from 0.

    Raises:
        ValueError: if ``seed``, ``trial`` or ``episode`` is negative.

    Example:
        >>> a = generator(3, Stream.ACTION, trial=7, episode=2).random(2)
        >>> b = generator(3, Stream.ACTION, trial=7, episode=2).random(2)
        >>> bool((a == b).all())
        True
    """
    if trial < 0 or episode < 0:
        raise ValueError(f"trial and episode must be >= 0, got {trial} and {episode}")
    counter = np.array([0, 0, episode, trial], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key(seed, stream), counter=counter))
