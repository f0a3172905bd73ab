"""The log-probability of an action under a softmax."""

from __future__ import annotations

from typing import Any

import numba as nb
import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from trl_explore.numerics.threads import check_frames


def categorical_log_prob(logits: Tensor, action: Tensor) -> Tensor:
    """Log softmax(logits)_action, with gradient 1[k = action] − softmax(logits)_k.

    Args:
        logits: [*batch, n_actions]; −∞ marks an action that cannot be taken.
        action: [*batch], integer indices.

    Returns:
        [*batch] (nats).

    Raises:
        ValueError: if the shapes do not fit each other.
        IndexError: if an action is out of range.

    Example:
        >>> categorical_log_prob(torch.tensor([[0.0, 0.0]]), torch.tensor([1])).exp()
        tensor([0.5000])
    """
    check_frames(logits.shape[:-1], action=action)
    if logits.device.type != "cpu" or logits.dtype not in (torch.float32, torch.float64):
        return logits.log_softmax(-1).gather(-1, action.long().unsqueeze(-1)).squeeze(-1)
    flat: Any = _CategoricalLogProb.apply(
        logits.reshape(-1, logits.shape[-1]).contiguous(), action.reshape(-1).long().contiguous()
    )
    return flat.reshape(action.shape)


class _CategoricalLogProb(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, logits: Tensor, action: Tensor) -> Tensor:
        if action.numel() and not 0 <= int(action.min()) <= int(action.max()) < logits.shape[-1]:
            raise IndexError(f"an action is not in [0, {logits.shape[-1]})")
        probs = torch.empty_like(logits)
        out = logits.new_empty(len(logits))
        _forward(logits.detach().numpy(), action.numpy(), probs.numpy(), out.numpy())
        ctx.save_for_backward(probs, action)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None]:
        probs, action = ctx.saved_tensors
        out = torch.empty_like(probs)
        _backward(probs.numpy(), action.numpy(), grad.contiguous().numpy(), out.numpy())
        return out, None


@nb.njit(cache=True, nogil=True)
def _forward(logits, action, probs, out):
    n = logits.shape[1]
    zero = np.zeros(1, dtype=logits.dtype)[0]
    for i in range(len(logits)):
        largest = logits[i, 0]
        for k in range(1, n):
            largest = max(largest, logits[i, k])
        total = zero
        for k in range(n):
            probs[i, k] = np.exp(logits[i, k] - largest)
            total += probs[i, k]
        for k in range(n):
            probs[i, k] /= total
        out[i] = logits[i, action[i]] - largest - np.log(total)


@nb.njit(cache=True, nogil=True)
def _backward(probs, action, grad, out):
    n = probs.shape[1]
    for i in range(len(probs)):
        for k in range(n):
            out[i, k] = -grad[i] * probs[i, k]
        out[i, action[i]] += grad[i]
