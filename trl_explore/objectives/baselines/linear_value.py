"""A critic: a learned linear value function."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torchrl.envs import EnvBase

from trl_explore.checks import check_number
from trl_explore.numerics.layers import lane_linear
from trl_explore.objectives.baselines.baseline import Baseline
from trl_explore.objectives.episodes import Episodes


class LinearValue(Baseline):
    """b_t = V(s_t) = w · s_t + c, one (w, c) per trial, trained together with the actor.

    Minimises (1 / n_k) Σ_t (V(s_t) − G_t)² over the n_k frames of trial k, with the policy's
    optimiser and a separate learning rate ("REINFORCE with baseline", Sutton & Barto, §13.4).
    Unbiased: V depends only on the state and on earlier episodes. Off-policy, V estimates the value
    of μ.

    Args:
        lr: the learning rate of the critic, > 0. It is large because returns are large numbers and
            Adam moves each weight by about ``lr`` per update.

    Raises:
        ValueError: if ``lr`` is not a positive number.

    Example:
        >>> from trl_explore.envs import make_env
        >>> baseline = LinearValue()
        >>> baseline.bind(make_env("CartPole-v1", trials=3))
        >>> [tuple(p.shape) for p in baseline.parameters()]
        [(3, 1, 4), (3, 1)]
    """

    def __init__(self, lr: float = 0.5) -> None:
        super().__init__()
        self.lr = check_number("lr", lr, 0, low_open=True)
        self.weight = nn.Parameter(torch.zeros(0, 1, 0))
        self.bias = nn.Parameter(torch.zeros(0, 1))

    def bind(self, env: EnvBase) -> None:
        """Create the parameters, all 0."""
        (trials,) = env.batch_size
        n_features = env.observation_spec["observation"].shape[-1]
        self.weight = nn.Parameter(torch.zeros(trials, 1, n_features))
        self.bias = nn.Parameter(torch.zeros(trials, 1))

    def value(self, observation: Tensor, trial: Tensor) -> Tensor:
        """V(s) [frames]."""
        return (
            lane_linear(observation, self.weight, trial) + self.bias.index_select(0, trial)
        ).squeeze(-1)

    def forward(self, episodes: Episodes) -> Tensor:
        """V(s_t), without gradient [frames]."""
        with torch.no_grad():
            return self.value(episodes.tensordict.get("observation"), episodes.trial)

    def loss(self, episodes: Episodes) -> Tensor:
        """The mean squared error of every trial [trials]."""
        value = self.value(episodes.tensordict.get("observation"), episodes.trial)
        return episodes.trial_mean((value - episodes.returns) ** 2)
