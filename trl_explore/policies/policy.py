"""Layers with one set of weights per trial, and the sizes in an environment's specs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, cast

import torch
from torch import Tensor, nn
from torchrl.data import Bounded, Categorical, Unbounded
from torchrl.envs import EnvBase

from trl_explore.numerics.layers import activate, check_activation, lane_linear
from trl_explore.policies.initial import initial_weights

if TYPE_CHECKING:
    import gymnasium as gym


def n_actions(env: EnvBase) -> int:
    """The number of actions of an environment with a Categorical action spec."""
    spec = env.action_spec
    if not isinstance(spec, Categorical):
        raise ValueError(
            f"a softmax policy needs a Categorical action spec, got {type(spec).__name__}"
        )
    return spec.n


def n_dims(env: EnvBase) -> int:
    """The number of dimensions of a continuous action.

    Raises:
        ValueError: if the actions are not vectors of real numbers.
    """
    spec = env.action_spec
    if not isinstance(spec, Bounded | Unbounded) or spec.domain != "continuous":
        raise ValueError(
            f"a Gaussian policy needs a Bounded or Unbounded action spec, got {type(spec).__name__}"
        )
    return spec.shape[-1]


def n_features(env: EnvBase) -> int:
    """The length of an observation."""
    return env.observation_spec["observation"].shape[-1]


def observation_space(env: EnvBase) -> gym.Space:
    """The observation space of an environment of ``make_env`` before flattening."""
    from trl_explore.envs import lane_env

    return lane_env(env).envs[0].observation_space


def is_one_hot(env: EnvBase) -> bool:
    """Whether the observations are one-hot states."""
    from gymnasium.spaces import Discrete

    return isinstance(observation_space(env), Discrete)


def has_hooks(module: nn.Module) -> bool:
    """Whether the module or a submodule has hooks, so that a call does more than ``forward``."""
    kinds = ("_forward_hooks", "_forward_pre_hooks", "_backward_hooks", "_backward_pre_hooks")
    return any(getattr(part, kind) for part in module.modules() for kind in kinds)


class LaneLinear(nn.Module):
    """y = W[trial] x + b[trial]; ``weight`` is [trials, n_out, n_in], ``bias`` [trials, n_out].

    Args:
        weight: the initial weights.
        bias: the initial bias; None for b = 0.
    """

    def __init__(self, weight: Tensor, bias: Tensor | None = None) -> None:
        super().__init__()
        self.weight = nn.Parameter(weight)
        self.bias = None if bias is None else nn.Parameter(bias)

    def forward(self, observation: Tensor, trial: Tensor) -> Tensor:
        """[*batch, n_in], [*batch] -> [*batch, n_out]."""
        return lane_linear(observation, self.weight, trial, self.bias)


class LaneMLP(nn.Module):
    """A multilayer perceptron per trial: y = W_L h_{L−1} + b_L, h_i = φ(W_i h_{i−1} + b_i).

    h_0 is the input; φ = tanh or relu; biases are initially 0. Each sum runs over the frames of one
    trial, in a fixed order, so a trial's outputs and gradients do not depend on the other trials,
    bit for bit.

    Args:
        sizes: the number of inputs, the units of every hidden layer (any number of layers), and
            the number of outputs.
        trials: the number of trials.
        activation: φ, "tanh" or "relu".
        init: the initial weights, a name from ``initial_weights``; "zeros" only without hidden
            layers, which would have no gradient.
        seed: seed of the job.
        first_trial: trial index of row 0.
        bias: whether there are biases.
        output_gain: factor of the last layer's initial weights.
        network: the index of the network within the trial, see ``initial_weights``.

    Raises:
        ValueError: if an argument is out of range or unknown.

    Example:
        >>> mlp = LaneMLP([4, 32, 32, 2], trials=3)
        >>> mlp(torch.ones(5, 4), torch.tensor([0, 0, 1, 1, 2])).shape
        torch.Size([5, 2])
    """

    def __init__(
        self,
        sizes: Sequence[int],
        trials: int,
        activation: str = "tanh",
        init: str = "glorot_uniform",
        seed: int = 0,
        first_trial: int = 0,
        *,
        bias: bool = True,
        output_gain: float = 1.0,
        network: int = 0,
    ) -> None:
        super().__init__()
        self.activation = check_activation(activation)
        self.sizes = list(sizes)
        if not isinstance(bias, bool):
            raise ValueError(f"bias must be true or false, got {bias!r}")
        if init == "zeros" and len(sizes) > 2:
            raise ValueError("init 'zeros' gives hidden layers no gradient; choose another init")
        streams = {"seed": seed, "first_trial": first_trial, "network": network}
        weights = initial_weights(sizes, trials, init, output_gain=output_gain, **streams)
        self.layers = nn.ModuleList(
            LaneLinear(weight, torch.zeros(weight.shape[:2]) if bias else None)
            for weight in weights
        )

    def forward(self, observation: Tensor, trial: Tensor) -> Tensor:
        """[*batch, n_in], [*batch] -> [*batch, n_out]."""
        *hidden, last = cast(list[LaneLinear], list(self.layers))
        for layer in hidden:
            observation = activate(layer(observation, trial), self.activation)
        return last(observation, trial)
