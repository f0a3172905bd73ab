"""Counts of what each trial has tried: N(φ(s), a), the source of bonuses for what is new."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from trl_explore.checks import check_integer
from trl_explore.numerics.layers import lane_linear
from trl_explore.numerics.streams import Stream, generator


class VisitCounts(nn.Module):
    """N(φ(s), a): how often each trial took action a in the cell φ(s).

    φ(s) = s for one-hot states, else the static hash of Tang et al. 2017, "#Exploration", §2.2:
    φ(s) = sgn(A s) ∈ {−1, 1}^bits with A [bits, n_features] of independent N(0, 1), the cell of the
    direction of s. Each trial has its own A and N.

    Args:
        trials: the number of trials.
        bits: length of the hash, 1 to 20.
        one_hot: whether observations are one-hot states.
        seed: seed of the job.
        first_trial: trial index of row 0.

    Raises:
        ValueError: if ``bits`` is out of range.

    Example:
        >>> counts, states = VisitCounts(1, one_hot=True), torch.eye(2)
        >>> trial = torch.zeros(2, dtype=torch.int64)
        >>> counts.count(states, torch.tensor([1, 1]), trial, n_actions=3)
        >>> counts(states, trial, n_actions=3)
        tensor([[0, 1, 0],
                [0, 1, 0]], dtype=torch.int32)
    """

    def __init__(
        self,
        trials: int,
        bits: int = 12,
        *,
        one_hot: bool = False,
        seed: int = 0,
        first_trial: int = 0,
    ) -> None:
        super().__init__()
        self.trials, self.bits = trials, check_integer("bits", bits, 1, 20)
        self.one_hot, self.seed, self.first_trial = one_hot, seed, first_trial
        self.hash = torch.zeros(0)
        self.counts = torch.zeros(0, dtype=torch.int32)
        """N [trials, cells, n_actions]; empty until the sizes are known."""

    def forward(self, observation: Tensor, trial: Tensor, n_actions: int) -> Tensor:
        """N(φ(s), ·) of each frame [*batch, n_actions]."""
        self.reserve(observation.shape[-1], n_actions)
        return self.counts[trial, self._cells(observation, trial)]

    def count(self, observation: Tensor, action: Tensor, trial: Tensor, n_actions: int) -> None:
        """Count the frames, each with its action [*batch] int64."""
        self.reserve(observation.shape[-1], n_actions)
        place = trial, self._cells(observation, trial), action
        ones = torch.ones_like(action, dtype=torch.int32)
        self.counts.index_put_(place, ones, accumulate=True)

    def reserve(self, n_features: int, n_actions: int) -> None:
        """Draw A and allocate N when the sizes are first known."""
        if self.counts.numel():
            return
        cells = n_features if self.one_hot else 1 << self.bits
        self.counts = torch.zeros(self.trials, cells, n_actions, dtype=torch.int32)
        if self.one_hot:
            return
        drawn = [
            generator(self.seed, Stream.STRATEGY, self.first_trial + k).standard_normal(
                (self.bits, n_features), np.float32
            )
            for k in range(self.trials)
        ]
        self.hash = torch.from_numpy(np.stack(drawn))

    def _cells(self, observation: Tensor, trial: Tensor) -> Tensor:
        """φ(s) of each frame [*batch]."""
        if self.one_hot:
            return observation.argmax(-1)
        positive = lane_linear(observation.to(torch.float32), self.hash, trial) > 0
        return (positive * (1 << torch.arange(self.bits))).sum(-1)

    def get_extra_state(self) -> dict[str, Any]:
        """A and N of every trial, for ``state_dict``."""
        return {"hash": self.hash.clone(), "counts": self.counts.clone()}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore the state from ``get_extra_state``."""
        self.hash, self.counts = state["hash"].clone(), state["counts"].clone()
