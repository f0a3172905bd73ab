"""Transforms that are served, and those that are refused with the reason."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from tensordict.nn import TensorDictSequential
from torchrl import envs

from trl_explore.collectors import NotCompilableError, TorchRLCollector
from trl_explore.collectors.fused import FusedCollector
from trl_explore.envs import make_env
from trl_explore.envs.transforms import check_transforms
from trl_explore.policies import LinearPolicy, TabularPolicy
from trl_explore.strategies import Softmax

OBSERVATION = {"in_keys": ["observation"]}
SERVED = {
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


@pytest.mark.parametrize("name", SERVED)
def test_served(name):
    check_transforms(lambda: [SERVED[name]()])


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name):
    build, reason = REFUSED[name]
    with pytest.raises(ValueError, match=f"{name}.*({reason})") as raised:
        check_transforms(lambda: [envs.DoubleToFloat(), build()])
    assert "\n" not in str(raised.value)


def test_what_is_no_transform():
    with pytest.raises(ValueError, match=r"dict is not a torchrl\.envs"):
        check_transforms(lambda: [{}])  # pyright: ignore


@pytest.mark.parametrize("name", SERVED)
def test_a_trial_is_the_same_in_every_company(name):
    """All that the collector returns, over several episodes."""
    data = {}
    for trials, first in ((3, 0), (1, 1)):
        env = make_env(trials=trials, first_trial=first, transforms=[SERVED[name]()])
        policy = LinearPolicy(env, first_trial=first)
        collector = TorchRLCollector(env, TensorDictSequential(policy, Softmax()))
        data[trials] = [collector.collect().frames.clone() for _ in range(3)]
    for together, alone in zip(data[3], data[1], strict=True):
        rows = together[together["trial"] == 1]
        for key, value in alone.items(True, True):
            if key != "trial":
                assert torch.equal(rows[key], value), key


def test_the_frames_of_a_stack_are_those_of_the_trial():
    env = make_env(trials=2, transforms=[SERVED["CatFrames"]()])
    collector = TorchRLCollector(env, TensorDictSequential(LinearPolicy(env), Softmax()))
    for _ in range(2):
        frames = collector.collect().frames
        for trial in range(2):
            stack = frames[frames["trial"] == trial]["observation"].unflatten(-1, (3, 4))
            assert torch.equal(stack[1:, :2], stack[:-1, 1:])
            assert torch.equal(stack[0], stack[0, 2:].expand(3, 4))


def test_the_score_is_the_environments():
    """The learner sees the scaled reward."""
    env = make_env(trials=2, transforms=[SERVED["RewardScaling"]()])
    rollout = TorchRLCollector(env, TensorDictSequential(LinearPolicy(env), Softmax())).collect()
    assert rollout.score.tolist() == rollout.length.tolist()
    assert rollout.frames["next", "reward"].unique().tolist() == pytest.approx([0.1])


def test_the_fused_collector_does_not_apply():
    env = make_env(trials=2, transforms=[SERVED["RewardScaling"]()])
    with pytest.raises(NotCompilableError, match="RewardScaling"):
        FusedCollector(env, TensorDictSequential(LinearPolicy(env), Softmax()))


def test_a_transformed_state_is_not_one_hot():
    """A table has a row for each state, and a mean of states is none."""
    TabularPolicy(make_env("FrozenLake-v1"))
    with pytest.raises(ValueError, match="Discrete"):
        TabularPolicy(make_env("FrozenLake-v1", transforms=[SERVED["TimeMaxPool"]()]))
