"""FrozenLake, on any map, slippery or not; the observation is the one-hot state."""

from __future__ import annotations

import numpy as np
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv

from trl_explore.kernels.base import Kernel, kernel_function, register_kernel
from trl_explore.kernels.philox import random


@kernel_function
def _draw(cumulated, rng):
    """The first index whose cumulated probability exceeds a random number; 0 if none does."""
    u = random(rng)
    for i in range(len(cumulated)):
        if cumulated[i] > u:
            return i
    return 0


@kernel_function
def reset(parameters, state, rng):
    """A tile marked S."""
    state[0] = _draw(parameters[0], rng)


@kernel_function
def step(parameters, state, action, rng):
    """One of the outcomes of (state, action), by its probability."""
    _, cumulated, successor, reward, terminal = parameters
    tile = int(state[0])
    i = _draw(cumulated[tile, action], rng)
    state[0] = successor[tile, action, i]
    return reward[tile, action, i], terminal[tile, action, i]


@kernel_function
def observe(parameters, state, observation):
    """One-hot."""
    observation[:] = 0
    observation[int(state[0])] = 1


@register_kernel(FrozenLakeEnv)
def frozen_lake(env: FrozenLakeEnv) -> Kernel:
    """The kernel of a FrozenLake environment, from its table of transitions."""
    n_states, n_actions = len(env.P), len(env.P[0])
    outcomes = max(len(env.P[s][a]) for s in range(n_states) for a in range(n_actions))
    shape = (n_states, n_actions, outcomes)
    cumulated = np.zeros(shape)
    successor = np.zeros(shape, dtype=np.int64)
    reward = np.zeros(shape)
    terminal = np.zeros(shape, dtype=np.bool_)
    for s in range(n_states):
        for a in range(n_actions):
            rows = env.P[s][a]
            cumulated[s, a] = np.pad(np.cumsum([row[0] for row in rows]), (0, outcomes - len(rows)))
            for i, (_, after, r, end) in enumerate(rows):
                successor[s, a, i], reward[s, a, i], terminal[s, a, i] = after, r, end
    parameters = (np.cumsum(env.initial_state_distrib), cumulated, successor, reward, terminal)
    return Kernel(
        reset, step, observe, parameters, state_size=1, n_features=n_states, n_actions=n_actions
    )
