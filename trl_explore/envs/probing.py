"""What a user should know about an environment before it is trained on."""

from __future__ import annotations

import random
import sys
from typing import Any, cast

import numpy as np
from gymnasium.spaces import Box, Discrete, MultiBinary, MultiDiscrete

from trl_explore.envs.copies import Copies, EnvError, Signals
from trl_explore.envs.vector import LaneVectorEnv

STEPS = 100
"""The number of steps of an episode that is played twice."""


def remarks(lanes: LaneVectorEnv) -> list[str]:
    """What is to be said about an environment, a line each.

    Spaces that are converted are named. The first episode is played twice, in two copies that take
    turns: an environment that draws numbers from somewhere else than its seeded generators gives
    two different episodes. gymnasium's own environments are known not to.
    """
    env = lanes.envs[0]
    lines: list[str] = []
    flat = isinstance(env.observation_space, Box) and len(env.observation_space.shape) == 1
    if not flat and not isinstance(env.observation_space, Discrete):
        n_features = lanes.signals.observation.shape[1]
        lines.append(f"observations: {_shown(env.observation_space)} as {n_features} numbers")
    if isinstance(env.action_space, MultiDiscrete | MultiBinary):
        n_actions = cast(Discrete, lanes.single_action_space).n
        lines.append(f"actions: {_shown(env.action_space)} as its {n_actions} combinations")
    if not type(env.unwrapped).__module__.startswith("gymnasium.envs."):
        lines += _differences(lanes)
    return lines


def _differences(lanes: LaneVectorEnv) -> list[str]:
    """Why two plays of the first episode could differ; empty if they are equal."""
    n_features, n_actions = lanes.signals.observation.shape[1], lanes.signals.mask.shape[1]
    signals = Signals.of(2, n_features, n_actions)
    copies = Copies(lanes.id, lanes.make, signals)
    draws = np.random.default_rng(0)
    before = _global_states()
    place = ([lanes.first_trial] * 2, [0, 0], lanes.seed, lanes.stream)
    step, differs = 0, False
    try:
        copies.reset([0, 1], *place)
        while step < STEPS:
            differs = any((column[0] != column[1]).any() for column in signals.rows([0, 1]))
            if differs or signals.terminated[0] or signals.truncated[0]:
                break
            step += 1
            copies.step([0, 1], lanes.actions.read(np.repeat(_action(lanes, signals, draws), 2, 0)))
    except EnvError:
        return []  # training meets the same error, and reports it
    finally:
        copies.close()
    after = _global_states()
    drawn = [name for name, state in before.items() if state != after[name]]
    if drawn:
        return [
            f"environment {lanes.id!r} draws from the global generator of {' and '.join(drawn)}, "
            "which its trials share: results depend on the number of trials, and may differ "
            "between runs; draw from self.np_random"
        ]
    if differs:
        return [
            f"environment {lanes.id!r} is not reproducible: its first episode, played twice from "
            f"one seed, differs at step {step}; draw from self.np_random, or from a generator that "
            "reset(seed=...) seeds"
        ]
    return []


def _action(lanes: LaneVectorEnv, signals: Signals, draws: np.random.Generator) -> Any:
    """A random action [1] or [1, n_dims] that the mask allows."""
    space = lanes.single_action_space
    if isinstance(space, Discrete):
        n = int(space.n)
        allowed = np.flatnonzero(signals.mask[0]) if lanes.has_masks else np.arange(n)
        return draws.choice(allowed if len(allowed) else n, 1)
    return draws.uniform(-1, 1, (1, *(space.shape or ()))).astype(np.float32)


def _global_states() -> dict[str, Any]:
    """The states of the generators that belong to no environment."""
    legacy = cast(tuple[Any, ...], np.random.get_state())  # noqa: NPY002
    states = {"random": random.getstate(), "numpy.random": (legacy[1].tobytes(), *legacy[2:])}
    if "torch" in sys.modules:
        states["torch"] = sys.modules["torch"].get_rng_state().numpy().tobytes()
    return states


def _shown(space: Any) -> str:
    text = " ".join(str(space).split())
    return text if len(text) <= 80 else f"{text[:77]}..."
