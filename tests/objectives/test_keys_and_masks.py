"""Targets and behaviours that read other entries, masks and heads."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torch.distributions import Categorical, Normal
from torchrl.data import MultiCategorical, MultiOneHot
from torchrl.modules import (
    MaskedCategorical,
    NormalParamExtractor,
    ProbabilisticActor,
    TanhNormal,
)

from tests.objectives.frames import (
    by_loop,
    categorical,
    expected,
    frames,
    network,
    plain_loss,
)
from trl_explore.objectives.corrections import Behaviour
from trl_explore.policies.actor import SoftmaxActor
from trl_explore.strategies import EpsilonSoftmax, Gaussian, Softmax


@pytest.mark.parametrize("logits_key", ["logits", "action_value", ("q", "values")])
@pytest.mark.parametrize("mask_key", [None, "action_mask", "legal"])
def test_the_gradient_of_a_behaviour_that_reads_other_entries(logits_key, mask_key):
    module = network(3, logits_key)
    options = {"logits_key": logits_key, "action_mask_key": mask_key or "action_mask"}
    strategy = EpsilonSoftmax(0.3, **options)
    data, logits = frames(6), module.module(frames(6)["observation"])
    if mask_key:
        mask = nn.functional.one_hot(data["action"], 3) + torch.tensor([1, 0, 0]) > 0
        data[mask_key] = mask.to(torch.uint8)
        logits = logits.masked_fill(~mask, -torch.inf)
    mu = strategy.probs(logits).gather(-1, data["action"].unsqueeze(-1)).squeeze(-1)
    losses = by_loop(mu.log()[None], data["next", "reward"].T, data["next", "done"].T)
    loss = plain_loss(categorical(module, logits_key), correction=Behaviour(), strategy=strategy)
    torch.testing.assert_close(loss(data)["loss_actor"], losses.sum())


@pytest.mark.parametrize("spec", [MultiOneHot([3, 2]), MultiCategorical([3, 2])])
def test_the_gradient_of_a_behaviour_with_several_heads(spec):
    module, data = network(5), frames(6)
    heads = torch.stack([data["action"], data["action"] % 2], -1)
    hot = [nn.functional.one_hot(heads[:, i], n) for i, n in enumerate((3, 2))]
    data["action"] = torch.cat(hot, -1).bool() if isinstance(spec, MultiOneHot) else heads
    data["action_mask"] = torch.cat(hot, -1).bool() | torch.tensor([1, 0, 0, 1, 0]).bool()
    strategy = EpsilonSoftmax(0.3, 2.0, spec=spec)
    logits = module.module(data["observation"]).masked_fill(~data["action_mask"], -torch.inf)
    own = EpsilonSoftmax(0.3, 2.0)
    mu = [own.probs(part).gather(-1, heads[:, i : i + 1]).log().squeeze(-1)
          for i, part in enumerate(logits.split((3, 2), -1))]  # fmt: skip
    torch.testing.assert_close(strategy.log_prob(module(data.copy()), data["action"]), sum(mu))
    losses = by_loop(sum(mu)[None], data["next", "reward"].T, data["next", "done"].T)
    loss = plain_loss(
        categorical(module), correction=Behaviour(), strategy=strategy, entropy_coeff=0.1
    )
    entropy = sum(
        Categorical(own.probs(part), validate_args=False).entropy().sum()
        for part in logits.split((3, 2), -1)
    )
    found, expected = loss(data)["loss_actor"], losses.sum() - 0.1 * loss.weight * entropy
    torch.testing.assert_close(found, expected)
    torch.testing.assert_close(
        torch.autograd.grad(found, loss.parameters()),
        torch.autograd.grad(expected, list(module.parameters())),
    )  # fmt: skip


def test_the_gradient_of_a_continuous_behaviour_without_trials():
    net = nn.Sequential(nn.Linear(4, 4), NormalParamExtractor())
    module = TensorDictModule(net, ["observation"], [("pi", "mean"), ("pi", "width")])
    actor = ProbabilisticActor(
        module, in_keys={"loc": ("pi", "mean"), "scale": ("pi", "width")},
        distribution_class=TanhNormal,
    )  # fmt: skip
    keys: Any = {"loc_key": ("pi", "mean"), "scale_key": ("pi", "width")}
    loss = plain_loss(actor, correction=Behaviour(), strategy=Gaussian(2.0, **keys))
    data = frames(6)
    data["action"] = torch.randn(6, 2)
    loc, scale = net(data["observation"])
    log_prob = Normal(loc, 2 * scale).log_prob(data["action"]).sum(-1)
    losses = by_loop(log_prob[None], data["next", "reward"].T, data["next", "done"].T)
    torch.testing.assert_close(loss(data)["loss_actor"], losses.sum())


def test_a_policy_of_several_modules_is_used_whole():
    module = network()
    half = TensorDictModule(lambda logits: 0.5 * logits, ["logits"], ["scores"])
    actor = ProbabilisticActor(
        TensorDictSequential(module, half), in_keys={"logits": "scores"},
        distribution_class=Categorical,
    )  # fmt: skip
    strategy = Softmax(0.5, logits_key="scores")
    loss = plain_loss(actor, correction=Behaviour(), strategy=strategy)
    data = frames(6)
    # softmax at T = 1/2 of half of the logits: softmax of the logits.
    torch.testing.assert_close(loss(data)["trial_loss"], expected(module, data[None]).detach())


@pytest.mark.parametrize("dtype", [torch.bool, torch.int8, torch.float32])
def test_the_target_obeys_a_mask_of_another_name_and_type(dtype):
    module, data = network(), frames(6)
    mask = nn.functional.one_hot(data["action"], 3) + torch.tensor([1, 0, 0]) > 0
    logits = module.module(data["observation"]).masked_fill(~mask, -torch.inf).log_softmax(-1)
    log_prob = logits.gather(-1, data["action"].unsqueeze(-1)).squeeze(-1)
    losses = by_loop(log_prob[None], data["next", "reward"].T, data["next", "done"].T)
    data["legal"] = mask.to(dtype)
    out = plain_loss(SoftmaxActor(module, action_mask_key="legal"))(data)
    torch.testing.assert_close(out["loss_actor"], losses.sum())
    data["legal"] = mask
    keys: Any = {"logits": "logits", "mask": "legal"}
    torchrls = ProbabilisticActor(module, in_keys=keys, distribution_class=MaskedCategorical)
    torch.testing.assert_close(plain_loss(torchrls)(data)["loss_actor"], losses.sum())
