"""Any elementwise optimiser of torch over lanes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.optim import Optimizer

from trl_explore.optim.base import Parameters


class LaneOptimizer:
    """Any elementwise torch optimiser over parameters [trials, ...], moving active trials only.

    A gradient of zero does not hold a stopped trial still: momentum would move its weights on. Its
    rows of the parameters and of the optimiser's state are put back as they were.

    Args:
        factory: parameters -> optimiser, such as ``functools.partial(adam, lr=0.05)``.
        parameters: each with the trials as dimension 0; or groups of them, as torch takes them.
    """

    def __init__(
        self,
        factory: Callable[[Any], Optimizer],
        parameters: Parameters,
    ) -> None:
        self.optimizer = factory(list(parameters))
        self.parameters = [p for group in self.optimizer.param_groups for p in group["params"]]

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

    def state_dict(self) -> dict[str, Any]:
        """The state of every parameter, by its place among the parameters."""
        return {
            str(i): {
                name: value.clone() if isinstance(value, Tensor) else value
                for name, value in self.optimizer.state.get(parameter, {}).items()
                if value is not None
            }
            for i, parameter in enumerate(self.parameters)
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on where ``state_dict`` was taken."""
        for i, parameter in enumerate(self.parameters):
            self.optimizer.state[parameter] = {
                name: value.clone() if isinstance(value, Tensor) else value
                for name, value in state[str(i)].items()
            }
