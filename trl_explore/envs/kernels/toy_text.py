"""Environments with a table of transitions; the observation is the one-hot state.

gymnasium's toy_text environments have such a table: ``P[state][action]``, a list of outcomes
(probability, next state, reward, terminated), and the distribution of the initial state.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.envs.toy_text.cliffwalking import CliffWalkingEnv
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv
from gymnasium.envs.toy_text.taxi import TaxiEnv
from numpy.typing import NDArray

from trl_explore.envs.kernels.kernel import Function, Kernel, register_kernel
from trl_explore.numerics.compiled.cache import kernel_function
from trl_explore.numerics.compiled.philox import random

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
    return Kernel(
        reset,
        step,
        observe,
        parameters,
        state_size=1,
        n_features=n_states,
        n_actions=n_actions,
        mask=mask,
    )


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


@register_kernel(FrozenLakeEnv)
def frozen_lake(env: FrozenLakeEnv) -> Kernel:
    """The kernel of a FrozenLake environment, from its table of transitions."""
    return tabular(env.P, env.initial_state_distrib)


@register_kernel(CliffWalkingEnv)
def cliff_walking(env: CliffWalkingEnv) -> Kernel:
    """The kernel of a CliffWalking environment, from its table of transitions."""
    return tabular(env.P, env.initial_state_distrib)
