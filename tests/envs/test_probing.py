"""What is said about an environment before it is trained on."""

from __future__ import annotations

import random
from itertools import count

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec

from trl_explore.envs import LaneVectorEnv
from trl_explore.envs.probing import remarks

COUNTER = count()


class Drawing(gym.Env):
    """Observes a random number."""

    observation_space: spaces.Space = spaces.Box(-np.inf, np.inf, (1,), np.float32)
    action_space: spaces.Space = spaces.Discrete(2)
    draw = staticmethod(lambda env: env.np_random.random())

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(1, np.float32), {}

    def step(self, action):
        return np.array([Drawing.draw(self)], np.float32), 0.0, False, False, {}


@pytest.fixture
def said(monkeypatch):
    """The remarks on the environment with some attributes."""
    spec = EnvSpec("Drawing-v0", Drawing, max_episode_steps=9)
    monkeypatch.setitem(gym.registry, "Drawing-v0", spec)

    def said(**attributes):
        for name, value in attributes.items():
            monkeypatch.setattr(Drawing, name, staticmethod(value) if callable(value) else value)
        return remarks(LaneVectorEnv("Drawing-v0", 2))

    return said


def test_nothing_is_said_about_what_is_seeded(said):
    assert said() == []
    assert remarks(LaneVectorEnv("Taxi-v4", 1)) == []


@pytest.mark.parametrize(
    ("draw", "name"),
    [
        (lambda env: random.random(), "random"),
        (lambda env: np.random.rand(), "numpy.random"),  # noqa: NPY002
        (lambda env: torch.rand(()).item(), "torch"),
    ],
)
def test_a_global_generator_is_named(said, draw, name):
    (line,) = said(draw=draw)
    assert line.startswith(f"environment 'Drawing-v0' draws from the global generator of {name},")


def test_any_other_source_is_found(said):
    (line,) = said(draw=lambda env: float(next(COUNTER)))
    assert "'Drawing-v0' is not reproducible" in line
    assert "differs at step 1" in line


def test_converted_spaces_are_said():
    assert remarks(LaneVectorEnv("Blackjack-v1", 1, 9)) == [
        "observations: Tuple(Discrete(32), Discrete(11), Discrete(2)) as 45 numbers"
    ]


def test_combined_actions_are_said(said):
    (line,) = said(action_space=spaces.MultiDiscrete([2, 3]))
    assert line == "actions: MultiDiscrete([2 3]) as its 6 combinations"
