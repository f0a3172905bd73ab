"""The weights of every trial along the way."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import nn

from trl_explore.checks import check_integer

Weights = dict[str, NDArray[Any]]


class Snapshots:
    """Copies of the policy's parameters after chosen iterations.

    Args:
        policy: the policy of n trials.
        iterations: after which of them to copy the parameters; 0: before the first update.
        max_iterations: the cap of the trials.

    Raises:
        ValueError: if an iteration is not an integer from 0 to the cap.
    """

    def __init__(self, policy: nn.Module, iterations: Iterable[int], max_iterations: int) -> None:
        self.policy = policy
        name = "an iteration of keep_weights"
        found = {check_integer(name, i, 0, max_iterations) for i in iterations}
        self.iterations = sorted(found)
        self.kept: dict[int, Weights] = {}
        """Iteration -> name of a parameter -> its values [n, ...]."""

    def record(self, iteration: int) -> None:
        """Copy the parameters, if those of this iteration are wanted."""
        if iteration in self.iterations:
            self.kept[iteration] = self._now()

    def after(self, iteration: int) -> Weights:
        """The parameters after an iteration, or after the last one if training ended before."""
        return self.kept.get(iteration) or self._now()

    def _now(self) -> Weights:
        return {k: p.detach().numpy().copy() for k, p in self.policy.named_parameters()}

    def state_dict(self) -> dict[str, Any]:
        """The copies so far, and the iterations that are wanted."""
        return {"kept": self.kept, "iterations": self.iterations}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore a ``state_dict``: training goes on with the iterations with which it began."""
        self.iterations = list(state["iterations"])
        self.kept = {int(i): dict(weights) for i, weights in state["kept"].items()}


def joined(parts: Sequence[Snapshots]) -> Weights | None:
    """The copies of all shards, by "iteration/name" [trials, ...]; None if there are none.

    A trial that stopped earlier has the weights with which it stopped.
    """
    if not parts:
        return None
    found: Weights = {}
    for i in sorted(set.intersection(*(set(part.iterations) for part in parts))):
        rows = [part.after(i) for part in parts]
        found |= {f"{i}/{name}": np.concatenate([row[name] for row in rows]) for name in rows[0]}
    return found
