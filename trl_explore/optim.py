"""Optimisers whose lanes never mix."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import torch
from torch import Tensor, nn
from torch.optim import Adam, Optimizer

from trl_explore.checks import check_number


def adam(parameters: Iterable[nn.Parameter], *, lr: float = 0.05) -> Adam:
    """Adam (Kingma & Ba 2015) in its plain form.

    The fused and the foreach kernels of torch treat an element according to its place in memory,
    so that a trial's weights would depend, in their last bits, on how many trials stand before it.

    Args:
        parameters: the parameters.
        lr: the learning rate, > 0.

    Raises:
        ValueError: if ``lr`` is not a positive number.
    """
    check_number("lr", lr, 0, low_open=True)
    return Adam(parameters, lr=lr, foreach=False, fused=False)


class LaneOptimizer:
    """An elementwise torch optimiser over parameters [trials, ...] that moves active trials only.

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

    def rows(self) -> list[Tensor]:
        """Every tensor with one row per trial: parameters and the state that goes with them."""
        found: list[Tensor] = []
        for parameter in self.parameters:
            state = self.optimizer.state.get(parameter, {}).values()
            same = [v for v in state if isinstance(v, Tensor) and v.shape == parameter.shape]
            found += [parameter.data, *same]
        return found
