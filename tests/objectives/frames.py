"""Frames as TorchRL programs have them, and the loss of a loop over them in Python."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torch.distributions import Categorical
from torchrl.modules import (
    ProbabilisticActor,
)

from trl_explore.objectives import ReinforceLoss

GAMMA = 0.9


def network(n_actions=3, key: Any = "logits", seed=0):
    torch.manual_seed(seed)
    return TensorDictModule(nn.Linear(4, n_actions), ["observation"], [key])


def categorical(module, key: Any = "logits", kind: Any = Categorical):
    return ProbabilisticActor(module, in_keys={"logits": key}, distribution_class=kind)


def frames(*batch, n_actions=3, seed=0, dtype=torch.float32):
    g = torch.Generator().manual_seed(seed)
    return TensorDict(
        {
            "observation": torch.randn(*batch, 4, generator=g).to(dtype),
            "action": torch.randint(n_actions, batch, generator=g),
            "next": {
                "reward": torch.randn(*batch, 1, generator=g).to(dtype),
                "done": torch.rand(*batch, 1, generator=g) < 0.2,
            },
        },
        list(batch),
    )


def by_loop(log_prob, reward, done, gamma=GAMMA):
    """−Σ_t G_t log π(a_t|s_t) of every row of [rows, time]."""
    losses = []
    for row in range(len(reward)):
        loss, after = torch.zeros(()), 0.0
        for t in reversed(range(reward.shape[1])):
            after = reward[row, t] + gamma * after * (not done[row, t])
            loss = loss - after * log_prob[row, t]
        losses.append(loss)
    return torch.stack(losses)


def log_probs(module, data, key: Any = "logits"):
    logits = module(data.copy())[key].log_softmax(-1)
    return logits.gather(-1, data["action"].unsqueeze(-1)).squeeze(-1)


def expected(module, data):
    reward, done = data["next", "reward"].squeeze(-1), data["next", "done"].squeeze(-1)
    return by_loop(log_probs(module, data), reward, done)


def plain_loss(actor, **options):
    return ReinforceLoss(actor, **{"gamma": GAMMA, "weight": 1.0, **options})
