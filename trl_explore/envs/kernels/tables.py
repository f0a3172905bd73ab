"""Small Markov decision processes given by a table of transitions: RiverSwim and two rooms."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.toy_text.utils import categorical_sample
from gymnasium.spaces import Discrete

from trl_explore.checks import check_integer, check_number
from trl_explore.envs.kernels.kernel import Kernel, register_kernel
from trl_explore.envs.kernels.toy_text import Outcomes, tabular

UP, RIGHT, DOWN, LEFT = range(4)
MOVES = ((-1, 0), (0, 1), (1, 0), (0, -1))
"""The (rows, columns) that each action goes."""


class TableEnv(gym.Env[Any, Any]):
    """A Markov decision process with the transitions P[state][action], as gymnasium's toy_text.

    Attributes:
        P: state -> action -> outcomes (probability, next state, reward, terminated).
        initial_state_distrib: probabilities of the first state [n_states]; it is always ``start``.
        shape: the rows and columns in which the states lie, row by row.

    Args:
        table: P.
        start: the state in which every episode begins.
        shape: rows and columns.
    """

    def __init__(
        self, table: Mapping[int, Mapping[int, Outcomes]], start: int, shape: tuple[int, int]
    ) -> None:
        self.P, self.shape, self.s = table, shape, start
        self.initial_state_distrib = np.eye(len(table))[start]
        self.observation_space = Discrete(len(table))
        self.action_space = Discrete(len(table[start]))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[int, dict[str, Any]]:
        """Begin in the start state."""
        super().reset(seed=seed)
        self.s = int(categorical_sample(self.initial_state_distrib, self.np_random))
        return self.s, {}

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        """Draw one of the outcomes of the state and the action."""
        outcomes = self.P[self.s][action]
        chosen: Any = categorical_sample([outcome[0] for outcome in outcomes], self.np_random)
        _, self.s, reward, terminated = outcomes[chosen]
        return self.s, reward, terminated, False, {}


class RiverSwim(TableEnv):
    """A chain of states with a current to the left; upstream is much, downstream a little.

    Action 0 swims left, which always succeeds and is worth 0.005 in the first state. Action 1 swims
    right and is worth 1 in the last state. It moves right with probability 0.35 and left with 0.05;
    in the first state right with 0.6, in the last left with 0.4; otherwise the swimmer stays.

    The chain of Strehl & Littman 2008, "An analysis of model-based interval estimation", with the
    numbers of Osband, Russo & Van Roy 2013, "(More) efficient reinforcement learning via posterior
    sampling", with 6 states and 20 steps.

    Args:
        size: the number of states, from 3 to 1000.

    Raises:
        ValueError: if the size is out of range.

    Example:
        >>> RiverSwim().P[0][1]
        [(0.4, 0, 0.0, False), (0.6, 1, 0.0, False)]
    """

    def __init__(self, size: int = 6) -> None:
        last = check_integer("size", size, 3, 1000) - 1
        inner = {
            s: {
                0: [(1.0, s - 1, 0.0, False)],
                1: [(0.05, s - 1, 0.0, False), (0.6, s, 0.0, False), (0.35, s + 1, 0.0, False)],
            }
            for s in range(1, last)
        }
        table = {
            0: {
                0: [(1.0, 0, 0.005, False)],
                1: [(0.4, 0, 0.0, False), (0.6, 1, 0.0, False)],
            },
            **inner,
            last: {
                0: [(1.0, last - 1, 0.0, False)],
                1: [(0.4, last - 1, 1.0, False), (0.6, last, 1.0, False)],
            },
        }
        super().__init__(table, start=0, shape=(1, size))


class TwoRooms(TableEnv):
    """Two square rooms side by side; one door joins them, and the goal is the far corner.

    The actions go up, right, down and left; into a wall they go nowhere. The start is the top left
    corner of the left room, the goal the bottom right corner of the right room. The goal is worth 1
    and ends the episode; nothing else is worth anything. The shortest way has 3 · size − 1 steps.
    It is the half of the four rooms of Sutton, Precup & Singh 1999, "Between MDPs and semi-MDPs".

    Args:
        size: the side of a room, from 2 to 50; the door is in the middle of the wall.
        slip: the probability, from 0 to 1, that a step goes in one of the other three directions.

    Raises:
        ValueError: if an argument is out of range.

    Example:
        >>> TwoRooms(size=3).drawn()
        ['S..#...', '.......', '...#..G']
    """

    def __init__(self, size: int = 5, slip: float = 0.0) -> None:
        size, slip = check_integer("size", size, 2, 50), check_number("slip", slip, 0, 1)
        rows, columns = size, 2 * size + 1
        self.walls = np.zeros((rows, columns), dtype=np.bool_)
        self.walls[:, size] = True
        self.walls[size // 2, size] = False
        self.goal = rows * columns - 1
        table = {s: {a: self._outcomes(s, a, slip) for a in range(4)} for s in range(self.goal + 1)}
        super().__init__(table, start=0, shape=(rows, columns))

    def _outcomes(
        self, state: int, action: int, slip: float
    ) -> list[tuple[float, int, float, bool]]:
        others = [a for a in range(4) if a != action]
        chances = [(1.0 - slip, action), *((slip / 3, a) for a in others)]
        found = [(chance, self._next(state, a)) for chance, a in chances if chance > 0]
        return [(chance, s, float(s == self.goal), s == self.goal) for chance, s in found]

    def _next(self, state: int, action: int) -> int:
        rows, columns = self.walls.shape
        row, column = state // columns + MOVES[action][0], state % columns + MOVES[action][1]
        free = 0 <= row < rows and 0 <= column < columns and not self.walls[row, column]
        return row * columns + column if free else state

    def drawn(self) -> list[str]:
        """The map, one text per row: S start, G goal, # wall."""
        cells = np.where(self.walls, "#", ".")
        cells.flat[0], cells.flat[self.goal] = "S", "G"
        return ["".join(row) for row in cells]


@register_kernel(RiverSwim)
@register_kernel(TwoRooms)
def from_table(env: TableEnv) -> Kernel:
    """The kernel of an environment with a table of transitions."""
    return tabular(env.P, env.initial_state_distrib)
