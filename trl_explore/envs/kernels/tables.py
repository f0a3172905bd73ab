"""Environments with a table of transitions: gymnasium's toy_text, RiverSwim and two rooms.

The table is ``P[state][action]``, a list of outcomes (probability, next state, reward, terminated),
with the distribution of the initial state. The observation is the one-hot state.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.toy_text.cliffwalking import CliffWalkingEnv
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv
from gymnasium.envs.toy_text.taxi import TaxiEnv
from gymnasium.envs.toy_text.utils import categorical_sample
from gymnasium.spaces import Discrete
from numpy.typing import NDArray

from trl_explore.checks import check_integer, check_number
from trl_explore.envs.kernels.kernel import Function, Kernel, register_kernel
from trl_explore.numerics.compiled.cache import kernel_function
from trl_explore.numerics.compiled.philox import random

UP, RIGHT, DOWN, LEFT = range(4)
MOVES = ((-1, 0), (0, 1), (1, 0), (0, -1))
"""The (rows, columns) that each action goes."""

Outcomes = Sequence[tuple[float, int, float, bool]]


@kernel_function
def draw(cumulated, rng):
    """The first index whose cumulative probability exceeds a random number; 0 if none does."""
    u = random(rng)
    for i in range(len(cumulated)):
        if cumulated[i] > u:
            return i
    return 0


@kernel_function
def reset(parameters, state, rng):
    """A state drawn from the initial distribution."""
    state[0] = draw(parameters[0], rng)


@kernel_function
def step(parameters, state, action, rng):
    """Draw one of the outcomes of (state, action)."""
    cumulated, successor, reward, terminal = parameters[1:5]
    s = int(state[0])
    i = draw(cumulated[s, action], rng)
    state[0] = successor[s, action, i]
    return reward[s, action, i], terminal[s, action, i]


@kernel_function
def observe(parameters, state, observation):
    """The one-hot state."""
    observation[:] = 0
    observation[int(state[0])] = 1


@kernel_function
def read_mask(parameters, state, mask):
    """The state's row in the table of masks."""
    mask[:] = parameters[5][int(state[0])]


def tabular(
    table: Mapping[int, Mapping[int, Outcomes]],
    initial: NDArray[np.float64],
    masks: NDArray[np.bool_] | None = None,
) -> Kernel:
    """The kernel of a table of transitions.

    Args:
        table: state -> action -> outcomes (probability, next state, reward, terminated).
        initial: probabilities of the initial state [n_states].
        masks: [n_states, n_actions], False where an action is not allowed; None: no masks.
    """
    n_states, n_actions = len(table), len(table[0])
    outcomes = max(len(table[s][a]) for s in range(n_states) for a in range(n_actions))
    shape = (n_states, n_actions, outcomes)
    cumulated, reward = np.zeros(shape), np.zeros(shape)
    successor = np.zeros(shape, dtype=np.int64)
    terminal = np.zeros(shape, dtype=np.bool_)
    for s in range(n_states):
        for a in range(n_actions):
            rows = table[s][a]
            # Summed as in gymnasium. Unused places stay 0 and are never drawn.
            cumulated[s, a, : len(rows)] = np.cumsum([row[0] for row in rows])
            for i, (_, after, r, end) in enumerate(rows):
                successor[s, a, i], reward[s, a, i], terminal[s, a, i] = after, r, end
    parameters: tuple[Any, ...] = (np.cumsum(initial), cumulated, successor, reward, terminal)
    mask: Function | None = None
    if masks is not None:
        parameters, mask = (*parameters, masks), read_mask
    sizes = {"state_size": 1, "n_features": n_states, "n_actions": n_actions}
    return Kernel(reset, step, observe, parameters, **sizes, mask=mask)


@register_kernel(TaxiEnv)
def taxi(env: TaxiEnv) -> Kernel:
    """The kernel of a Taxi environment, from its tables of transitions and masks.

    Raises:
        LookupError: if the passenger is fickle: drawing the new destination needs ``integers``.
    """
    if env.fickle_passenger:
        raise LookupError("the kernel of Taxi does not support fickle_passenger=True")
    masks = np.array([env.action_mask(state) for state in range(len(env.P))], dtype=np.bool_)
    return tabular(env.P, env.initial_state_distrib, masks)


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


@register_kernel(FrozenLakeEnv)
@register_kernel(CliffWalkingEnv)
@register_kernel(RiverSwim)
@register_kernel(TwoRooms)
def from_table(env: Any) -> Kernel:
    """The kernel of an environment with a table of transitions and no masks."""
    return tabular(env.P, env.initial_state_distrib)
