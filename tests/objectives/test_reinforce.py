"""The loss by hand and against other formulations."""

import math

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn

from tests.objectives.episodes import (
    EPISODE,
    KINDS,
    LOSS,
    SLOPE,
    discount_rewards,
    episode,
    random_episodes,
    tabular,
    torch_actor,
)
from trl_explore.objectives import ReinforceLoss
from trl_explore.policies import LinearPolicy
from trl_explore.policies.actor import SoftmaxActor

# Numbers worked out by hand


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("functional", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_value_and_gradient_by_hand(kind, functional, dtype, env):
    actor, weight = tabular(kind, env, dtype)
    loss = ReinforceLoss(actor, gamma=0.5, weight=0.1, baseline=0.5, functional=functional)
    out = loss(episode(*EPISODE, dtype=dtype))
    assert out["loss_actor"].dtype == out["trial_loss"].dtype == dtype
    torch.testing.assert_close(out["loss_actor"], torch.tensor(LOSS, dtype=dtype))
    torch.testing.assert_close(out["trial_loss"], torch.tensor([LOSS], dtype=dtype))
    assert not out["trial_loss"].requires_grad
    out["loss_actor"].backward()
    expected = torch.tensor([[-SLOPE, 0, 0, 0], [SLOPE, 0, 0, 0]], dtype=dtype)
    torch.testing.assert_close(weight.grad if kind != "linear" else weight.grad[0], expected)


def test_defaults_are_those_of_the_thesis(env):
    actor, _ = tabular("linear", env)
    loss = ReinforceLoss(actor)
    assert (loss.gamma, loss.weight, loss.baseline.value, loss.reduction) == (
        0.99,
        0.05,
        0.0,
        "sum",
    )
    # Two frames of reward 1: G = 1.99 and 1.
    out = loss(episode([1, 0], [1.0, 1.0]))["loss_actor"]
    expected = -0.05 * (1.99 * math.log(0.75) + math.log(0.25))
    assert out.item() == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_policy_whatever_drew_the_action(kind, env):
    # The log-probability is that of the target, not the one under μ that the data carry.
    actor, _ = tabular(kind, env)
    loss = ReinforceLoss(actor, gamma=0.5, weight=0.1, baseline=0.5)
    data = episode(*EPISODE)
    data["action_log_prob"] = torch.tensor([-7.0, -8.0, -9.0])
    data["logits"] = torch.randn(3, 2)
    assert loss(data)["loss_actor"].item() == pytest.approx(LOSS, rel=1e-6)


# Against other formulations


def written_out(logits, data, gamma, weight, baseline=0.0):
    """L = -w Σ_t (G_t - b) log π(a_t|s_t) of one episode, as it stands in the thesis."""
    returns = discount_rewards(data["next", "reward"].squeeze(-1).double().numpy(), gamma)
    probs = logits.exp() / logits.exp().sum(-1, keepdim=True)
    total = 0.0
    for t, action in enumerate(data["action"].tolist()):
        total = total + (returns[t] - baseline) * probs[t, action].log()
    return -weight * total


@pytest.mark.parametrize("gamma", [0.0, 0.9, 0.99, 1.0])
@pytest.mark.parametrize("kind", ["torch", "ours"])
def test_against_autograd_of_the_formula(kind, gamma):
    torch.manual_seed(1)
    module = nn.Sequential(nn.Linear(4, 8), nn.Tanh(), nn.Linear(8, 3)).double()
    actor = torch_actor(module)
    if kind == "ours":
        actor = SoftmaxActor(TensorDictModule(module, ["observation"], ["logits"]))
    lengths = [5, 1, 30]
    data = random_episodes(lengths, n_actions=3, dtype=torch.float64)
    loss = ReinforceLoss(actor, gamma=gamma, weight=0.3, baseline=0.7)
    out = loss(data)
    terms = [
        written_out(module(part["observation"]), part, gamma, 0.3, 0.7)
        for part in data.split(lengths)
    ]
    torch.testing.assert_close(out["trial_loss"], torch.stack(terms).detach())
    torch.testing.assert_close(out["loss_actor"], sum(terms))
    expected = torch.autograd.grad(sum(terms), list(module.parameters()))
    found = torch.autograd.grad(out["loss_actor"], list(module.parameters()))
    torch.testing.assert_close(found, expected)


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("gamma", [0.9, 1.0])
def test_linear_policy_against_autograd_of_the_formula(gamma, masked, env):
    policy = LinearPolicy(env, seed=2).double()
    lengths = [7, 1, 20, 3] + [2] * 26
    data = random_episodes(lengths, dtype=torch.float64)
    if masked:
        data["action_mask"] = torch.ones(len(data), 2, dtype=torch.bool)
    out = ReinforceLoss(SoftmaxActor(policy, masked=masked), gamma=gamma, trials=30)(data)
    terms = [
        written_out(part["observation"] @ policy.weight[k].T, part, gamma, 0.05)
        for k, part in enumerate(data.split(lengths))
    ]
    torch.testing.assert_close(out["trial_loss"], torch.stack(terms).detach())
    (expected,) = torch.autograd.grad(sum(terms), policy.weight)
    (found,) = torch.autograd.grad(out["loss_actor"], policy.weight)
    torch.testing.assert_close(found, expected)


@pytest.mark.parametrize("gamma", [0.5, 0.99, 1.0])
@pytest.mark.parametrize(
    "rewards",
    [[1.0], [1.0] * 200, [0.0, 0.0, 5.0], [-1.0, 2.5, 0.0, -3.0], list(np.sin(np.arange(50.0)))],
    ids=len,
)
def test_advantage_is_the_thesis_discount_rewards(rewards, gamma, env):
    loss = ReinforceLoss(tabular("torch", env)[0], gamma=gamma)
    data = episode([0] * len(rewards), rewards, dtype=torch.float64)
    expected = discount_rewards(np.array(rewards), gamma)
    np.testing.assert_allclose(loss.advantage(data).numpy(), expected, rtol=1e-13, atol=1e-13)
    del data["trial"]
    np.testing.assert_allclose(loss.advantage(data).numpy(), expected, rtol=1e-13, atol=1e-13)


# Reduction


@pytest.mark.parametrize("kind", KINDS)
def test_reductions(kind, env):
    data = torch.cat([episode([1], [1.0], trial=0), episode([0, 0], [4.0, 1.0], trial=1)])
    actor, weight = tabular(kind, env)
    results, slopes = {}, {}
    for reduction in ("none", "sum", "mean"):
        n = 30 if kind == "linear" else 2
        loss = ReinforceLoss(actor, gamma=0.5, weight=1.0, reduction=reduction, trials=n)
        out = loss(data)
        results[reduction] = out["loss_actor"]
        assert torch.equal(out["trial_loss"], results["none"])
        (slopes[reduction],) = torch.autograd.grad(out["loss_actor"].sum(), weight)
    none = results["none"]
    assert none.requires_grad
    expected = torch.tensor([-math.log(0.75), -(4.5 + 1) * math.log(0.25)])
    torch.testing.assert_close(none[:2], expected)
    torch.testing.assert_close(results["sum"], expected.sum())
    torch.testing.assert_close(results["mean"], expected.sum() / n)
    torch.testing.assert_close(slopes["none"], slopes["sum"])
    torch.testing.assert_close(slopes["mean"], slopes["sum"] / n)


@pytest.mark.parametrize(
    "dtype", [torch.int64, torch.int32, torch.bool, torch.bfloat16, torch.float16]
)
def test_returns_of_rewards_of_other_types_are_float32(dtype):
    end = torch.zeros(600, 1, dtype=torch.bool)
    frames = {"observation": torch.zeros(600, 4), "action": torch.zeros(600, dtype=torch.int64)}
    after = {"reward": torch.ones(600, 1, dtype=dtype), "done": end}
    data = TensorDict({**frames, "next": after}, [600])
    returns = ReinforceLoss(torch_actor(), gamma=0.5).advantage(data)
    assert returns.dtype == torch.float32
    assert returns[-2:].tolist() == [1.5, 1.0]
    assert ReinforceLoss(torch_actor(), gamma=1.0).advantage(data)[0].item() == 600
