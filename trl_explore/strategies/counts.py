"""Counts of what each trial has tried: N(φ(s), a), the source of bonuses for what is new."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from trl_explore.checks import check_integer
from trl_explore.numerics.layers import lane_linear, plain_lane_linear
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
        n_actions: the number of actions; 0: taken from the first data.
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

    counts: Tensor
    """N [trials, cells, n_actions] int32; empty until the sizes are known."""

    def __init__(
        self,
        trials: int,
        bits: int = 12,
        *,
        one_hot: bool = False,
        n_actions: int = 0,
        seed: int = 0,
        first_trial: int = 0,
    ) -> None:
        super().__init__()
        self.trials, self.bits = trials, check_integer("bits", bits, 1, 20)
        self.one_hot, self.seed, self.first_trial = one_hot, seed, first_trial
        self._hash = torch.zeros(0, 0, 0)
        self._allocate(0 if one_hot else 1 << bits, n_actions)

    def forward(self, observation: Tensor, trial: Tensor | None, n_actions: int) -> Tensor:
        """N(φ(s), ·) of each frame [*batch, n_actions]; without a trial, those of row 0."""
        self.reserve(observation.shape[-1], n_actions)
        return self.counts[self._cells(observation, trial)]

    def count(
        self, observation: Tensor, action: Tensor, trial: Tensor | None, n_actions: int
    ) -> None:
        """Count the frames, each with its action [*batch] int64."""
        self.reserve(observation.shape[-1], n_actions)
        ones = torch.ones_like(action, dtype=torch.int32)
        self.counts.index_put_((*self._cells(observation, trial), action), ones, accumulate=True)

    def reserve(self, n_features: int, n_actions: int) -> None:
        """Allocate N when the sizes are first known."""
        cells = n_features if self.one_hot else 1 << self.bits
        if self.counts.shape[1:] != (cells, n_actions):
            self._allocate(cells, n_actions)

    def _allocate(self, cells: int, n_actions: int) -> None:
        device = self.counts.device if hasattr(self, "counts") else None
        counts = torch.zeros(self.trials, cells, n_actions, dtype=torch.int32, device=device)
        self.register_buffer("counts", counts)

    def _cells(self, observation: Tensor, trial: Tensor | None) -> tuple[Tensor, Tensor]:
        """The trial and the cell φ(s) of each frame, both [*batch]."""
        place: Any = {"dtype": torch.int64, "device": observation.device}
        batch = observation.shape[:-1]
        if trial is None:
            trial = torch.zeros((), **place)
        trial = trial.reshape(trial.shape + (1,) * (len(batch) - trial.ndim)).expand(batch)
        if self.one_hot:
            return trial, observation.argmax(-1)
        if self._hash.shape[-1] != observation.shape[-1]:
            streams = self.trials, self.seed, self.first_trial
            self._hash = _projections(*streams, self.bits, observation.shape[-1])
        self._hash = self._hash.to(observation.device)
        linear = plain_lane_linear if torch.compiler.is_compiling() else lane_linear
        positive = linear(observation.to(torch.float32), self._hash, trial) > 0
        return trial, (positive * (1 << torch.arange(self.bits, **place))).sum(-1)

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *rest: Any) -> None:
        saved = state_dict.get(f"{prefix}counts")
        if saved is not None and len(saved) == self.trials:
            self._allocate(*saved.shape[1:])
        super()._load_from_state_dict(state_dict, prefix, *rest)


@torch._dynamo.assume_constant_result
def _projections(trials: int, seed: int, first_trial: int, bits: int, n_features: int) -> Tensor:
    """A of every trial [trials, bits, n_features]."""
    drawn = [
        generator(seed, Stream.STRATEGY, first_trial + k).standard_normal(
            (bits, n_features), np.float32
        )
        for k in range(trials)
    ]
    return torch.from_numpy(np.stack(drawn))
