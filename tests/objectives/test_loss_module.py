"""The loss as a LossModule: parameters, keys and calls."""

import math
import re

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torch.distributions import Independent, Normal
from torchrl.modules import NormalParamExtractor, ProbabilisticActor, TanhNormal

from tests.objectives.episodes import (
    EPISODE,
    KINDS,
    LN3,
    discount_rewards,
    episode,
    gradients,
    random_episodes,
    tabular,
)
from trl_explore.objectives import ReinforceLoss
from trl_explore.policies import LinearPolicy
from trl_explore.policies.actor import SoftmaxActor


@pytest.mark.parametrize("kind", KINDS)
def test_data_are_left_alone(kind, env):
    data = torch.cat([episode([1, 0], [1.0, 2.0], trial=1, done=False), episode([0], [4.0])])
    before = data.clone()
    ReinforceLoss(tabular(kind, env)[0], trials=30)(data)
    # The actor may add its "logits", as under TorchRL's own losses.
    assert (data.exclude("logits") == before).all()


@pytest.mark.parametrize("kind", KINDS)
def test_no_gradient_flows_into_the_data(kind, env):
    data = episode([1, 0], [1.0, 2.0])
    data["next", "reward"].requires_grad_()
    ReinforceLoss(tabular(kind, env)[0])(data)["loss_actor"].backward()
    assert data["next", "reward"].grad is None


@pytest.mark.parametrize("kind", KINDS)
def test_functional_and_not_agree_and_share_the_parameters(kind, env):
    actor, weight = tabular(kind, env)
    data = random_episodes([5, 3])
    results = []
    for functional in (True, False):
        loss = ReinforceLoss(actor, functional=functional, trials=30)
        assert loss.functional is functional
        assert [p.data_ptr() for p in loss.parameters()] == [weight.data_ptr()]
        results.append((loss(data)["loss_actor"].detach(), gradients(loss, data)[0]))
        assert torch.equal(weight.grad, results[-1][1])
    assert torch.equal(results[0][0], results[1][0])
    assert torch.equal(results[0][1], results[1][1])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("functional", [True, False])
def test_an_optimiser_of_the_loss_trains_the_policy(kind, functional, env):
    actor, weight = tabular(kind, env)
    before = weight.detach().clone()
    loss = ReinforceLoss(actor, functional=functional)
    optimizer = torch.optim.SGD(loss.parameters(), lr=1.0)
    data = episode([1], [1.0])
    loss(data)["loss_actor"].backward()
    optimizer.step()
    # -∂L/∂logit of the action that was rewarded: w (1 - π) = 0.05 / 4.
    moved = (weight.detach() - before).reshape(-1, 2, 4)[0, :, 0]
    torch.testing.assert_close(moved, torch.tensor([-0.0125, 0.0125]))
    assert loss(data)["loss_actor"] < ReinforceLoss(tabular(kind, env)[0])(data)["loss_actor"]


def test_keys_can_be_renamed(env):
    actor, _ = tabular("torch", env)
    data = torch.cat([episode([1, 0], [1.0, 2.0], trial=1, done=False), episode([0], [4.0])])
    expected = ReinforceLoss(actor)(data)["trial_loss"]
    loss = ReinforceLoss(actor)
    assert set(loss.in_keys) >= {"action", ("next", "reward"), ("next", "done"), "trial"}
    loss.set_keys(action="move", reward="gain", done=("agents", "over"), trial="lane")
    renamed = TensorDict(
        {
            "observation": data["observation"],
            "move": data["action"],
            "lane": data["trial"],
            "next": {
                "gain": data["next", "reward"],
                "agents": {"over": data["next", "done"]},
            },
        },
        [3],
    )
    assert torch.equal(loss(renamed)["trial_loss"], expected)
    assert set(loss.in_keys) >= {"move", ("next", "gain"), "lane", "observation"}
    with pytest.raises(ValueError, match="nonsense"):
        loss.set_keys(nonsense="x")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("with_trial", [True, False])
def test_call_without_a_tensordict(kind, with_trial, env):
    loss = ReinforceLoss(tabular(kind, env)[0], trials=30)
    data = episode(*EPISODE, trial=0)
    entries = {
        "observation": data["observation"],
        "action": data["action"],
        "next_reward": data["next", "reward"],
        "next_done": data["next", "done"],
    }
    if with_trial or kind == "linear":
        entries["trial"] = data["trial"]
    expected = loss(data)
    actor_loss, trial_loss = loss(**entries)
    torch.testing.assert_close(actor_loss, expected["loss_actor"])
    torch.testing.assert_close(trial_loss[0], expected["trial_loss"][0])


@pytest.mark.parametrize("missing", ["action", ("next", "reward"), ("next", "done")])
def test_a_missing_entry(missing, env):
    loss = ReinforceLoss(tabular("torch", env)[0])
    with pytest.raises(KeyError, match=re.escape(f"missing key: {missing!r}; the data have")):
        loss(episode(*EPISODE).exclude(missing))


@pytest.mark.parametrize("trials", [None, 30])
def test_action_mask_in_the_target(trials, env):
    policy = LinearPolicy(env)
    policy.module.weight = nn.Parameter(torch.tensor([[0.0] * 4, [LN3, 0, 0, 0]]).repeat(30, 1, 1))
    actor = SoftmaxActor(policy, masked=True)
    loss = ReinforceLoss(actor, weight=1.0, gamma=1.0, trials=trials)
    data = episode([0, 1], [0.0, 1.0])
    data["action_mask"] = torch.tensor([[True, False], [True, True]])
    # The first action had no alternative: log 1 = 0.
    assert loss(data)["loss_actor"].item() == pytest.approx(-math.log(0.75), rel=1e-6)
    assert "action_mask" in loss.in_keys


@pytest.mark.parametrize("distribution", [TanhNormal, Normal, Independent])
def test_continuous_actions(distribution):
    torch.manual_seed(4)
    size = 1 if distribution is Normal else 2
    net = nn.Sequential(nn.Linear(4, 2 * size), NormalParamExtractor())
    module = TensorDictModule(net, ["observation"], ["loc", "scale"])

    def independent(loc, scale):
        return Independent(Normal(loc, scale), 1)

    actor = ProbabilisticActor(
        module,
        in_keys=["loc", "scale"],
        distribution_class=independent if distribution is Independent else distribution,
    )
    data = random_episodes([4, 3])
    data["action"] = 1.8 * torch.rand(7, size) - 0.9
    loss = ReinforceLoss(actor, weight=1.0, gamma=0.9)
    out = loss(data)
    advantage = torch.cat(
        [
            torch.tensor(discount_rewards(part["next", "reward"].squeeze(-1).numpy(), 0.9))
            for part in data.split([4, 3])
        ]
    )
    loc, scale = net(data["observation"])
    if distribution is TanhNormal:
        x = data["action"].atanh()
        log_prob = (Normal(loc, scale).log_prob(x) - (1 - data["action"] ** 2).log()).sum(-1)
    else:
        log_prob = Normal(loc, scale).log_prob(data["action"]).sum(-1)
    expected = -(advantage * log_prob)
    torch.testing.assert_close(out["loss_actor"], expected.sum(), rtol=1e-4, atol=1e-4)
    per_trial = torch.stack([part.sum() for part in expected.split([4, 3])]).detach()
    torch.testing.assert_close(out["trial_loss"], per_trial, rtol=1e-4, atol=1e-4)


def test_no_frames(env):
    for kind in KINDS:
        loss = ReinforceLoss(tabular(kind, env)[0], trials=30)
        out = loss(episode([0], [0.0])[:0])
        assert out["loss_actor"].item() == 0
        assert out["trial_loss"].tolist() == [0.0] * 30
