"""The policy gradient of a linear softmax policy in closed form, without autograd."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import torch
from tensordict import TensorDictParams
from tensordict.nn import ProbabilisticTensorDictSequential
from torch import Tensor

from trl_explore.numerics.dispatch import transformed
from trl_explore.numerics.surrogate import (
    FrameArrays,
    formula_applies,
    linear_softmax_gradient,
    linear_softmax_reinforce,
    reinforce_of_arrays,
)
from trl_explore.objectives.episodes import Episodes
from trl_explore.policies.actor import SoftmaxActor, fitted, has_linear_softmax


def linear_weight_key(actor: ProbabilisticTensorDictSequential) -> tuple[str, ...] | None:
    """The key of W among the parameters of a linear softmax; None for any other π."""
    if not has_linear_softmax(actor):
        return None
    weight = weight_of(actor, None, ())
    names = (tuple(name.split(".")) for name, p in actor.named_parameters() if p is weight)
    return next(names, None)


def linear_weight(
    actor: ProbabilisticTensorDictSequential,
    parameters: TensorDictParams | None,
    key: tuple[str, ...],
    episodes: Episodes,
) -> Tensor | None:
    """W [trials, n_actions, n_features]; None if π in these data is another than softmax(W s).

    ``parameters`` are those of the actor, with W under ``key``; None: the actor holds them.
    """
    masked = cast(SoftmaxActor, actor).action_mask_key in episodes.tensordict
    if masked or episodes.layout.agents > 1:
        return None
    weight = weight_of(actor, parameters, key)
    return weight if len(weight) == episodes.trials else None


def weight_of(
    actor: ProbabilisticTensorDictSequential,
    parameters: TensorDictParams | None,
    key: tuple[str, ...],
) -> Tensor:
    """W of a linear softmax [trials, n_actions, n_features]; arguments as in ``linear_weight``."""
    if parameters is not None:
        return parameters.get(key)
    policy: Any = actor.module[0]  # the index of a sequence is slow
    return policy.weight


def closed_form_of_arrays(
    weight: Tensor, frames: FrameArrays, gamma: float, baseline: float, scale: float
) -> Tensor | None:
    """``closed_form`` with A_t = G_t − b of valid frames; None if autograd is needed."""
    fits = weight.is_cpu and weight.dtype is torch.float32 and not transformed(weight)
    if not (fits and _takes_gradient(weight)):
        return None
    found = reinforce_of_arrays(frames, weight, gamma, baseline, scale)
    return None if found is None else _accumulated(weight, *found)


def closed_form(
    weight: Tensor,
    episodes: Episodes,
    action: Tensor,
    scale: float,
    baseline: float | None,
    factor: Callable[[], Tensor],
) -> Tensor | None:
    """S_k = scale · Σ_{t ∈ frames of trial k} A_t log π(a_t|s_t); adds ∂S/∂W to W's gradient.

    ``action`` [frames] are indices or one-hot, ``baseline`` is b if A_t = G_t − b, else None, and
    ``factor()`` gives A [frames].

    Returns:
        S [trials]; None if these tensors need autograd.
    """
    observation, trial = episodes.tensordict.get("observation"), episodes.trial
    action = fitted(action, trial.shape, weight.shape[1])
    if not _takes_gradient(weight) or not formula_applies(observation, weight, episodes.reward):
        return None
    found = None
    if baseline is not None:
        found = linear_softmax_reinforce(
            observation, weight, action, episodes.reward, episodes.done, trial,
            gamma=episodes.gamma, baseline=baseline, scale=scale,
        )  # fmt: skip
    if found is None:
        advantage = factor()
        if not formula_applies(observation, weight, advantage):
            return None
        found = linear_softmax_gradient(observation, weight, action, advantage, trial, scale)
    return _accumulated(weight, *found)


def _accumulated(weight: Tensor, surrogate: Tensor, gradient: Tensor) -> Tensor:
    """S, after its gradient is added to that of W."""
    weight.grad = gradient if weight.grad is None else weight.grad.add_(gradient)
    return surrogate


def _takes_gradient(weight: Tensor) -> bool:
    """Whether a gradient may be added to W without autograd, which calls hooks and goes on."""
    hooked = weight._backward_hooks or weight._post_accumulate_grad_hooks
    return weight.requires_grad and weight.is_leaf and not hooked
