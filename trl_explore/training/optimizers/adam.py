"""Compiled Adam over parameters with the trials as dimension 0."""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from trl_explore.checks import check_number
from trl_explore.numerics.compiled.cache import compiled
from trl_explore.training.optimizers.optimizer import Parameters, Views, grouped


class LaneAdam:
    """Compiled Adam (Kingma & Ba 2015, algorithm 1) that updates the active trials only.

    m ← β₁ m + (1 − β₁) g,   v ← β₂ v + (1 − β₂) g²,
    θ ← θ − lr · (m / (1 − β₁^i)) / (√(v / (1 − β₂^i)) + ε),   β₁ = 0.9, β₂ = 0.999, ε = 1e-8

    with i the number of steps, the same for all trials because they step together until they stop.
    Formula, order of operations and defaults are those of ``torch.optim.Adam``. Its fused and
    foreach kernels are not used: they round an element according to its place in memory, so that
    the last bits of a trial's weights would depend on the number of trials before it.

    Args:
        parameters: on the CPU, float32 or float64, each with the trials as dimension 0; or groups
            of them with separate learning rates: ``[{"params": [...], "lr": 1.0}, ...]``.
        lr: the learning rate of groups that have none, > 0.

    Raises:
        ValueError: if a learning rate is not a positive number, or a group has other options.

    Example:
        >>> weight = torch.nn.Parameter(torch.zeros(2, 1))
        >>> adam = LaneAdam([weight], lr=0.1)
        >>> weight.grad = torch.ones(2, 1)
        >>> adam.step(torch.tensor([True, False]))
        >>> weight.detach()
        tensor([[-0.1000],
                [ 0.0000]])
    """

    beta1, beta2, eps = 0.9, 0.999, 1e-8

    def __init__(self, parameters: Parameters, *, lr: float = 0.05) -> None:
        self.lr = check_number("lr", lr, 0, low_open=True)
        groups = grouped(parameters, self.lr)
        for name in sorted({name for group in groups for name in group} - {"params", "lr"}):
            raise ValueError(f"a parameter group may have 'params' and 'lr' only, got {name!r}")
        self.parameters = [p for group in groups for p in group["params"]]
        self.rates = [group["lr"] for group in groups for _ in group["params"]]
        self.steps = 0
        self.exp_avg = [torch.zeros_like(p, requires_grad=False) for p in self.parameters]
        self.exp_avg_sq = [torch.zeros_like(p, requires_grad=False) for p in self.parameters]
        self._views = Views([])

    def zero_grad(self) -> None:
        """Discard the gradients."""
        for parameter in self.parameters:
            parameter.grad = None

    def step(self, active: Tensor | None = None) -> None:
        """Update the trials in ``active`` [trials] bool; None means all.

        Raises:
            ValueError: if the length of ``active`` is not the number of trials.
        """
        which = None if active is None else active.numpy()
        if which is not None:
            for parameter in self.parameters:
                if len(which) != len(parameter):
                    trials = len(parameter)
                    raise ValueError(
                        f"active has shape [{len(which)}], but there are {trials} trials"
                    )
        self.steps += 1
        correction1 = 1 - self.beta1**self.steps
        correction2 = 1 - self.beta2**self.steps
        self._views.tensors = [*self.parameters, *self.exp_avg, *self.exp_avg_sq]
        arrays, n = self._views(), len(self.parameters)
        parts = zip(
            self.parameters, self.rates, arrays[:n], arrays[n : 2 * n], arrays[2 * n :], strict=True
        )
        for parameter, lr, p, m, v in parts:
            if parameter.grad is None:
                continue
            rows = np.ones(len(p), dtype=np.bool_) if which is None else which
            gradient = np.ascontiguousarray(parameter.grad.numpy()).reshape(p.shape)
            _adam(
                rows, p, m, v, gradient, self.beta1, self.beta2, self.eps,
                lr / correction1, correction2**0.5,
            )  # fmt: skip

    def state_dict(self) -> dict[str, Any]:
        """The number of steps and both moments."""
        return {
            "steps": self.steps,
            "exp_avg": {str(i): t.clone() for i, t in enumerate(self.exp_avg)},
            "exp_avg_sq": {str(i): t.clone() for i, t in enumerate(self.exp_avg_sq)},
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore a ``state_dict``."""
        self.steps = state["steps"]
        for name in ("exp_avg", "exp_avg_sq"):
            for i, own in enumerate(getattr(self, name)):
                own.copy_(state[name][str(i)])


@compiled()
def _adam(active, p, m, v, gradient, beta1, beta2, eps, step_size, correction):
    """One step of the active rows; twin: ``torch.optim.Adam``."""
    numbers = np.array([1 - beta1, beta2, 1 - beta2, eps, step_size, correction]).astype(p.dtype)
    p, m, v, gradient = p.reshape(-1), m.reshape(-1), v.reshape(-1), gradient.reshape(-1)
    size_of_row = len(p) // len(active)
    row = 0
    while row < len(active):
        end = row
        while end < len(active) and active[end]:
            end += 1
        low, high = row * size_of_row, end * size_of_row
        _advance(p[low:high], m[low:high], v[low:high], gradient[low:high], numbers)
        row = end + 1


@compiled()
def _advance(p, m, v, gradient, numbers):
    """One step of adjacent rows."""
    gain1, keep2, gain2 = numbers[0], numbers[1], numbers[2]
    small, size, root = numbers[3], numbers[4], numbers[5]
    for i in range(len(p)):
        g = gradient[i]
        m[i] += gain1 * (g - m[i])
        v[i] = v[i] * keep2 + gain2 * g * g
        p[i] -= size * m[i] / (np.sqrt(v[i]) / root + small)
