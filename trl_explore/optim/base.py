"""What the trainer needs of an optimiser, and parameters in groups."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Protocol, cast

from torch import Tensor, nn

from trl_explore.checks import check_number

Parameters = Iterable[nn.Parameter] | Iterable[Mapping[str, Any]]
"""Parameters, or groups of them as torch's optimisers take them: {"params": [...], "lr": 1.0}."""


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
        """What the next steps depend on, besides parameters and gradients."""
        ...

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on where ``state_dict`` was taken."""
        ...


def grouped(parameters: Parameters, lr: float) -> list[dict[str, Any]]:
    """The parameters in groups, each with its learning rate: its own, or ``lr``.

    Raises:
        ValueError: if a learning rate is not a positive number.
    """
    entries = list(parameters)
    if not entries or not isinstance(entries[0], Mapping):
        entries = [{"params": entries}]
    groups = [dict(group) for group in cast(list[Mapping[str, Any]], entries)]
    for group in groups:
        params = group["params"]
        group["params"] = [params] if isinstance(params, nn.Parameter) else list(params)
        group["lr"] = check_number("lr", group.get("lr", lr), 0, low_open=True)
    return groups
