"""What compiled code can stand in for: the checks that the compiled collectors share."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict.nn import TensorDictSequential
from torch import nn
from torchrl.data import OneHot
from torchrl.envs import RewardSum, StepCounter, Transform, TransformedEnv

from trl_explore.checks import holds
from trl_explore.collectors.networks import Network
from trl_explore.policies.layers import has_hooks
from trl_explore.strategies import ContinuousMixtureStrategy, MixtureStrategy

TRANSFORMS = (StepCounter, RewardSum)
"""The transforms that compiled code stands in for."""


class NotCompilableError(ValueError):
    """A compiled collector does not support its arguments; the message gives the reason."""


def has_mask(env: TransformedEnv) -> bool:
    """Whether an environment has action masks."""
    return env.observation_spec.get("action_mask", None) is not None


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


def check_transforms(env: TransformedEnv) -> None:
    """Reject the transforms of the user.

    Raises:
        NotCompilableError: with the name of the first.
    """
    for transform in cast(Iterable[Transform], env.transform or ()):
        if type(transform) not in TRANSFORMS:
            name = type(transform).__name__
            raise NotCompilableError(f"it does not support the transform {name}")


def names(policy: TensorDictSequential) -> str:
    """The class names of the modules before the strategy."""
    return ", ".join(type(module).__name__ for module in policy.module[:-1])


def check_weights(
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
    if all(isinstance(value, float) for value in point):
        return np.array(point).reshape(4, 1)
    columns = np.broadcast_arrays(*map(np.atleast_1d, point))
    if columns[0].shape not in ((1,), (trials,)):
        raise ValueError(f"a mixture has {columns[0].size} values, but there are {trials} trials")
    return np.stack(columns).astype(np.float64)
