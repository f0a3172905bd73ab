"""Vectors of observations: those of gymnasium."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec

from trl_explore.envs.flattening import Actions, flat_observations, writer
from trl_explore.envs.make import make_env
from trl_explore.envs.vector import LaneVectorEnv

SPACES: dict[str, spaces.Space[Any]] = {
    "vector": spaces.Box(-1, 1, (3,)),
    "image": spaces.Box(0, 255, (4, 4, 3), np.uint8),
    "scalar": spaces.Box(-1, 1, ()),
    "doubles": spaces.Box(-1, 1, (2,), np.float64),
    "discrete": spaces.Discrete(3),
    "shifted": spaces.Discrete(3, start=-1),
    "multi-discrete": spaces.MultiDiscrete([3, 2], start=[4, -1]),
    "matrix": spaces.MultiDiscrete([[3, 2], [2, 4]]),
    "multi-binary": spaces.MultiBinary((2, 2)),
    "tuple": spaces.Tuple((spaces.Discrete(3), spaces.Box(-1, 1, (2, 2)))),
    "dict": spaces.Dict(b=spaces.Discrete(3, start=5), a=spaces.Box(0, 9, (2,), np.int64)),
    "nested": spaces.Dict(
        x=spaces.Tuple((spaces.MultiBinary(2), spaces.Dict(y=spaces.Discrete(2)))),
        w=spaces.Box(-1, 1, ()),
    ),
}


@pytest.mark.parametrize("name", SPACES)
def test_the_vectors_are_gymnasiums(name):
    space = SPACES[name]
    space.seed(5)
    flat, write = flat_observations(space), writer(space)
    assert flat.dtype == np.float32
    row = np.full(flat.shape, np.nan, np.float32)
    for _ in range(20):
        sample = space.sample()
        write(sample, row)
        np.testing.assert_array_equal(row, spaces.flatten(space, sample).astype(np.float32))
        assert flat.contains(row)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("discrete", 3, "observation = 3, but its space has the integers 0 to 2"),
        ("discrete", 1.0, "observation = 1.0"),
        ("discrete", True, "observation = True"),
        ("discrete", "1", "observation = '1'"),
        ("shifted", 2, "the integers -1 to 1"),
        ("shifted", np.array([0]), "observation = array"),
        ("multi-discrete", np.array([7, 0]), r"observation = array\(\[7, 0\]\), but its space"),
        ("multi-discrete", np.array([4.0, 0.0]), "observation = array"),
        ("multi-binary", np.zeros(4), r"shape \(4,\), but its space has \(2, 2\)"),
        ("multi-binary", np.full((2, 2), 2), "but its space has 0 and 1"),
        ("tuple", [0, np.zeros((2, 2))], "of type list, not tuple"),
        ("tuple", (0,), r"parts \['0'\], but its space has \['0', '1'\]"),
        ("dict", {"a": np.zeros(2)}, r"parts \['a'\], but its space has \['a', 'b'\]"),
        ("dict", {"a": np.zeros(3), "b": 5}, r"observation\['a'\] of shape \(3,\)"),
        (
            "nested",
            {"x": (np.zeros(2), {"y": 2}), "w": np.zeros(())},
            r"observation\['x'\]\[1\]\['y'\] = 2",
        ),
    ],
)
def test_a_value_outside_of_its_space_is_refused(name, value, message):
    space = SPACES[name]
    row = np.zeros(flat_observations(space).shape, np.float32)
    with pytest.raises(ValueError, match=message):
        writer(space)(value, row)


def test_the_combinations_are_all_different():
    space = spaces.MultiDiscrete([[2, 3], [1, 2]], start=[[0, 4], [7, 1]])
    actions = Actions(space)
    found = actions.read(np.arange(12))
    assert actions.space == spaces.Discrete(12)
    assert len({action.tobytes() for action in found}) == 12
    assert all(space.contains(action) for action in found)


class Sampling(gym.Env):
    """Observes samples of a space."""

    action_space = spaces.Discrete(2)

    def __init__(self, name: str) -> None:
        self.observation_space = SPACES[name]

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.observation_space.sample(), {}

    def step(self, action):
        return self.observation_space.sample(), 1.0, False, False, {}


@pytest.mark.parametrize("name", SPACES)
def test_every_space_is_played(name, monkeypatch):
    monkeypatch.setitem(
        gym.registry, "Sampling-v0", EnvSpec("Sampling-v0", Sampling, max_episode_steps=4)
    )
    one, two = (
        make_env("Sampling-v0", trials=2, kwargs={"name": name}).rollout(
            4, lambda td: td.set("action", td["terminated"].long().squeeze(-1))
        )
        for _ in range(2)
    )
    assert one["observation"].shape == (2, 4, *(flat_observations(SPACES[name]).shape))
    assert (one["observation"] == two["observation"]).all()


class Acting(gym.Env):
    """Keeps the actions that it gets, and writes into arrays."""

    observation_space = spaces.Box(-np.inf, np.inf, (3,), np.float32)
    action_space: spaces.Space = spaces.Discrete(2)

    def __init__(self) -> None:
        self.seen: list = []

    def reset(self, *, seed=None, options=None):
        return np.zeros(3, np.float32), {}

    def step(self, action):
        self.seen.append(action)
        return np.zeros(3, np.float32), 1.0, False, False, {}


@pytest.mark.parametrize(
    ("space", "actions", "expected"),
    [
        (spaces.Discrete(2), [1, 0], [1, 0]),
        (spaces.Discrete(2, start=-1), [1, 0], [0, -1]),
        (spaces.MultiDiscrete([2, 3]), [5, 1], [[1, 2], [0, 1]]),
        (spaces.MultiBinary(2), [2, 3], [[1, 0], [1, 1]]),
        (spaces.Box(-1, 1, (2,), np.float64), [[0.5, -9], [1, 0]], [[0.5, -1], [1, 0]]),
        (spaces.Box(-1, 1, (1, 2)), [[0.5, -9], [1, 0]], [[[0.5, -1]], [[1, 0]]]),
        (spaces.Box(-1, 1, ()), [[0.5], [3]], [0.5, 1]),
    ],
)
def test_actions_are_of_the_space(space, actions, expected, monkeypatch):
    monkeypatch.setattr(Acting, "action_space", space)
    monkeypatch.setitem(gym.registry, "Act-v0", EnvSpec("Act-v0", Acting, max_episode_steps=5))
    lanes = LaneVectorEnv("Act-v0", 2)
    lanes.reset()
    lanes.step(np.array(actions))
    for env, action in zip(lanes.envs, expected, strict=True):
        (seen,) = env.unwrapped.seen  # pyright: ignore
        assert space.contains(seen)
        if isinstance(space, spaces.Discrete):
            assert type(seen) is int
            assert seen == action
        else:
            assert seen.flags.owndata
            assert seen.dtype == space.dtype
            assert seen.tolist() == action
