"""Baselines by hand: episodes whose returns are small whole numbers."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.modules import ProbabilisticActor, ValueOperator
from torchrl.objectives import ReinforceLoss as TorchRLReinforceLoss

from trl_explore.envs import make_env
from trl_explore.objectives import ReinforceLoss
from trl_explore.objectives.baselines import (
    Constant,
    EpisodeMean,
    LeaveOneOut,
    LinearValue,
    StepMean,
)
from trl_explore.objectives.episodes import Episodes
from trl_explore.policies import LinearPolicy
from trl_explore.policies.actor import SoftmaxActor


def episodes(*rewards, trial=None, trials=1, gamma=1.0):
    """One episode for each list of rewards; observations are (1, t)."""
    owner = trial or [0] * len(rewards)
    reward = torch.tensor([r for row in rewards for r in row])
    done = torch.tensor([t == len(row) - 1 for row in rewards for t in range(len(row))])
    whose = torch.tensor([k for k, row in zip(owner, rewards, strict=True) for _ in row])
    steps = torch.tensor([float(t) for row in rewards for t in range(len(row))])
    observation = torch.stack([torch.ones_like(steps), steps], 1)
    data = TensorDict({"observation": observation}, [len(reward)])
    return Episodes(data, reward, done, whose, trials, gamma)


def test_constant():
    assert Constant(2.5)(episodes([1.0, 1.0])) == 2.5
    with pytest.raises(ValueError, match=r"baseline.*finite"):
        Constant(float("nan"))


def test_the_mean_of_the_episode():
    # Returns 6, 5, 3 and 4: means 14/3 and 4.
    given = EpisodeMean()(episodes([1.0, 2.0, 3.0], [4.0]))
    torch.testing.assert_close(given, torch.tensor([14 / 3] * 3 + [4.0]))


def test_the_running_mean_knows_earlier_episodes_only():
    baseline = StepMean()
    first = episodes([1.0, 2.0, 3.0], [10.0], trial=[0, 1], trials=2)
    assert baseline(first).tolist() == [0, 0, 0, 0]
    baseline.step(first)
    second = episodes([2.0, 2.0], [0.0, 8.0], trial=[0, 1], trials=2)
    # Trial 0 had returns 6, 5, 3; trial 1 had 10, and never reached step 1.
    assert baseline(second).tolist() == [6, 5, 10, 0]
    baseline.step(second)  # returns 4, 2 and 8, 8
    third = episodes([1.0, 1.0, 1.0, 1.0], [1.0, 1.0], trial=[0, 1], trials=2)
    assert baseline(third).tolist() == [5, 3.5, 3, 0, 9, 8]


def test_the_running_mean_forgets():
    baseline = StepMean(decay=0.5)
    for score in (8.0, 2.0):
        baseline.step(episodes([score]))
    # (0.5 · 8 + 2) / (0.5 + 1)
    assert baseline(episodes([0.0])).tolist() == [4.0]
    baseline = StepMean(decay=0.5)
    baseline.step(episodes([8.0], [2.0]))  # two episodes of one iteration, in their order
    assert baseline(episodes([0.0])).tolist() == [4.0]


def test_the_running_mean_survives_a_checkpoint():
    baseline, other = StepMean(), StepMean()
    baseline.step(episodes([1.0, 2.0]))
    other.load_state_dict(baseline.state_dict())
    assert other(episodes([0.0, 0.0])).tolist() == [3, 2]


def test_leaving_one_out():
    # Returns of trial 0 by step: (3, 2), (5), (1, 1): the others' means, ended ones count as 0.
    given = LeaveOneOut()(
        episodes([1.0, 2.0], [5.0], [0.0, 1.0], [7.0], [9.0], trial=[0, 0, 0, 1, 1], trials=2)
    )
    expected = [(5 + 1) / 2, (0 + 1) / 2, (3 + 1) / 2, (3 + 5) / 2, (2 + 0) / 2, 9, 7]
    assert given.tolist() == expected


def test_leaving_one_out_needs_two():
    with pytest.raises(ValueError, match=r"episodes_per_update.*2"):
        LeaveOneOut()(episodes([1.0], [1.0], [1.0], trial=[0, 0, 1], trials=2))


def test_the_critic_agrees_with_torchrls_loss():
    """One trial: loss_actor with advantage G − V, and loss_value, the mean squared error."""
    torch.manual_seed(0)
    env = make_env("CartPole-v1", trials=1)
    policy = LinearPolicy(env)
    critic = LinearValue()
    critic.bind(env)
    with torch.no_grad():
        critic.weight.copy_(torch.randn(1, 1, 4))
        critic.bias.fill_(0.3)
    n = 7
    done = torch.zeros(n, 1, dtype=torch.bool)
    done[-1] = True
    data = TensorDict(
        {
            "trial": torch.zeros(n, dtype=torch.int64),
            "observation": torch.randn(n, 4),
            "action": torch.randint(2, (n,)),
            "next": {"reward": torch.randn(n, 1), "done": done, "terminated": done},
        },
        [n],
    )
    ours = ReinforceLoss(
        SoftmaxActor(policy), gamma=0.9, weight=1.0, baseline=critic, functional=False
    )(data)

    linear, value = nn.Linear(4, 2, bias=False), nn.Linear(4, 1)
    with torch.no_grad():
        linear.weight.copy_(policy.weight[0])
        value.weight.copy_(critic.weight[0])
        value.bias.copy_(critic.bias[0])
    returns, after = [], 0.0
    for r in reversed(data["next", "reward"][:, 0].tolist()):
        after = r + 0.9 * after
        returns.insert(0, after)
    target = torch.tensor(returns).unsqueeze(-1)
    data["value_target"] = target
    data["advantage"] = target - value(data["observation"]).detach()
    actor = ProbabilisticActor(
        TensorDictModule(linear, ["observation"], ["logits"]),
        in_keys=["logits"],
        distribution_class=torch.distributions.Categorical,
    )
    theirs = TorchRLReinforceLoss(
        actor,
        ValueOperator(value, in_keys=["observation"]),
        loss_critic_type="l2",
        reduction="none",
    )(data)
    torch.testing.assert_close(ours["loss_actor"], theirs["loss_actor"].sum())
    torch.testing.assert_close(ours["loss_value"], theirs["loss_value"].mean())
    ours["loss_value"].backward()
    theirs["loss_value"].mean().backward()
    torch.testing.assert_close(critic.weight.grad[0], value.weight.grad)
    torch.testing.assert_close(critic.bias.grad[0], value.bias.grad)
