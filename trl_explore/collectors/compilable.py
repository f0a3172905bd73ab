"""Whether a policy, a strategy and transforms can be compiled; the error says why they cannot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import nn
from torchrl.data import OneHot
from torchrl.envs import CatFrames, DTypeCastTransform, Transform, TransformedEnv

from trl_explore.checks import holds
from trl_explore.collectors.compiled_policies import Network, gaussian_of, network_of
from trl_explore.policies.layers import has_hooks, is_one_hot, n_actions, n_dims, spec_env
from trl_explore.strategies import BaseStrategy, ContinuousMixtureStrategy, MixtureStrategy

PASSING = [kind._inv_call for kind in (Transform, CatFrames, DTypeCastTransform)]
"""The methods that leave what the environment gets as it is, without ``in_keys_inv``."""


class NotCompilableError(ValueError):
    """A compiled collector does not support its arguments; the message gives the reason."""


def has_mask(env: TransformedEnv) -> bool:
    """Whether an environment has action masks."""
    return spec_env(env).observation_spec.get("action_mask", None) is not None


def check_mixture(strategy: Any, *, continuous: bool = False) -> None:
    """Reject a strategy that its mixture does not describe completely.

    Args:
        strategy: the strategy.
        continuous: whether it is over vectors; otherwise over n actions.

    Raises:
        NotCompilableError: with the reason.
    """
    name = type(strategy).__name__
    kind = ContinuousMixtureStrategy if continuous else MixtureStrategy
    parts = "mean, Gaussian" if continuous else "argmax, softmax"
    if not isinstance(strategy, kind):
        raise NotCompilableError(f"{name} is not a mixture of {parts} and uniform")
    declared = "mixes_policy" if continuous else "compilable"
    if not getattr(strategy, declared) or not holds(strategy, declared, strategy.REPLACED):
        raise NotCompilableError(
            f"{name} overrides one of {', '.join(kind.REPLACED)} "
            "and does not declare itself compilable"
        )
    if has_hooks(strategy):
        raise NotCompilableError(f"{name} has hooks")
    read = ("loc", "scale") if continuous else ("logits", "action_mask")
    renamed = any(getattr(strategy, f"{key}_key") != key for key in (*read, "action"))
    if renamed or isinstance(getattr(strategy, "spec", None), OneHot):
        raise NotCompilableError(f"{name} has one-hot actions or renamed entries")
    if getattr(strategy, "squashed", False):
        raise NotCompilableError(f"{name} squashes its actions")


def has_inverse(transform: Transform) -> bool:
    """Whether a transform changes what the environment gets, such as its actions."""
    return bool(transform.in_keys_inv) or type(transform)._inv_call not in PASSING


def compilable_policy(
    env: TransformedEnv, policy: TensorDictSequential, n_features: int
) -> tuple[Network, list[nn.Parameter]]:
    """The network of a policy and its parameters, if its strategy's mixture is compiled too.

    Raises:
        NotCompilableError: with the reason, if they are not.
    """
    first, strategy = cast(TensorDictModuleBase, policy[0]), cast(BaseStrategy, policy[-1])
    continuous, found = strategy.actions == "continuous", None
    if len(policy) == 2:
        found = gaussian_of(first) if continuous else network_of(first, one_hot=is_one_hot(env))
    if found is None:
        kinds = ", ".join(type(module).__name__ for module in policy.module[:-1])
        raise NotCompilableError(f"it does not support the policy {kinds}")
    check_mixture(strategy, continuous=continuous)
    n_out = n_dims(env) if continuous else n_actions(env)
    _check_weights(*found, env.batch_size[0], n_features, n_out)
    return found


def _check_weights(
    network: Network, parameters: Sequence[nn.Parameter], trials: int, n_in: int, n_out: int
) -> None:
    """Compiled code does not check bounds, so sizes and types are validated here.

    Raises:
        NotCompilableError: with the sizes, or the type, that differ.
    """
    first = parameters[0]
    if (network.sizes[0], network.sizes[-1]) != (n_in, n_out) or len(first) != trials:
        raise NotCompilableError(
            f"the weights have shape {list(first.shape)}, but (trials, actions, features) are "
            f"{(trials, n_out, n_in)}"
        )
    for parameter in parameters:
        if parameter.dtype != torch.float32 or not parameter.is_cpu:
            raise NotCompilableError(
                "the weights must be torch.float32 on cpu, "
                f"got {parameter.dtype} on {parameter.device}"
            )


def mixture_array(point: Sequence[Any], trials: int) -> NDArray[np.float64]:
    """Weights and temperature [4, 1], or [4, trials] if they differ between trials.

    Raises:
        ValueError: if an entry does not have one value, or one for every trial.
    """
    if all([type(value) is float for value in point]):  # noqa: C419 - faster
        return np.array(point).reshape(4, 1)
    columns = np.broadcast_arrays(*map(np.atleast_1d, point))
    if columns[0].shape not in ((1,), (trials,)):
        raise ValueError(f"a mixture has {columns[0].size} values, but there are {trials} trials")
    return np.stack(columns).astype(np.float64)
