"""Groups of agents: returns, weights and baselines."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.modules import (
    MultiAgentMLP,
)

from tests.objectives.frames import (
    by_loop,
    categorical,
    frames,
    network,
    plain_loss,
)
from trl_explore.objectives.baselines import LeaveOneOut, LinearValue
from trl_explore.objectives.corrections import PerStep


def group(data, agents, *, rewards):
    """Data of a group: a row of ``data`` for each agent, with one reward or one per agent."""
    grouped = data.select("observation", "action").transpose(0, 1).contiguous()  # [time, agents]
    own = {key: data["next", key].transpose(0, 1).contiguous() for key in ("reward", "done")}
    after = {"agents": own} if rewards > 1 else {k: v[:, 0] for k, v in own.items()}
    return TensorDict({"agents": grouped.to_dict(), "next": after}, [data.shape[1]])


def group_actor(agents, share=False):
    torch.manual_seed(1)
    net = MultiAgentMLP(
        4, 3, agents, centralized=False, share_params=share, depth=1, num_cells=8
    )  # vmaps over the agents' parameters
    key = ("agents", "logits")
    module = TensorDictModule(net, [("agents", "observation")], [key])
    return module, categorical(module, key)


def group_log_probs(module, data):
    logits = module(data.copy())["agents", "logits"].log_softmax(-1)
    return logits.gather(-1, data["agents", "action"].unsqueeze(-1)).squeeze(-1)


@pytest.mark.parametrize("padded", [False, True])
def test_every_agent_has_its_own_returns(padded):
    module, actor = group_actor(2)
    data = group(frames(2, 7), 2, rewards=2)
    loss = plain_loss(actor)
    loss.set_keys(action=("agents", "action"), reward=("agents", "reward"), done=("agents", "done"))
    kept = data[:5] if padded else data
    reward, done = (kept["next", "agents", key].squeeze(-1).T for key in ("reward", "done"))
    losses = by_loop(group_log_probs(module, kept).T, reward, done)
    rows = data[None].clone()
    if padded:
        rows["collector", "mask"] = torch.arange(7)[None] < 5
    for given in (rows, *(() if padded else (data,))):
        out = loss(given)
        torch.testing.assert_close(out["loss_actor"], losses.sum())
        assert out["trial_loss"].shape == (1,)
    advantage = loss.advantage(rows)
    assert advantage.shape == (1, 7, 2)
    single = plain_loss(categorical(network())).advantage(frames(2, 7)[:, : len(kept)])
    if not padded:
        torch.testing.assert_close(advantage[0].T, single)


def test_one_reward_belongs_to_the_joint_action():
    module, actor = group_actor(3)
    data = group(frames(3, 7), 3, rewards=1)
    loss = plain_loss(actor)
    loss.set_keys(action=("agents", "action"))
    joint = group_log_probs(module, data).sum(-1)
    losses = by_loop(joint[None], data["next", "reward"].T, data["next", "done"].T)
    torch.testing.assert_close(loss(data)["loss_actor"], losses.sum())


def test_weights_of_agents_are_their_own_and_those_of_a_team_are_joint():
    module, actor = group_actor(2)
    own, team = group(frames(2, 7), 2, rewards=2), group(frames(2, 7), 2, rewards=1)
    log_pi = group_log_probs(module, own).detach()
    log_mu = log_pi - torch.linspace(-0.5, 0.5, 14).reshape(7, 2)
    for data, rewards in ((own, 2), (team, 1)):
        data["agents", "action_log_prob"] = log_mu
        loss = plain_loss(actor, gamma=0.0, correction=PerStep())
        loss.set_keys(
            action=("agents", "action"), sample_log_prob=("agents", "action_log_prob"),
            reward=("agents", "reward") if rewards == 2 else "reward",
        )  # fmt: skip
        if rewards == 2:
            loss.set_keys(done=("agents", "done"))
            ratio, reward = (log_pi - log_mu).exp(), data["next", "agents", "reward"].squeeze(-1)
        else:
            ratio = (log_pi - log_mu).sum(-1).exp()
            reward = data["next", "reward"].squeeze(-1)
        torch.testing.assert_close(loss.advantage(data), ratio * reward)


def test_baselines_of_agents_are_their_own():
    _, actor = group_actor(2)
    data = group(frames(2, 6), 2, rewards=2)
    done = torch.zeros(6, 1, dtype=torch.bool)
    done[2] = done[5] = True  # two episodes of three frames; both agents end together
    data["next", "done"] = done
    reward = data["next", "agents", "reward"].squeeze(-1)
    loss = plain_loss(actor, gamma=0.0, baseline=LeaveOneOut())
    loss.set_keys(action=("agents", "action"), reward=("agents", "reward"))
    torch.testing.assert_close(loss.advantage(data), reward - reward.roll(3, 0))
    loss = plain_loss(actor, gamma=0.0, normalize_advantage=True)
    loss.set_keys(action=("agents", "action"), reward=("agents", "reward"))
    scaled = (reward - reward.mean(0)) / reward.std(0, correction=0)
    torch.testing.assert_close(loss.advantage(data), scaled)
    critic = LinearValue(observation_key=("agents", "observation"))
    critic.weight, critic.bias = nn.Parameter(torch.randn(2, 1, 4)), nn.Parameter(torch.ones(2, 1))
    loss = plain_loss(actor, gamma=0.0, baseline=critic)
    loss.set_keys(action=("agents", "action"), reward=("agents", "reward"))
    value = (data["agents", "observation"] * critic.weight[:, 0]).sum(-1) + 1
    torch.testing.assert_close(loss.advantage(data), (reward - value).detach())
    squares = ((reward - value) ** 2).mean(0).sum()
    torch.testing.assert_close(loss(data)["loss_value"], squares)
