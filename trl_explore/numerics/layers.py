"""Over the frames of all trials: affine layers with weights per trial, sums, and activations."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from trl_explore.numerics.dispatch import check_frames, compiled, supports

ACTIVATIONS = ("tanh", "relu")


def lane_linear(x: Tensor, weight: Tensor, trial: Tensor, bias: Tensor | None = None) -> Tensor:
    """y_i = W[trial_i] x_i + b[trial_i].

    Each output is a sum in the order of the inputs, with the bias last, so that a frame's result
    does not depend on other frames. The gradients ∂/∂W = Σ_i g_i x_iᵀ and ∂/∂b = Σ_i g_i are sums
    over the frames of a trial in their order, in double; ∂/∂x_i = Wᵀ g_i is a sum in the order of
    the outputs.

    Args:
        x: [*batch, n_in].
        weight: [trials, n_out, n_in].
        trial: [*batch] int64, the row of ``weight`` for each frame.
        bias: [trials, n_out], or None for b = 0.

    Returns:
        [*batch, n_out].

    Raises:
        ValueError: if the shapes do not match.
        IndexError: if a trial is not in [0, trials).

    Example:
        >>> weight = torch.tensor([[[1.0, 2.0]], [[10.0, 20.0]]])
        >>> lane_linear(torch.ones(3, 2), weight, torch.tensor([0, 1, 1])).tolist()
        [[3.0], [30.0], [30.0]]
    """
    check_frames(x.shape[:-1], trial=trial)
    if x.shape[-1] != weight.shape[2]:
        raise ValueError(
            f"x has {x.shape[-1]} features, but the weights have {weight.shape[2]} inputs"
        )
    if bias is not None and bias.shape != weight.shape[:2]:
        raise ValueError(
            f"the bias has shape {list(bias.shape)}, but the weights have {list(weight.shape)}"
        )
    given = [weight] if bias is None else [weight, bias]
    if not supports(x, *given):
        return plain_lane_linear(x, weight, trial, bias)
    rows = x.reshape(-1, x.shape[-1]).contiguous(), weight, trial.reshape(-1).contiguous(), bias
    differentiate = torch.is_grad_enabled() and any(t.requires_grad for t in (x, *given))
    flat: Any = _LaneLinear.apply(*rows) if differentiate else _apply(*rows)
    return flat.reshape(*x.shape[:-1], weight.shape[1])


def plain_lane_linear(
    x: Tensor, weight: Tensor, trial: Tensor, bias: Tensor | None = None
) -> Tensor:
    """``lane_linear`` in torch, for any device and dtype."""
    index = trial.reshape(-1)
    rows = weight.index_select(0, index)
    flat = torch.bmm(rows, x.reshape(-1, x.shape[-1], 1)).squeeze(-1)
    if bias is not None:
        flat = flat + bias.index_select(0, index)
    return flat.reshape(*x.shape[:-1], weight.shape[1])


def _apply(x: Tensor, weight: Tensor, trial: Tensor, bias: Tensor | None) -> Tensor:
    out = x.new_empty(len(x), weight.shape[1])
    columns = x.detach().numpy(), out.numpy(), trial.numpy()
    if not compiled("layers").affine(*columns, _array(weight), _bias(weight, bias)):
        raise IndexError(f"every trial must be in [0, {len(weight)})")
    return out


def _array(weight: Tensor) -> NDArray[Any]:
    return weight.detach().contiguous().numpy()


def _bias(weight: Tensor, bias: Tensor | None) -> NDArray[Any]:
    """The bias [trials, n_out]; [trials, 0] means no bias."""
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
            compiled("layers").affine_to_input(g, to_x.numpy(), trial.numpy(), _array(weight))
        if ctx.needs_input_grad[1] or ctx.needs_input_grad[3]:
            # Hundreds of terms may have the same sign. Summing in double costs nothing extra.
            slope = np.zeros(weight.shape)
            slope0 = np.zeros(weight.shape[:2] if ctx.biased else (len(weight), 0))
            columns = x.detach().numpy(), g, trial.numpy()
            compiled("layers").affine_to_weights(*columns, slope, slope0)
            to_weight = torch.from_numpy(slope).to(x.dtype)
            to_bias = torch.from_numpy(slope0).to(x.dtype) if ctx.biased else None
        return to_x, to_weight, None, to_bias


def lane_sum(values: Tensor, trial: Tensor, trials: int) -> Tensor:
    """S_k = Σ_{i: trial_i = k} values_i, summed in the order of the frames.

    Args:
        values: [frames].
        trial: [frames] int64 in [0, trials).
        trials: the number of sums.

    Returns:
        [trials].

    Example:
        >>> lane_sum(torch.tensor([1.0, 2.0, 3.0]), torch.tensor([0, 0, 2]), 3).tolist()
        [3.0, 0.0, 3.0]
    """
    return values.new_zeros(trials).index_add(0, trial, values)


def activate(x: Tensor, activation: str) -> Tensor:
    """The activation of every element; its derivative is 1 − y² for tanh, 1[y > 0] for relu.

    In float32, tanh is a rational function with an error of at most 6 units in the last place. The
    compiled episode loop calls the same function, so that both give the same bits.

    Args:
        x: [...].
        activation: "tanh" or "relu".

    Returns:
        y [...].

    Raises:
        ValueError: if the activation is unknown.

    Example:
        >>> activate(torch.tensor([-1.0, 2.0]), "relu").tolist()
        [0.0, 2.0]
    """
    check_activation(activation)
    if activation == "relu":
        return torch.relu(x)
    if x.dtype != torch.float32 or not supports(x):
        return torch.tanh(x)
    flat = x.reshape(-1).contiguous()
    out: Any = _Tanh.apply(flat) if torch.is_grad_enabled() and x.requires_grad else _tanh(flat)
    return out.reshape(x.shape)


def check_activation(activation: str) -> str:
    """Return ``activation`` if it is known.

    Raises:
        ValueError: if it is unknown.
    """
    if activation not in ACTIVATIONS:
        raise ValueError(f"activation must be {' or '.join(ACTIVATIONS)}, got {activation!r}")
    return activation


def _tanh(x: Tensor) -> Tensor:
    y = torch.empty_like(x)
    compiled("layers").tanh(x.detach().numpy(), y.numpy())
    return y


class _Tanh(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        y = _tanh(x)
        ctx.save_for_backward(y)
        return y

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> Tensor:
        (y,) = ctx.saved_tensors
        out = torch.empty_like(y)
        compiled("layers").tanh_backward(y.numpy(), grad.contiguous().numpy(), out.numpy())
        return out
