"""Actors of known policies, and episodes for them."""

import math

import numpy as np
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torch.distributions import Categorical
from torchrl.modules import ProbabilisticActor

from trl_explore.policies import LinearPolicy
from trl_explore.policies.actor import SoftmaxActor

KINDS = ["torch", "ours", "linear"]
LN3 = math.log(3)

EPISODE = ([1, 0, 1], [1.0, 2.0, 3.0])
# γ = 1/2: G = 2.75, 3.5, 3; less b = 1/2: 2.25, 3, 2.5; times log π, times -w = -1/10.
LOSS = -0.1 * ((2.25 + 2.5) * math.log(0.75) + 3 * math.log(0.25))
# In the logit of action 1: -w (2.25 · 1/4 - 3 · 3/4 + 2.5 · 1/4); in that of action 0 the reverse.
SLOPE = 0.10625


def torch_actor(module=None):
    """A policy that knows nothing of this project."""
    logits = TensorDictModule(module or nn.Linear(4, 3), ["observation"], ["logits"])
    return ProbabilisticActor(logits, in_keys=["logits"], distribution_class=Categorical)


def tabular(kind, env, dtype=torch.float32):
    """An actor of logits (0, ln 3) in every state, that is π = (1/4, 3/4), and its weights."""
    table = torch.tensor([[0.0] * 4, [LN3, 0.0, 0.0, 0.0]], dtype=dtype)
    if kind == "linear":
        policy = LinearPolicy(env)
        policy.module.weight = nn.Parameter(table.expand(30, 2, 4).clone())
        return SoftmaxActor(policy), policy.weight
    module = nn.Linear(4, 2, bias=False)
    module.weight = nn.Parameter(table)
    if kind == "torch":
        return torch_actor(module), module.weight
    policy = TensorDictModule(module, ["observation"], ["logits"])
    return SoftmaxActor(policy), module.weight


def episode(actions, rewards, *, trial=0, done=True, dtype=torch.float32):
    """The frames of one episode, all in state (1, 0, 0, 0)."""
    n = len(actions)
    ends = torch.zeros(n, 1, dtype=torch.bool)
    ends[-1] = done
    observation = torch.zeros(n, 4, dtype=dtype)
    observation[:, 0] = 1
    return TensorDict(
        {
            "observation": observation,
            "trial": torch.full((n,), trial),
            "action": torch.tensor(actions),
            "next": {
                "reward": torch.tensor(rewards, dtype=dtype).unsqueeze(-1),
                "done": ends,
                "terminated": ends,
                "truncated": torch.zeros_like(ends),
            },
        },
        [n],
    )


def random_episodes(lengths, trials=None, n_actions=2, dtype=torch.float32, seed=0):
    """One episode of random frames for each length, one after the other."""
    g = torch.Generator().manual_seed(seed)
    trials = range(len(lengths)) if trials is None else trials
    parts = []
    for length, trial in zip(lengths, trials, strict=True):
        data = episode([0] * length, [0.0] * length, trial=trial, dtype=dtype)
        data["observation"] = torch.randn(length, 4, generator=g).to(dtype)
        data["action"] = torch.randint(n_actions, (length,), generator=g)
        data["next", "reward"] = torch.randn(length, 1, generator=g).to(dtype)
        parts.append(data)
    return torch.cat(parts)


def discount_rewards(r, gamma):
    """take 1D float array of rewards and compute discounted reward (thesis, A.2)"""
    discounted_r = np.zeros_like(r)
    running_add = 0
    for t in reversed(range(0, r.size)):
        running_add = running_add * gamma + r[t]
        discounted_r[t] = running_add
    return discounted_r


def gradients(loss, data, value="loss_actor"):
    loss.zero_grad()
    loss(data)[value].sum().backward()
    return [p.grad.clone() for p in loss.parameters()]
