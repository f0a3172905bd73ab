"""The random numbers of an environment: one stream per episode, whatever its code draws from."""

from __future__ import annotations

import copy
from contextlib import suppress
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import seeding

from trl_explore.numerics.streams import Stream, key

GYMNASIUM = seeding.np_random


class Source:
    """The random numbers of one environment, a function of (seed, stream, trial, episode).

    Environments draw random numbers in three ways, all of them supported:

    * from ``np_random``, as gymnasium's own environments do. It is ``generator(seed, stream, trial,
      episode)``, the stream that a kernel uses too.
    * from spaces: ``self.observation_space.sample()``. They use the same generator.
    * from a generator of their own, which ``reset(seed=...)`` seeds. The seed is a number of 31
      bits from the same key, at the counter (0, 1, episode, trial), which ``np_random`` never
      reaches.

    gymnasium has one function that makes generators, ``seeding.np_random``. While an environment is
    reset, that function returns the generator of this object, whatever the seed.

    Args:
        env: the environment, with its wrappers.

    Example:
        >>> import gymnasium as gym
        >>> source = Source(gym.make("CartPole-v1"))
        >>> first, _ = source.reset(0, Stream.ENVIRONMENT, trial=3, episode=8)
        >>> again, _ = source.reset(0, Stream.ENVIRONMENT, trial=3, episode=8)
        >>> bool((first == again).all())
        True
    """

    def __init__(self, env: gym.Env) -> None:
        self.env = env
        self.generator = np.random.Generator(np.random.Philox(0))
        self._bits = self.generator.bit_generator
        self._state: Any = self._bits.state
        self._seed = 0
        self._own_spaces()

    def reset(self, seed: int, stream: Stream, trial: int, episode: int) -> Any:
        """What ``env.reset(seed=...)`` returns at the start of an episode."""
        words, self._state["state"]["key"] = self._state["state"]["counter"], key(seed, stream)
        words[:] = 0, 1, episode, trial
        self._bits.state = self._state
        self._seed = int(self._bits.random_raw()) >> 33
        words[1] = 0
        self._bits.state = self._state
        with suppress(AttributeError):  # an environment whose np_random is read-only
            self.env.unwrapped.np_random = self.generator
        seeding.np_random = self._give
        try:
            return self.env.reset(seed=self._seed)
        finally:
            seeding.np_random = GYMNASIUM

    def _give(self, seed: int | None = None) -> tuple[np.random.Generator, int]:
        return self.generator, self._seed

    def _own_spaces(self) -> None:
        """Let the spaces draw from the generator; those of the class are copied first."""
        env: Any = self.env.unwrapped
        seeding.np_random = self._give
        try:
            for name in ("observation_space", "action_space"):
                if name not in vars(env) and isinstance(getattr(env, name, None), gym.Space):
                    with suppress(AttributeError):  # a property without a setter
                        setattr(env, name, copy.deepcopy(getattr(env, name)))
                space = getattr(env, name, None)
                if isinstance(space, gym.Space):
                    space.seed(0)
        finally:
            seeding.np_random = GYMNASIUM
