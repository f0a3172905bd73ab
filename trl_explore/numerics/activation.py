"""Activations, element by element: the same bits wherever an element lies in memory."""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

import math
from typing import Any

import numba as nb
import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from trl_explore.envs.kernels.kernel import kernel_function
from trl_explore.numerics.threads import fits

ACTIVATIONS = ("tanh", "relu")

# tanh x ≈ x P(x²) / Q(x²) on [−LIMIT, LIMIT]: the coefficients of Eigen's float32 function
# (MathFunctionsImpl.h, ptanh_float), in whose arithmetic 16 elements are one vector instruction.
LIMIT = np.float32(7.90531110763549805)
P0, P1, P2, P3, P4, P5, P6 = map(
    np.float32,
    (
        *(4.89352455891786e-03, 6.37261928875436e-04, 1.48572235717979e-05),
        *(5.12229709037114e-08, -8.60467152213735e-11, 2.00018790482477e-13),
        -2.76076847742355e-16,
    ),
)
Q0, Q1, Q2, Q3 = map(
    np.float32,
    (4.89352518554385e-03, 2.26843463243900e-03, 1.18534705686654e-04, 1.19825839466702e-06),
)


def activate(x: Tensor, activation: str) -> Tensor:
    """The activation of every element; its derivative is 1 − y² for tanh, 1[y > 0] for relu.

    In float32, tanh is a rational function, within 6 units in the last place: the compiled episode
    loop calls the same one, so that both give the same bits.

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
    if not fits(x):
        return torch.tanh(x) if activation == "tanh" else torch.relu(x)
    flat = x.reshape(-1).contiguous()
    if torch.is_grad_enabled() and x.requires_grad:
        out: Any = _Activate.apply(flat, activation)
        return out.reshape(x.shape)
    return _apply(flat, activation).reshape(x.shape)


def check_activation(activation: str) -> str:
    """``activation`` itself.

    Raises:
        ValueError: if it is unknown.
    """
    if activation not in ACTIVATIONS:
        raise ValueError(f"activation must be {' or '.join(ACTIVATIONS)}, got {activation!r}")
    return activation


def _apply(x: Tensor, activation: str) -> Tensor:
    y = torch.empty_like(x)
    single = _tanh_single if x.dtype == torch.float32 else _tanh_double
    (single if activation == "tanh" else _relu)(x.detach().numpy(), y.numpy())
    return y


class _Activate(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, activation: str) -> Tensor:
        y = _apply(x, activation)
        ctx.save_for_backward(y)
        ctx.activation = activation
        return y

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None]:
        (y,) = ctx.saved_tensors
        out = torch.empty_like(y)
        slope = _tanh_backward if ctx.activation == "tanh" else _relu_backward
        slope(y.numpy(), grad.contiguous().numpy(), out.numpy())
        return out, None


@kernel_function
def tanh32(x):
    """Tanh of a float32; NaN stays NaN."""
    x = -LIMIT if x < -LIMIT else x
    x = LIMIT if x > LIMIT else x
    s = x * x
    p = x * (P0 + s * (P1 + s * (P2 + s * (P3 + s * (P4 + s * (P5 + s * P6))))))
    return p / (Q0 + s * (Q1 + s * (Q2 + s * Q3)))


@kernel_function
def relu32(x):
    """The larger of a float32 and 0; NaN stays NaN."""
    return np.float32(0) if x < 0 else x


@nb.njit(nogil=True, cache=True, error_model="numpy")
def _tanh_single(x, y):
    for i in range(len(x)):
        y[i] = tanh32(x[i])


@nb.njit(nogil=True, cache=True)
def _tanh_double(x, y):
    for i in range(len(x)):
        y[i] = math.tanh(x[i])


@nb.njit(nogil=True, cache=True)
def _relu(x, y):
    zero = np.zeros(1, x.dtype)[0]
    for i in range(len(x)):
        y[i] = zero if x[i] < 0 else x[i]


@nb.njit(nogil=True, cache=True)
def _tanh_backward(y, grad, out):
    one = np.ones(1, y.dtype)[0]
    for i in range(len(y)):
        out[i] = grad[i] * (one - y[i] * y[i])


@nb.njit(nogil=True, cache=True)
def _relu_backward(y, grad, out):
    zero = np.zeros(1, y.dtype)[0]
    for i in range(len(y)):
        out[i] = grad[i] if y[i] > 0 else zero
