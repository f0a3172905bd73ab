"""Log-probabilities of actions under a softmax and under a Gaussian."""

from __future__ import annotations

import math
from functools import reduce
from operator import add
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from trl_explore.numerics.dispatch import check_frames, compiled, supports

LOG_SQRT_2PI = 0.5 * math.log(2 * math.pi)


def categorical_log_prob(logits: Tensor, action: Tensor) -> Tensor:
    """Log softmax(logits)_action, with gradient 1[k = action] − softmax(logits)_k.

    Args:
        logits: [*batch, n_actions]; −∞ marks an illegal action.
        action: [*batch], integer indices.

    Returns:
        [*batch] (nats).

    Raises:
        ValueError: if the shapes do not match.
        IndexError: if an action is out of range.

    Example:
        >>> categorical_log_prob(torch.tensor([[0.0, 0.0]]), torch.tensor([1])).exp()
        tensor([0.5000])
    """
    check_frames(logits.shape[:-1], action=action)
    if not supports(logits):
        return plain_categorical_log_prob(logits, action)
    flat: Any = _CategoricalLogProb.apply(
        logits.reshape(-1, logits.shape[-1]).contiguous(), action.reshape(-1).long().contiguous()
    )
    return flat.reshape(action.shape)


def plain_categorical_log_prob(logits: Tensor, action: Tensor) -> Tensor:
    """``categorical_log_prob`` in torch, for any device and dtype."""
    return logits.log_softmax(-1).gather(-1, action.long().unsqueeze(-1)).squeeze(-1)


class _CategoricalLogProb(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, logits: Tensor, action: Tensor) -> Tensor:
        if action.numel() and not 0 <= int(action.min()) <= int(action.max()) < logits.shape[-1]:
            raise IndexError(f"every action must be in [0, {logits.shape[-1]})")
        probs = torch.empty_like(logits)
        out = logits.new_empty(len(logits))
        columns = logits.detach(), action, probs, out
        compiled("layers").softmax_log_prob(*(column.numpy() for column in columns))
        ctx.save_for_backward(probs, action)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None]:
        probs, action = ctx.saved_tensors
        out = torch.empty_like(probs)
        columns = probs, action, grad.contiguous(), out
        compiled("layers").softmax_log_prob_backward(*(column.numpy() for column in columns))
        return out, None


def gaussian_log_prob(action: Tensor, loc: Tensor, scale: Tensor) -> Tensor:
    """Log N(a; loc, diag(scale²)) = −Σ_j [½ ((a_j − loc_j) / scale_j)² + log scale_j + ½ log 2π].

    The sum over j runs in ascending order for each frame. It consists of torch's elementwise
    operations, so it is differentiable to any order.

    Args:
        action: a [*batch, n_dims].
        loc: [*batch, n_dims].
        scale: [*batch, n_dims], > 0.

    Returns:
        [*batch], the logarithm of a density (nats).

    Raises:
        ValueError: if the shapes do not match.

    Example:
        >>> import torch
        >>> zero, one = torch.zeros(2), torch.ones(2)
        >>> gaussian_log_prob(zero, zero, one).exp() * 2 * math.pi
        tensor(1.0000)
    """
    check_frames(loc.shape, action=action, scale=scale)
    terms = 0.5 * ((action - loc) / scale) ** 2 + scale.log() + LOG_SQRT_2PI
    return -reduce(add, terms.unbind(-1))


def gaussian_entropy(scale: Tensor) -> Tensor:
    """Σ_j [½ + ½ log 2π + log scale_j], the differential entropy of N(loc, diag(scale²)).

    Args:
        scale: [*batch, n_dims], > 0.

    Returns:
        [*batch] (nats).

    Example:
        >>> import torch
        >>> gaussian_entropy(torch.tensor([1 / math.sqrt(math.tau * math.e)]))
        tensor(0.)
    """
    return reduce(add, (0.5 + LOG_SQRT_2PI + scale.log()).unbind(-1))
