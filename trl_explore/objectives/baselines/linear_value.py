"""A critic: a learned linear value function."""

from __future__ import annotations

import math

import torch
from tensordict import NestedKey
from torch import Tensor, nn
from torchrl.envs import EnvBase

from trl_explore.checks import check_number
from trl_explore.numerics.layers import lane_linear
from trl_explore.objectives.baselines.baseline import Baseline
from trl_explore.objectives.episodes import Episodes
from trl_explore.strategies.frames import read


class LinearValue(Baseline):
    """b_t = V(s_t) = w · s_t + c, one (w, c) per trial, trained together with the actor.

    Minimises (1 / n_k) Σ_t (V(s_t) − G_t)² over the n_k frames of trial k, with the policy's
    optimiser and a separate learning rate ("REINFORCE with baseline", Sutton & Barto, §13.4).
    Unbiased: V depends only on the state and on earlier episodes. Off-policy, V estimates the value
    of μ.

    Args:
        lr: the learning rate of the critic, > 0. It is large because returns are large numbers and
            Adam moves each weight by about ``lr`` per update.
        observation_key: the entry with s [*batch, n_features], or [*batch, agents, n_features].

    Raises:
        ValueError: if ``lr`` is not a positive number; when called, if ``bind`` was not called, or
            the data have more trials than the environment of ``bind``.

    Example:
        >>> from trl_explore.envs import make_env
        >>> baseline = LinearValue()
        >>> baseline.bind(make_env("CartPole-v1", trials=3))
        >>> [tuple(p.shape) for p in baseline.parameters()]
        [(3, 1, 4), (3, 1)]
    """

    def __init__(self, lr: float = 0.5, *, observation_key: NestedKey = "observation") -> None:
        super().__init__()
        self.lr = check_number("lr", lr, 0, low_open=True)
        self.observation_key = observation_key
        self.weight = nn.Parameter(torch.zeros(0, 1, 0))
        self.bias = nn.Parameter(torch.zeros(0, 1))

    def bind(self, env: EnvBase) -> None:
        """Create the parameters, all 0; call it before the optimiser is built.

        Args:
            env: the environment; its batch size gives the number of trials, one if it has none, and
                the spec of the observation that of the agents.
        """
        *rows, n_features = env.observation_spec[self.observation_key].shape
        trials = math.prod(rows)
        self.weight = nn.Parameter(torch.zeros(trials, 1, n_features))
        self.bias = nn.Parameter(torch.zeros(trials, 1))

    def value(self, episodes: Episodes) -> Tensor:
        """V(s_t) [frames]."""
        trials = len(self.weight)
        if trials < episodes.trials:
            raise ValueError(
                "LinearValue has no weights: call bind(env) before the optimiser is built"
                if trials == 0
                else f"the data have {episodes.trials} trials, but LinearValue was bound to "
                f"{trials}; for one critic, call the loss with trials=1"
            )
        observation = read(episodes.tensordict, self.observation_key).to(self.weight.dtype)
        if episodes.layout.agents > 1:
            observation = observation.transpose(0, 1).flatten(0, 1)
        value = lane_linear(observation, self.weight, episodes.trial)
        return (value + self.bias.index_select(0, episodes.trial)).squeeze(-1)

    def forward(self, episodes: Episodes) -> Tensor:
        """V(s_t), without gradient [frames]."""
        with torch.no_grad():
            return self.value(episodes)

    def loss(self, episodes: Episodes) -> Tensor:
        """The mean squared error of every trial [trials]."""
        return episodes.trial_mean((self.value(episodes) - episodes.returns) ** 2)
