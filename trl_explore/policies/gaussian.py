"""Gaussian policies for continuous actions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Unpack

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.envs import EnvBase

from trl_explore.checks import check_flag, check_number
from trl_explore.numerics.layers import lane_linear
from trl_explore.policies.layers import LaneLinear, LaneMLP, NetworkOptions, layer_sizes, n_dims

LARGEST_LOG = 20.0
"""Log-scales are kept within ±20; beyond that, an action or density may not be finite."""


class LaneGaussian(nn.Module):
    """(observation, trial) -> (loc, scale), with one network for each trial.

    Args:
        network: the network for the mean, with initial weights.
        log_scale: [n_dims], the initial logarithm of the scale.
        state_dependent: if True, the network gets n_dims further outputs, initially zero, that are
            added to a constant ``log_scale``; if False, ``log_scale`` [trials, n_dims] is learned.
    """

    def __init__(self, network: LaneMLP, log_scale: Tensor, *, state_dependent: bool) -> None:
        super().__init__()
        self.network = network
        if not state_dependent:
            trials = len(next(network.parameters()))
            self.log_scale = nn.Parameter(log_scale.repeat(trials, 1))
            return
        self.log_scale = None
        self.register_buffer("initial_log_scale", log_scale)
        last = network.layers[-1]
        assert isinstance(last, LaneLinear)
        grown = [_doubled(p.detach()) for p in (last.weight, last.bias) if p is not None]
        network.layers[-1] = LaneLinear(*grown)

    def forward(self, observation: Tensor, trial: Tensor) -> tuple[Tensor, Tensor]:
        """[*batch, n_features], [*batch] -> two tensors [*batch, n_dims]."""
        out = self.network(observation, trial)
        if self.log_scale is None:
            loc, change = out.chunk(2, -1)
            return loc, _scale(self.initial_log_scale + change)
        one = observation.new_ones(*trial.shape, 1)
        return out, lane_linear(one, self.scale().unsqueeze(-1), trial)

    def scale(self) -> Tensor:
        """The scale of every trial [trials, n_dims], if it does not depend on the observation."""
        assert self.log_scale is not None
        return _scale(self.log_scale)


def _doubled(weights: Tensor) -> Tensor:
    """[trials, n_out, ...] with n_out rows of zeros appended: [trials, 2 n_out, ...]."""
    return torch.cat([weights, torch.zeros_like(weights)], 1)


def _scale(log_scale: Tensor) -> Tensor:
    return log_scale.clamp(-LARGEST_LOG, LARGEST_LOG).exp()


class GaussianMLPPolicy(TensorDictModule):
    """π(·|s) = N(MLP(s), diag(scale²)), one multilayer perceptron (``LaneMLP``) per trial.

    log scale is a parameter per trial, the same in every state. With ``state_dependent_scale`` it
    is log initial_scale + h(s), where h are further outputs of the network, initially zero
    (Williams 1992, §6; Sutton & Barto 2018, §13.7). It is kept within ±20. Actions are not
    squashed; the environment clips them to its box.

    Reads "observation" [*batch, n_features] and "trial" [*batch] (the row of the parameters);
    writes "loc" and "scale" [*batch, n_dims], in the units of the actions.

    Args:
        env: the environment; its specs give the layer sizes, its batch size the number of trials.
        hidden: the units of every hidden layer; an empty list makes the mean linear.
        initial_scale: the initial standard deviation > 0, one number or one per dimension.
        state_dependent_scale: whether the scale depends on the observation.
        network: other arguments of ``LaneMLP``; small ``output_gain`` puts the first mean near 0.

    Raises:
        ValueError: if the actions are not continuous, or an argument is out of range.

    Example:
        >>> from trl_explore.envs import make_env
        >>> policy = GaussianMLPPolicy(make_env("Pendulum-v1", trials=2), hidden=[16])
        >>> [tuple(parameter.shape) for parameter in policy.parameters()]
        [(2, 1), (2, 16, 3), (2, 16), (2, 1, 16), (2, 1)]
    """

    actions = "continuous"

    def __init__(
        self,
        env: EnvBase,
        *,
        hidden: Sequence[int] = (32, 32),
        initial_scale: float | Sequence[float] = 1.0,
        state_dependent_scale: bool = False,
        **network: Unpack[NetworkOptions],
    ) -> None:
        (trials,) = env.batch_size
        dims = n_dims(env)
        mlp = LaneMLP(layer_sizes(env, hidden, dims), trials, **network)
        dependent = check_flag("state_dependent_scale", state_dependent_scale)
        first = _log_scale(initial_scale, dims)
        module = LaneGaussian(mlp, first, state_dependent=dependent)
        super().__init__(module, in_keys=["observation", "trial"], out_keys=["loc", "scale"])


class GaussianLinearPolicy(GaussianMLPPolicy):
    """π(·|s) = N(W s + b, diag(scale²)), one W, b and scale per trial.

    The Gaussian counterpart of ``LinearPolicy``: a ``GaussianMLPPolicy`` without hidden layers.

    Args:
        env: the environment; its specs give the layer sizes, its batch size the number of trials.
        options: the other arguments of ``GaussianMLPPolicy``.
    """

    def __init__(self, env: EnvBase, **options: Any) -> None:
        super().__init__(env, hidden=[], **options)


def _log_scale(initial_scale: float | Sequence[float], dims: int) -> Tensor:
    """The logarithm of ``initial_scale`` [n_dims]."""
    several = isinstance(initial_scale, Sequence) and not isinstance(initial_scale, str)
    values = list(initial_scale) if several else [initial_scale] * dims  # pyright: ignore
    if len(values) != dims:
        raise ValueError(
            f"initial_scale has {len(values)} values, but actions have {dims} dimensions"
        )
    bounds = math.exp(-LARGEST_LOG), math.exp(LARGEST_LOG)
    return torch.tensor([math.log(check_number("initial_scale", v, *bounds)) for v in values])
