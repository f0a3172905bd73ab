"""What is said about an environment before it is trained on, and which transforms are supported."""

from __future__ import annotations

import random
from functools import partial
from itertools import count

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from tensordict.nn import TensorDictSequential
from torchrl import envs

from trl_explore.collectors import (
    FusedCollector,
    NotCompilableError,
    SteppingCollector,
    TorchRLCollector,
)
from trl_explore.envs import LaneVectorEnv, lane_env, make_env
from trl_explore.envs.checking import check_transforms, remarks
from trl_explore.policies import LinearPolicy, TabularPolicy
from trl_explore.strategies import Softmax

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


@pytest.mark.parametrize(
    ("wrapper", "keeps"),
    [
        (gym.wrappers.NormalizeObservation, True),
        (gym.wrappers.TimeAwareObservation, False),
        (partial(gym.wrappers.FrameStackObservation, stack_size=2), False),
    ],
)
def test_state_that_outlives_an_episode(wrapper, keeps):
    """A resumed job would lose it, so it is refused."""
    env = make_env("CartPole-v1", 2, 20, wrappers=[wrapper])
    lines = remarks(lane_env(env))
    assert any("keeps state from one episode to the next" in line for line in lines) == keeps
    collector = SteppingCollector(env, TensorDictSequential(LinearPolicy(env), Softmax()))
    collector.load_state_dict(collector.state_dict())  # nothing has been played
    collector.collect()
    if keeps:
        with pytest.raises(ValueError, match=r"keeps state .*; restart=true starts over$"):
            collector.load_state_dict(collector.state_dict())
    else:
        collector.load_state_dict(collector.state_dict())


def test_converted_spaces_are_said():
    assert remarks(LaneVectorEnv("Blackjack-v1", 1, 9)) == [
        "observations: Tuple(Discrete(32), Discrete(11), Discrete(2)) as 45 numbers"
    ]


def test_combined_actions_are_said(said):
    (line,) = said(action_space=spaces.MultiDiscrete([2, 3]))
    assert line == "actions: MultiDiscrete([2 3]) as its 6 combinations"


OBSERVATION = {"in_keys": ["observation"]}
SUPPORTED = {
    "CatFrames": partial(envs.CatFrames, 3, dim=-1, **OBSERVATION),
    "ObservationNorm": partial(envs.ObservationNorm, loc=1.0, scale=[1.0, 2, 3, 4], **OBSERVATION),
    "RewardScaling": partial(envs.RewardScaling, loc=0.0, scale=0.1),
    "RewardClipping": partial(envs.RewardClipping, -0.5, 0.5),
    "SignTransform": partial(envs.SignTransform, in_keys=["reward"]),
    "DoubleToFloat": envs.DoubleToFloat,
    "TimeMaxPool": partial(envs.TimeMaxPool, T=2, **OBSERVATION),
}
REFUSED = {
    "VecNormV2": (partial(envs.VecNormV2, **OBSERVATION), "mixes trials"),
    "ObservationNorm": (partial(envs.ObservationNorm, **OBSERVATION), "fails: .*Loc/Scale"),
    "FrameSkipTransform": (partial(envs.FrameSkipTransform, 2), "steps .* more than once"),
    "RandomTruncationTransform": (
        partial(envs.RandomTruncationTransform, 1, 5),
        "changes truncated|random",
    ),
    "UnsqueezeTransform": (partial(envs.UnsqueezeTransform, dim=-1, **OBSERVATION), "vectors"),
    "StepCounter": (partial(envs.StepCounter, 5), "env.max_steps"),
}


@pytest.mark.parametrize("name", SUPPORTED)
def test_supported(name):
    check_transforms(lambda: [SUPPORTED[name]()])


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name):
    build, reason = REFUSED[name]
    with pytest.raises(ValueError, match=f"{name}.*({reason})") as raised:
        check_transforms(lambda: [envs.DoubleToFloat(), build()])
    assert "\n" not in str(raised.value)


class Resets(envs.Transform):
    """Adds the number of resets, of all trials, to the observation."""

    count = 0

    def _reset(self, tensordict, tensordict_reset):
        self.count += 1
        return self._call(tensordict_reset)

    def _call(self, next_tensordict):
        return next_tensordict.set("observation", next_tensordict["observation"] + self.count)


def test_state_that_mixes_trials_from_their_second_episode_on_is_found():
    """No episode of Pendulum ends by itself while it is probed."""
    with pytest.raises(ValueError, match="Resets mixes trials"):
        check_transforms(lambda: [Resets()], partial(make_env, "Pendulum-v1"))


def test_what_is_no_transform():
    with pytest.raises(ValueError, match=r"dict is not a torchrl\.envs"):
        check_transforms(lambda: [{}])  # pyright: ignore


@pytest.mark.parametrize("name", SUPPORTED)
def test_a_trial_is_the_same_in_every_company(name):
    """All that the collector returns, over several episodes."""
    data = {}
    for trials, first in ((3, 0), (1, 1)):
        env = make_env(trials=trials, first_trial=first, transforms=[SUPPORTED[name]()])
        policy = LinearPolicy(env, first_trial=first)
        collector = TorchRLCollector(env, TensorDictSequential(policy, Softmax()))
        data[trials] = [collector.collect().frames.clone() for _ in range(3)]
    for together, alone in zip(data[3], data[1], strict=True):
        rows = together[together["trial"] == 1]
        for key, value in alone.items(True, True):
            if key != "trial":
                assert torch.equal(rows[key], value), key


def test_the_frames_of_a_stack_are_those_of_the_trial():
    env = make_env(trials=2, transforms=[SUPPORTED["CatFrames"]()])
    collector = TorchRLCollector(env, TensorDictSequential(LinearPolicy(env), Softmax()))
    for _ in range(2):
        frames = collector.collect().frames
        for trial in range(2):
            stack = frames[frames["trial"] == trial]["observation"].unflatten(-1, (3, 4))
            assert torch.equal(stack[1:, :2], stack[:-1, 1:])
            assert torch.equal(stack[0], stack[0, 2:].expand(3, 4))


def test_the_score_is_the_environments():
    """The learner sees the scaled reward."""
    env = make_env(trials=2, transforms=[SUPPORTED["RewardScaling"]()])
    rollout = TorchRLCollector(env, TensorDictSequential(LinearPolicy(env), Softmax())).collect()
    assert rollout.score.tolist() == rollout.length.tolist()
    assert rollout.frames["next", "reward"].unique().tolist() == pytest.approx([0.1])


def test_the_fused_collector_does_not_apply():
    env = make_env(trials=2, transforms=[SUPPORTED["RewardScaling"]()])
    with pytest.raises(NotCompilableError, match="RewardScaling"):
        FusedCollector(env, TensorDictSequential(LinearPolicy(env), Softmax()))


def test_a_transformed_state_is_not_one_hot():
    """A table has a row for each state, and a mean of states is none."""
    TabularPolicy(make_env("FrozenLake-v1"))
    with pytest.raises(ValueError, match="Discrete"):
        TabularPolicy(make_env("FrozenLake-v1", transforms=[SUPPORTED["TimeMaxPool"]()]))
