"""One linear layer per lane, applied to the frames of all lanes at once."""

from __future__ import annotations

from typing import Any

import numba as nb
import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from trl_explore.threads import check_frames


def lane_linear(x: Tensor, weight: Tensor, trial: Tensor) -> Tensor:
    """y_i = W[trial_i] x_i.

    Args:
        x: [*batch, n_in].
        weight: [trials, n_out, n_in].
        trial: [*batch] int64, the row of ``weight`` that serves each frame.

    Returns:
        [*batch, n_out].

    Raises:
        ValueError: if the shapes do not fit each other.
        IndexError: if a trial is not in [0, trials).

    Example:
        >>> weight = torch.tensor([[[1.0, 2.0]], [[10.0, 20.0]]])
        >>> lane_linear(torch.ones(3, 2), weight, torch.tensor([0, 1, 1])).tolist()
        [[3.0], [30.0], [30.0]]
    """
    check_frames(x.shape[:-1], trial=trial)
    if x.shape[-1] != weight.shape[2]:
        raise ValueError(f"x has {x.shape[-1]} features, but the weights have {weight.shape[2]}")
    compiled = (
        x.device.type == weight.device.type == "cpu"
        and x.dtype == weight.dtype
        and x.dtype in (torch.float32, torch.float64)
        and not x.requires_grad
    )
    if not compiled:
        rows = weight.index_select(0, trial.reshape(-1))
        flat = torch.bmm(rows, x.reshape(-1, x.shape[-1], 1))
        return flat.reshape(*x.shape[:-1], weight.shape[1])
    rows = x.reshape(-1, x.shape[-1]).contiguous(), weight, trial.reshape(-1).contiguous()
    differentiate = torch.is_grad_enabled() and weight.requires_grad
    flat = _LaneLinear.apply(*rows) if differentiate else _apply(*rows)
    return flat.reshape(*x.shape[:-1], weight.shape[1])  # type: ignore[union-attr]


def _apply(x: Tensor, weight: Tensor, trial: Tensor) -> Tensor:
    out = x.new_empty(len(x), weight.shape[1])
    if not _forward(x.numpy(), weight.detach().contiguous().numpy(), trial.numpy(), out.numpy()):
        raise IndexError(f"a trial is not in [0, {len(weight)})")
    return out


class _LaneLinear(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, trial: Tensor) -> Tensor:
        ctx.save_for_backward(x, trial)
        ctx.weight_shape = weight.shape
        return _apply(x, weight, trial)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[None, Tensor, None]:
        x, trial = ctx.saved_tensors
        # Hundreds of terms of one sign: summed in double, they cost no more.
        total = np.zeros(ctx.weight_shape)
        _backward(x.numpy(), grad.contiguous().numpy(), trial.numpy(), total)
        return None, torch.from_numpy(total).to(x.dtype), None


@nb.njit(cache=True, nogil=True)
def _forward(x, weight, trial, out):
    n_out, n_in = weight.shape[1:]
    for i in range(len(x)):
        lane = trial[i]
        if not 0 <= lane < len(weight):
            return False
        for j in range(n_out):
            total = weight[lane, j, 0] * x[i, 0]
            for k in range(1, n_in):
                total += weight[lane, j, k] * x[i, k]
            out[i, j] = total
    return True


@nb.njit(cache=True, nogil=True)
def _backward(x, grad, trial, total):
    n_out, n_in = total.shape[1:]
    for i in range(len(x)):
        lane = trial[i]
        for j in range(n_out):
            g = np.float64(grad[i, j])
            for k in range(n_in):
                total[lane, j, k] += g * x[i, k]
