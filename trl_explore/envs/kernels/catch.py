"""Catch (bsuite): a paddle in the last row must be under a falling ball."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box, Discrete
from numpy.typing import NDArray

from trl_explore.checks import check_integer
from trl_explore.envs.kernels.kernel import Kernel, register_kernel
from trl_explore.numerics.compiled.cache import kernel_function
from trl_explore.numerics.compiled.philox import random


class Catch(gym.Env[Any, Any]):
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

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """The ball in a random column of the first row, the paddle in the middle."""
        super().reset(seed=seed)
        self.row, self.paddle = 0, self.columns // 2
        self.column = int(self.columns * self.np_random.random())
        return self._board(), {}

    def step(self, action: int) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Move the paddle, and let the ball fall by one row."""
        self.paddle = min(max(self.paddle + int(action) - 1, 0), self.columns - 1)
        self.row += 1
        terminated = self.row == self.rows - 1
        caught = 1.0 if self.paddle == self.column else -1.0
        return self._board(), caught if terminated else 0.0, terminated, False, {}

    def _board(self) -> NDArray[np.float32]:
        board = np.zeros((self.rows, self.columns), dtype=np.float32)
        board[self.row, self.column] = board[-1, self.paddle] = 1.0
        return board


@kernel_function
def reset(parameters, state, rng):
    """Row and column of the ball, and the paddle's column."""
    _, columns = parameters
    state[0], state[1], state[2] = 0, int(columns * random(rng)), columns // 2


@kernel_function
def step(parameters, state, action, rng):
    """Move the paddle, and let the ball fall by one row."""
    rows, columns = parameters
    state[2] = min(max(state[2] + action - 1, 0.0), columns - 1.0)
    state[0] += 1
    terminated = state[0] == rows - 1
    caught = 1.0 if state[2] == state[1] else -1.0
    return caught if terminated else 0.0, terminated


@kernel_function
def observe(parameters, state, observation):
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
    return Kernel(reset, step, observe, parameters, state_size=3, n_features=n_cells, n_actions=3)
