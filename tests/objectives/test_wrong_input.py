"""What the loss refuses, in one line."""

from __future__ import annotations

import math

import pytest
import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.modules import NormalParamExtractor, ProbabilisticActor, TanhNormal

from tests.objectives.episodes import (
    torch_actor,
)
from tests.objectives.frames import (
    categorical,
    frames,
    network,
    plain_loss,
)
from trl_explore.objectives import ReinforceLoss
from trl_explore.objectives.baselines import LinearValue
from trl_explore.objectives.corrections import PerStep
from trl_explore.policies.actor import SoftmaxActor


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"gamma": 1.01}, r"gamma.*\[0, 1\].*1.01"),
        ({"gamma": -0.1}, r"gamma.*\[0, 1\].*-0.1"),
        ({"gamma": math.nan}, r"gamma.*\[0, 1\].*nan"),
        ({"weight": 0.0}, "weight.*> 0.*0.0"),
        ({"weight": -1.0}, "weight.*> 0.*-1.0"),
        ({"baseline": math.inf}, "baseline.*finite.*inf"),
        ({"trials": 0}, "trials.*>= 1.*0"),
        ({"reduction": "median"}, "reduction.*sum, mean, none.*'median'"),
    ],
)
def test_arguments_out_of_range(arguments, message):
    with pytest.raises(ValueError, match=message):
        ReinforceLoss(torch_actor(), **arguments)


def wrong(**entries):
    data = frames(3, 5)
    for name, value in entries.items():
        data[tuple(name.split("__"))] = value
    return data


@pytest.mark.parametrize(
    ("options", "data", "message"),
    [
        ({}, wrong(next__reward=torch.ones(3, 5, 2)), r"'reward' is \[3, 5, 2\].*\[3, 5\]"),
        ({}, wrong(next__done=torch.ones(3, 5, 2)), r"'done' is \[3, 5, 2\].*\[3, 5\]"),
        ({}, wrong(trial=torch.zeros(3, 5)), "'trial' must hold integers, got torch.float32"),
        ({}, wrong(trial=torch.zeros(3, 5, 4).long()), r"'trial' is \[3, 5, 4\]"),
        ({}, wrong(action=torch.zeros(3, 5, 4).long()), r"actions are \[15, 4\].*\[15\]"),
        ({"trials": 2}, wrong(), "trials is 2, but the data have 3 rows"),
        ({"baseline": LinearValue()}, wrong(), r"bind\(env\)"),
        ({"correction": PerStep()}, wrong(), "'action_log_prob'; the data have"),
        ({"correction": PerStep()}, wrong(action_log_prob=torch.zeros(3, 5, 2)), None),
    ],
)
def test_what_does_not_fit(options, data, message):
    for actor in (categorical(network()), SoftmaxActor(network())):
        if message is None:  # one log-probability for each part of a joint action
            plain_loss(actor, **options)(data)
            continue
        with pytest.raises((ValueError, KeyError, RuntimeError), match=message) as error:
            plain_loss(actor, **options)(data)
        assert "\n" not in str(error.value)


def test_masks_that_do_not_fit():
    actor, data = SoftmaxActor(network()), frames(3, 5)
    data["action_mask"] = torch.ones(3, 5, 2, dtype=torch.bool)
    with pytest.raises(ValueError, match=r"mask is \[15, 2\], but the logits are \[15, 3\]"):
        plain_loss(actor)(data)
    data["action_mask"] = torch.zeros(3, 5, 3, dtype=torch.bool)
    with pytest.raises(ValueError, match="no action of finite logit"):
        plain_loss(actor)(data)


def test_parts_of_another_kind():
    module = network()
    with pytest.raises(ValueError, match=r"ProbabilisticActor, got TensorDictModule"):
        ReinforceLoss(module)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match=r"correction must be .*PerStep\(\), got 'per_step'"):
        ReinforceLoss(categorical(module), correction="per_step")  # pyright: ignore
    net = nn.Sequential(nn.Linear(4, 4), NormalParamExtractor())
    squashed = ProbabilisticActor(
        TensorDictModule(net, ["observation"], ["loc", "scale"]),
        in_keys=["loc", "scale"], distribution_class=TanhNormal,
    )  # fmt: skip
    data = frames(6)
    data["action"] = torch.rand(6, 2) - 0.5
    assert plain_loss(squashed)(data)["loss_actor"].isfinite()
    with pytest.raises(ValueError, match="entropy_coeff must be 0: TanhNormal"):
        plain_loss(squashed, entropy_coeff=0.1)(data)
