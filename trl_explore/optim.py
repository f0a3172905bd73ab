"""Optimisers whose lanes never mix: a stopped trial's weights and momentum stay as they were."""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, Protocol

import numba as nb
import numpy as np
import torch
from torch import Tensor, nn
from torch.optim import Adam, Optimizer

from trl_explore.checks import check_number


class TrialOptimizer(Protocol):
    """What the trainer needs: an optimiser over parameters [trials, ...]."""

    parameters: list[nn.Parameter]

    def zero_grad(self) -> None:
        """Forget the gradients."""
        ...

    def step(self, active: Tensor | None = None) -> None:
        """One step of the trials in ``active`` [trials] bool; None moves all of them."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """Everything that decides the next step, beside parameters and gradients."""
        ...

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on where ``state_dict`` was taken."""
        ...


class LaneAdam:
    """Adam (Kingma & Ba 2015, algorithm 1), compiled, over the rows of the active trials only.

    m ← β₁ m + (1 − β₁) g,   v ← β₂ v + (1 − β₂) g²,
    θ ← θ − lr · (m / (1 − β₁^i)) / (√(v / (1 − β₂^i)) + ε),   β₁ = 0.9, β₂ = 0.999, ε = 1e-8

    with i the number of steps, the same for all trials, since they step together until they stop.
    The formula, its order and its defaults are those of ``torch.optim.Adam``, whose fused and
    foreach kernels treat an element according to its place in memory, so that a trial's weights
    would depend, in their last bits, on how many trials stand before it.

    Args:
        parameters: on the CPU, float32 or float64, each with the trials as dimension 0.
        lr: the learning rate, > 0.

    Raises:
        ValueError: if ``lr`` is not a positive number.

    Example:
        >>> weight = nn.Parameter(torch.zeros(2, 1))
        >>> adam = LaneAdam([weight], lr=0.1)
        >>> weight.grad = torch.ones(2, 1)
        >>> adam.step(torch.tensor([True, False]))
        >>> weight.detach()
        tensor([[-0.1000],
                [ 0.0000]])
    """

    beta1, beta2, eps = 0.9, 0.999, 1e-8

    def __init__(self, parameters: Iterable[nn.Parameter], *, lr: float = 0.05) -> None:
        self.lr = check_number("lr", lr, 0, low_open=True)
        self.parameters = list(parameters)
        self.steps = 0
        self.exp_avg = [torch.zeros_like(p, requires_grad=False) for p in self.parameters]
        self.exp_avg_sq = [torch.zeros_like(p, requires_grad=False) for p in self.parameters]

    def zero_grad(self) -> None:
        """Forget the gradients."""
        for parameter in self.parameters:
            parameter.grad = None

    def step(self, active: Tensor | None = None) -> None:
        """One step of the trials in ``active`` [trials] bool; None moves all of them."""
        self.steps += 1
        correction1 = 1 - self.beta1**self.steps
        correction2 = 1 - self.beta2**self.steps
        for p, m, v in zip(self.parameters, self.exp_avg, self.exp_avg_sq, strict=True):
            if p.grad is None:
                continue
            rows = len(p)
            which = np.ones(rows, dtype=np.bool_) if active is None else active.numpy()
            arrays = (t.detach().view(rows, -1).numpy() for t in (p, m, v))
            gradient = p.grad.reshape(rows, -1).numpy()
            _adam(
                which, *arrays, gradient, self.beta1, self.beta2, self.eps,
                self.lr / correction1, correction2**0.5,
            )  # fmt: skip

    def state_dict(self) -> dict[str, Any]:
        """The number of steps and both moments."""
        return {
            "steps": self.steps,
            "exp_avg": [t.clone() for t in self.exp_avg],
            "exp_avg_sq": [t.clone() for t in self.exp_avg_sq],
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on where ``state_dict`` was taken."""
        self.steps = state["steps"]
        for name in ("exp_avg", "exp_avg_sq"):
            for own, saved in zip(getattr(self, name), state[name], strict=True):
                own.copy_(saved)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _adam(active, p, m, v, gradient, beta1, beta2, eps, step_size, correction):
    numbers = np.array([1 - beta1, beta2, 1 - beta2, eps, step_size, correction]).astype(p.dtype)
    gain1, keep2, gain2 = numbers[0], numbers[1], numbers[2]
    small, size, root = numbers[3], numbers[4], numbers[5]
    for row in range(len(p)):
        if active[row]:
            for k in range(p.shape[1]):
                g = gradient[row, k]
                m[row, k] += gain1 * (g - m[row, k])
                v[row, k] = v[row, k] * keep2 + gain2 * g * g
                p[row, k] -= size * m[row, k] / (np.sqrt(v[row, k]) / root + small)


def adam(parameters: Iterable[nn.Parameter], *, lr: float = 0.05) -> Adam:
    """The Adam of torch in the form that treats every element alike, wherever it lies in memory.

    Args:
        parameters: the parameters.
        lr: the learning rate, > 0.

    Raises:
        ValueError: if ``lr`` is not a positive number.
    """
    check_number("lr", lr, 0, low_open=True)
    return Adam(parameters, lr=lr, foreach=False, fused=False)


def torch_adam(parameters: Iterable[nn.Parameter], *, lr: float = 0.05) -> LaneOptimizer:
    """``adam`` over lanes: the reference that ``LaneAdam`` is held against."""
    return LaneOptimizer(partial(adam, lr=lr), parameters)


class LaneOptimizer:
    """Any elementwise torch optimiser over parameters [trials, ...], moving active trials only.

    A gradient of zero does not hold a stopped trial still: momentum would move its weights on. Its
    rows of the parameters and of the optimiser's state are put back as they were.

    Args:
        factory: parameters -> optimiser, such as ``functools.partial(adam, lr=0.05)``.
        parameters: each with the trials as dimension 0.
    """

    def __init__(
        self,
        factory: Callable[[list[nn.Parameter]], Optimizer],
        parameters: Iterable[nn.Parameter],
    ) -> None:
        self.parameters = list(parameters)
        self.optimizer = factory(self.parameters)

    def zero_grad(self) -> None:
        """Forget the gradients."""
        self.optimizer.zero_grad(set_to_none=True)

    @torch.no_grad()
    def step(self, active: Tensor | None = None) -> None:
        """One step of the trials in ``active`` [trials] bool; None moves all of them."""
        if active is None or bool(active.all()):
            self.optimizer.step()
            return
        stopped = (~active).nonzero().squeeze(-1)
        kept = [(rows, rows.index_select(0, stopped)) for rows in self.rows()]
        self.optimizer.step()
        for rows, before in kept:
            rows.index_copy_(0, stopped, before)

    def state_dict(self) -> dict[str, Any]:
        """The state of the torch optimiser."""
        return self.optimizer.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on where ``state_dict`` was taken."""
        self.optimizer.load_state_dict(state)

    def rows(self) -> list[Tensor]:
        """Every tensor with one row per trial: parameters and the state that goes with them."""
        found: list[Tensor] = []
        for parameter in self.parameters:
            state = self.optimizer.state.get(parameter, {}).values()
            same = [v for v in state if isinstance(v, Tensor) and v.shape == parameter.shape]
            found += [parameter.data, *same]
        return found
