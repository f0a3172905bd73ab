"""One affine layer per lane, applied to the frames of all lanes at once."""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from trl_explore.envs.kernels.kernel import kernel_function
from trl_explore.numerics import bell as bell_module
from trl_explore.numerics.bell import ring
from trl_explore.numerics.compiled import compiled
from trl_explore.numerics.threads import by_trial, check_frames, fits

WIDE = 8
"""From so many outputs on, the compiled code takes them side by side, as vectors."""


def lane_linear(x: Tensor, weight: Tensor, trial: Tensor, bias: Tensor | None = None) -> Tensor:
    """y_i = W[trial_i] x_i + b[trial_i].

    Each output is a sum in the order of the inputs, the bias last, whatever stands beside it.
    The gradients ∂/∂W = Σ_i g_i x_iᵀ and ∂/∂b = Σ_i g_i run over the frames of a trial in their
    order, in double; ∂/∂x_i = Wᵀ g_i is a sum in the order of the outputs.

    Args:
        x: [*batch, n_in].
        weight: [trials, n_out, n_in].
        trial: [*batch] int64, the row of ``weight`` that serves each frame.
        bias: [trials, n_out], or None for b = 0.

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
    if bias is not None and bias.shape != weight.shape[:2]:
        raise ValueError(
            f"the bias is {list(bias.shape)}, but the weights are {list(weight.shape)}"
        )
    given = [weight] if bias is None else [weight, bias]
    if not fits(x, *given):
        return plain_lane_linear(x, weight, trial, bias)
    rows = x.reshape(-1, x.shape[-1]).contiguous(), weight, trial.reshape(-1).contiguous(), bias
    differentiate = torch.is_grad_enabled() and any(t.requires_grad for t in (x, *given))
    flat: Any = _LaneLinear.apply(*rows) if differentiate else _apply(*rows)
    return flat.reshape(*x.shape[:-1], weight.shape[1])


def plain_lane_linear(
    x: Tensor, weight: Tensor, trial: Tensor, bias: Tensor | None = None
) -> Tensor:
    """The formula of ``lane_linear`` in torch, for any device and dtype."""
    index = trial.reshape(-1)
    rows = weight.index_select(0, index)
    flat = torch.bmm(rows, x.reshape(-1, x.shape[-1], 1)).squeeze(-1)
    if bias is not None:
        flat = flat + bias.index_select(0, index)
    return flat.reshape(*x.shape[:-1], weight.shape[1])


def _apply(x: Tensor, weight: Tensor, trial: Tensor, bias: Tensor | None) -> Tensor:
    out = x.new_empty(len(x), weight.shape[1])
    frames = x.detach().numpy(), out.numpy(), trial.numpy()
    if not by_trial(_forward, frames, (_array(weight), _bias(weight, bias))):
        raise IndexError(f"a trial is not in [0, {len(weight)})")
    return out


def _array(weight: Tensor) -> NDArray[Any]:
    return weight.detach().contiguous().numpy()


def _bias(weight: Tensor, bias: Tensor | None) -> NDArray[Any]:
    """The bias [trials, n_out]; [trials, 0] stands for none."""
    return _array(weight.new_empty(len(weight), 0) if bias is None else bias)


class _LaneLinear(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, trial: Tensor, bias: Tensor | None) -> Tensor:
        ctx.save_for_backward(x, weight, trial)
        ctx.biased = bias is not None
        return _apply(x, weight, trial, bias)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, Tensor | None, None, Any]:
        x, weight, trial = ctx.saved_tensors
        g, to_x, to_weight, to_bias = grad.contiguous().numpy(), None, None, None
        if ctx.needs_input_grad[0]:
            to_x = torch.empty_like(x)
            by_trial(_backward_x, (g, to_x.numpy(), trial.numpy()), (_array(weight),))
        if ctx.needs_input_grad[1] or ctx.needs_input_grad[3]:
            # Hundreds of terms of one sign: summed in double, they cost no more.
            slope = np.zeros(weight.shape)
            slope0 = np.zeros(weight.shape[:2] if ctx.biased else (len(weight), 0))
            by_trial(_backward, (x.detach().numpy(), g, trial.numpy()), (slope, slope0))
            to_weight = torch.from_numpy(slope).to(x.dtype)
            to_bias = torch.from_numpy(slope0).to(x.dtype) if ctx.biased else None
        return to_x, to_weight, None, to_bias


@compiled(bell_module)
def _forward(x, out, trial, weight, bias, bell):
    ring(bell)
    trials, n_out, n_in = weight.shape
    columns = np.empty((n_in, n_out), dtype=weight.dtype)
    i = 0
    while i < len(x):
        lane = trial[i]
        if not 0 <= lane < trials:
            return False
        end = i + 1
        while end < len(x) and trial[end] == lane:
            end += 1
        if n_out >= WIDE and end > i + 1:
            columns[:] = weight[lane].T
            for f in range(i, end):
                accumulate(columns, x[f], out[f], n_in, n_out)
        else:
            _narrow(x[i:end], weight[lane], out[i:end])
        if bias.shape[1] > 0:
            for f in range(i, end):
                for j in range(n_out):
                    out[f, j] += bias[lane, j]
        i = end
    return True


@kernel_function
def _narrow(x, weight, out):
    """W x for the frames of one lane, output by output."""
    n_out, n_in = weight.shape
    for f in range(len(x)):
        for j in range(n_out):
            total = weight[j, 0] * x[f, 0]
            for k in range(1, n_in):
                total += weight[j, k] * x[f, k]
            out[f, j] = total


@kernel_function
def accumulate(columns, x, out, n_in, n_out):
    """Σ_k columns_k x_k, a sum in the order of k for each of the n_out outputs, side by side."""
    for j in range(n_out):
        out[j] = columns[0, j] * x[0]
    k = 1
    while k + 4 <= n_in:
        x0, x1, x2, x3 = x[k], x[k + 1], x[k + 2], x[k + 3]
        c0, c1, c2, c3 = columns[k], columns[k + 1], columns[k + 2], columns[k + 3]
        for j in range(n_out):
            out[j] = (((out[j] + c0[j] * x0) + c1[j] * x1) + c2[j] * x2) + c3[j] * x3
        k += 4
    while k < n_in:
        x0, c0 = x[k], columns[k]
        for j in range(n_out):
            out[j] += c0[j] * x0
        k += 1


@compiled(bell_module)
def _backward_x(grad, out, trial, weight, bell):
    ring(bell)
    n_out, n_in = weight.shape[1:]
    for i in range(len(grad)):
        lane = trial[i]
        for k in range(n_in):
            out[i, k] = grad[i, 0] * weight[lane, 0, k]
        for j in range(1, n_out):
            g = grad[i, j]
            for k in range(n_in):
                out[i, k] += g * weight[lane, j, k]
    return True


@compiled(bell_module)
def _backward(x, grad, trial, slope, slope0, bell):
    ring(bell)
    n_out, n_in = slope.shape[1:]
    biased = slope0.shape[1] > 0
    for i in range(len(x)):
        lane = trial[i]
        for j in range(n_out):
            g = np.float64(grad[i, j])
            for k in range(n_in):
                slope[lane, j, k] += g * x[i, k]
            if biased:
                slope0[lane, j] += g
    return True
