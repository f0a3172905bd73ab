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
        n_actions: the number of actions; 0: not known yet.
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

    counts: Tensor
    """N [trials, cells, n_actions]; empty until the sizes are known."""

    def __init__(
        self,
        trials: int,
        bits: int = 12,
        *,
        n_actions: int = 0,
        one_hot: bool = False,
        seed: int = 0,
        first_trial: int = 0,
    ) -> None:
        super().__init__()
        self.trials, self.bits = trials, check_integer("bits", bits, 1, 20)
        self.one_hot, self.seed, self.first_trial = one_hot, seed, first_trial
        self.hash = torch.zeros(0, 0, 0)
        cells = 0 if one_hot else 1 << self.bits
        counts = torch.zeros(trials, cells, n_actions, dtype=torch.int32)
        self.register_buffer("counts", counts)

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
        if not self.counts.numel():
            shape = (self.trials, n_features if self.one_hot else 1 << self.bits, n_actions)
            self.counts = torch.zeros(shape, dtype=torch.int32, device=self.counts.device)
        if not self.one_hot and self.hash.shape[-1] != n_features:
            streams = self.seed, self.first_trial, self.trials
            self.hash = _projections(*streams, self.bits, n_features).to(self.counts.device)

    def _cells(self, observation: Tensor, trial: Tensor) -> Tensor:
        """φ(s) of each frame [*batch]."""
        if self.one_hot:
            return observation.argmax(-1)
        linear = plain_lane_linear if torch.compiler.is_compiling() else lane_linear
        hash_ = self.hash.to(observation.device)
        positive = linear(observation.to(torch.float32), hash_, trial) > 0
        return (positive * (1 << torch.arange(self.bits, device=positive.device))).sum(-1)

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *rest: Any) -> None:
        saved = state_dict.get(f"{prefix}counts")
        if saved is not None and len(saved) == self.trials:
            self.counts = torch.zeros_like(saved, device=self.counts.device)
        super()._load_from_state_dict(state_dict, prefix, *rest)


@torch._dynamo.assume_constant_result
def _projections(seed: int, first_trial: int, trials: int, bits: int, n_features: int) -> Tensor:
    """A of every trial [trials, bits, n_features]."""
    drawn = [
        generator(seed, Stream.STRATEGY, first_trial + k).standard_normal(
            (bits, n_features), np.float32
        )
        for k in range(trials)
    ]
    return torch.from_numpy(np.stack(drawn))
