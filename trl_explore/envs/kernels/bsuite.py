"""DeepSea and Catch, two tasks of bsuite (Osband et al. 2020)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box, Discrete
from numpy.typing import NDArray

from trl_explore.checks import check_flag, check_integer
from trl_explore.envs.kernels.kernel import Kernel, register_kernel
from trl_explore.numerics.compiled.cache import kernel_function
from trl_explore.numerics.compiled.philox import random


class ExplorationTask(gym.Env[Any, Any]):
    """An environment with ``_begin``, which sets the first state, and ``_observation``."""

    _begin: Callable[[], None]
    _observation: Callable[[], Any]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        super().reset(seed=seed)
        self._begin()
        return self._observation(), {}


MOVE_COST = 0.01
"""The cost of going right in every row of an episode."""


class DeepSea(ExplorationTask):
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

    def _begin(self) -> None:
        self.row = self.column = 0

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
        return self._observation(), reward, self.row == self.size, False, {}

    def _observation(self) -> int:
        """The cell, numbered row by row; after the last row, one of the last row."""
        return min(self.row, self.size - 1) * self.size + self.column

    def _normal(self) -> float:
        radius = math.sqrt(-2.0 * math.log(1.0 - self.np_random.random()))
        return radius * math.cos(2.0 * math.pi * self.np_random.random())


@kernel_function
def sea_reset(parameters, state, rng):
    """The top left corner: row 0, column 0."""
    state[0], state[1] = 0, 0


@kernel_function
def sea_step(parameters, state, action, rng):
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
def sea_observe(parameters, state, observation):
    """The one-hot cell."""
    size = parameters[0]
    observation[:] = 0
    observation[min(int(state[0]), size - 1) * size + int(state[1])] = 1


@register_kernel(DeepSea)
def deep_sea(env: DeepSea) -> Kernel:
    """The kernel of a DeepSea environment."""
    parameters = (env.size, MOVE_COST / env.size, env.stochastic, env.right)
    n_cells = env.size * env.size
    return Kernel(
        sea_reset, sea_step, sea_observe, parameters, state_size=2, n_features=n_cells, n_actions=2
    )


class Catch(ExplorationTask):
    """A ball falls one row per step in a random column; a paddle moves left, not, or right.

    When the ball arrives at the last row, the episode ends with 1 if the paddle is there, else
    with −1. The paddle begins in the middle, so the best return is 1 if there are enough rows. The
    observation is the board [rows, columns], 1 for ball and paddle, else 0.

    Source: Osband et al. 2020, "Behaviour suite for reinforcement learning", and its program.

    Args:
        rows: from 2 to 50.
        columns: from 1 to 50.

    Raises:
        ValueError: if an argument is out of range.

    Example:
        >>> board, _ = Catch(rows=3, columns=3).reset(seed=0)
        >>> board.sum(axis=1).tolist()
        [1.0, 0.0, 1.0]
    """

    def __init__(self, rows: int = 10, columns: int = 5) -> None:
        self.rows = check_integer("rows", rows, 2, 50)
        self.columns = check_integer("columns", columns, 1, 50)
        self.observation_space = Box(0.0, 1.0, (self.rows, self.columns), np.float32)
        self.action_space = Discrete(3)
        self.row = self.column = self.paddle = 0

    def _begin(self) -> None:
        self.row, self.paddle = 0, self.columns // 2
        self.column = int(self.columns * self.np_random.random())

    def step(self, action: int) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Move the paddle, and let the ball fall by one row."""
        self.paddle = min(max(self.paddle + int(action) - 1, 0), self.columns - 1)
        self.row += 1
        terminated = self.row == self.rows - 1
        caught = 1.0 if self.paddle == self.column else -1.0
        return self._observation(), caught if terminated else 0.0, terminated, False, {}

    def _observation(self) -> NDArray[np.float32]:
        board = np.zeros((self.rows, self.columns), dtype=np.float32)
        board[self.row, self.column] = board[-1, self.paddle] = 1.0
        return board


@kernel_function
def catch_reset(parameters, state, rng):
    """Row and column of the ball, and the paddle's column."""
    _, columns = parameters
    state[0], state[1], state[2] = 0, int(columns * random(rng)), columns // 2


@kernel_function
def catch_step(parameters, state, action, rng):
    """Move the paddle, and let the ball fall by one row."""
    rows, columns = parameters
    state[2] = min(max(state[2] + action - 1, 0.0), columns - 1.0)
    state[0] += 1
    terminated = state[0] == rows - 1
    caught = 1.0 if state[2] == state[1] else -1.0
    return caught if terminated else 0.0, terminated


@kernel_function
def catch_observe(parameters, state, observation):
    """The board, row by row."""
    rows, columns = parameters
    observation[:] = 0
    observation[int(state[0]) * columns + int(state[1])] = 1
    observation[(rows - 1) * columns + int(state[2])] = 1


@register_kernel(Catch)
def catch(env: Catch) -> Kernel:
    """The kernel of a Catch environment."""
    n_cells = env.rows * env.columns
    parameters = (env.rows, env.columns)
    functions = catch_reset, catch_step, catch_observe
    return Kernel(*functions, parameters, state_size=3, n_features=n_cells, n_actions=3)
