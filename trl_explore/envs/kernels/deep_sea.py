"""DeepSea (Osband et al. 2020): the reward is at the end of one path among 2^N."""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Discrete

from trl_explore.checks import check_flag, check_integer
from trl_explore.envs.kernels.kernel import Kernel, register_kernel
from trl_explore.numerics.compiled.cache import kernel_function
from trl_explore.numerics.compiled.philox import random

MOVE_COST = 0.01
"""The cost of going right in every row of an episode."""


class DeepSea(gym.Env[Any, Any]):
    """A diver sinks one row per step through a grid of N × N cells, from the top left corner.

    Each step goes right, at a cost of 0.01 / N, or left. Going right in the last column, which only
    N − 1 steps to the right reach, is worth 1. An episode has N steps. Uniformly random actions
    earn the reward in one of 2^N episodes, and the first N − 1 steps of the way to it only cost.

    The best return is 0.99. In the stochastic version, going right fails with probability 1 / N,
    and N(0, 1) is added to the reward in the first and last cell of the last row; always going
    right then returns (1 − 1/N)^(N−1) − 0.01 on average.

    Source: Osband et al. 2020, "Behaviour suite for reinforcement learning", appendix A.6, and its
    program. The normal numbers are made of uniform ones (Box & Muller 1958).

    Args:
        size: N, from 2 to 100.
        stochastic: whether it is the stochastic version.
        mapping_seed: which of the two actions goes right is drawn per cell with this seed. It does
            not depend on the trial or on the job's seed: all trials get the same grid. None: action
            1 goes right everywhere.

    Raises:
        ValueError: if an argument is out of range.

    Example:
        >>> env = DeepSea(size=4, mapping_seed=None)
        >>> _ = env.reset(seed=0)
        >>> round(sum(env.step(1)[1] for _ in range(4)), 9)
        0.99
    """

    def __init__(
        self, size: int = 10, stochastic: bool = False, mapping_seed: int | None = 0
    ) -> None:
        self.size = check_integer("size", size, 2, 100)
        self.stochastic = check_flag("stochastic", stochastic)
        self.shape = (self.size, self.size)
        self.right = np.ones(self.shape, dtype=np.int64)
        """The action that goes right in each cell [size, size]."""
        if mapping_seed is not None:
            draws = np.random.default_rng(check_integer("mapping_seed", mapping_seed, 0))
            self.right = draws.integers(2, size=self.shape)
        self.observation_space = Discrete(self.size * self.size)
        self.action_space = Discrete(2)
        self.row = self.column = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[int, dict[str, Any]]:
        """Begin in the top left corner."""
        super().reset(seed=seed)
        self.row = self.column = 0
        return self._cell(), {}

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        """Go right or left, and sink by one row."""
        last, reward = self.size - 1, 0.0
        goes_right = action == self.right[self.row, self.column]
        if goes_right:
            reward = (1.0 if self.column == last else 0.0) - MOVE_COST / self.size
        if self.stochastic and self.row == last and self.column in (0, last):
            reward += self._normal()
        if not goes_right:
            self.column = max(self.column - 1, 0)
        elif not self.stochastic or self.np_random.random() > 1 / self.size:
            self.column = min(self.column + 1, last)
        self.row += 1
        return self._cell(), reward, self.row == self.size, False, {}

    def _cell(self) -> int:
        """The cell, numbered row by row; after the last row, one of the last row."""
        return min(self.row, self.size - 1) * self.size + self.column

    def _normal(self) -> float:
        radius = math.sqrt(-2.0 * math.log(1.0 - self.np_random.random()))
        return radius * math.cos(2.0 * math.pi * self.np_random.random())


@kernel_function
def reset(parameters, state, rng):
    """The top left corner: row 0, column 0."""
    state[0], state[1] = 0, 0


@kernel_function
def step(parameters, state, action, rng):
    """Go right or left, and sink by one row."""
    size, cost, stochastic, right = parameters
    row, column = int(state[0]), int(state[1])
    last, reward = size - 1, 0.0
    goes_right = action == right[row, column]
    if goes_right:
        reward = (1.0 if column == last else 0.0) - cost
    if stochastic and row == last and (column == 0 or column == last):
        radius = math.sqrt(-2.0 * math.log(1.0 - random(rng)))
        reward += radius * math.cos(2.0 * math.pi * random(rng))
    if not goes_right:
        state[1] = max(column - 1, 0)
    elif not stochastic or random(rng) > 1 / size:
        state[1] = min(column + 1, last)
    state[0] = row + 1
    return reward, row + 1 == size


@kernel_function
def observe(parameters, state, observation):
    """The one-hot cell."""
    size = parameters[0]
    observation[:] = 0
    observation[min(int(state[0]), size - 1) * size + int(state[1])] = 1


@register_kernel(DeepSea)
def deep_sea(env: DeepSea) -> Kernel:
    """The kernel of a DeepSea environment."""
    parameters = (env.size, MOVE_COST / env.size, env.stochastic, env.right)
    n_cells = env.size * env.size
    return Kernel(reset, step, observe, parameters, state_size=2, n_features=n_cells, n_actions=2)
