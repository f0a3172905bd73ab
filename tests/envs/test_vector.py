"""The lanes: only unfinished ones are stepped, and each returns what is its own."""

from __future__ import annotations

from collections.abc import Iterator

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces

from trl_explore.envs import LaneVectorEnv, lane_env, make_env


class Counting(gym.Env):
    """Counts its own steps; the next number of ``lengths`` is the length of its episode."""

    observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float32)
    action_space = spaces.Discrete(2)
    lengths: Iterator[int] = iter(())

    def __init__(self) -> None:
        self.length = next(Counting.lengths, 1)
        self.steps = self.resets = 0
        self.ended = True

    def reset(self, *, seed=None, options=None):
        self.resets, self.ended, self.age = self.resets + 1, False, 0
        return np.array([self.resets, 0], np.float32), {}

    def step(self, action):
        assert not self.ended, "a finished environment was stepped"
        self.steps += 1
        self.age += 1
        self.ended = self.age == self.length
        return np.array([self.resets, self.age], np.float32), 1.0, self.ended, False, {}


@pytest.fixture
def counting():
    """Lane k ends after k + 1 steps; the second copy is only asked whether there are masks."""
    gym.register("Counting-v0", Counting, max_episode_steps=9)
    Counting.lengths = iter((1, 9, 2, 3))
    yield "Counting-v0"
    gym.registry.pop("Counting-v0")


def test_only_unfinished_lanes_are_stepped(counting):
    lanes = LaneVectorEnv(counting, 3)
    lanes.reset()
    seen = [lanes.step(np.zeros(3, np.int64)) for _ in range(4)]
    assert [env.unwrapped.steps for env in lanes.envs] == [1, 2, 3]
    observations, rewards, terminated, _, _ = map(np.stack, zip(*seen, strict=True))
    # A finished lane keeps its last observation and gets no reward.
    assert observations[..., 1].tolist() == [[1, 1, 1], [1, 2, 2], [1, 2, 3], [1, 2, 3]]
    assert rewards.tolist() == [[1, 1, 1], [0, 1, 1], [0, 0, 1], [0, 0, 0]]
    assert terminated.tolist() == [
        [True, False, False],
        [True, True, False],
        [True, True, True],
        [True, True, True],
    ]
    assert not lanes.running.any()


def test_what_it_returns_is_not_overwritten_later(counting):
    lanes = LaneVectorEnv(counting, 3)
    first, _ = lanes.reset()
    second = lanes.step(np.zeros(3, np.int64))
    lanes.step(np.zeros(3, np.int64))
    assert first[:, 1].tolist() == [0, 0, 0]
    assert second[0][:, 1].tolist() == [1, 1, 1]
    assert second[2].tolist() == [True, False, False]


def test_a_partial_reset_leaves_the_other_lanes_alone(counting):
    lanes = LaneVectorEnv(counting, 3)
    lanes.reset()
    for _ in range(2):
        lanes.step(np.zeros(3, np.int64))
    observation, _ = lanes.reset(options={"reset_mask": np.array([True, False, False])})
    assert observation.tolist() == [[2, 0], [1, 2], [1, 2]]
    assert [env.unwrapped.resets for env in lanes.envs] == [2, 1, 1]
    assert lanes.running.tolist() == [True, False, True]
    _, rewards, terminated, _, _ = lanes.step(np.zeros(3, np.int64))
    assert rewards.tolist() == [1, 0, 1]
    assert terminated.tolist() == [True, True, True]


def test_a_seed_at_reset_is_the_seed_of_the_job():
    lanes, other = LaneVectorEnv("CartPole-v1", 2, seed=0), LaneVectorEnv("CartPole-v1", 2, seed=9)
    lanes.reset()
    np.testing.assert_array_equal(lanes.reset(seed=9)[0], other.reset()[0])
    np.testing.assert_array_equal(lanes.reset()[0], other.reset()[0])
    env = make_env(trials=2, seed=0)
    env.set_seed(9)
    assert lane_env(env).seed == 9


def test_an_action_that_is_not_finite_is_refused():
    lanes = LaneVectorEnv("Pendulum-v1", 2)
    lanes.reset()
    with pytest.raises(ValueError, match=r"'Pendulum-v1'.*action \[nan\].*episode 0.*trial 1"):
        lanes.step(np.array([[0.0], [np.nan]], np.float32))
