"""The ratio of the actions up to each reward."""

from __future__ import annotations

import torch
from torch import Tensor

from trl_explore.corrections.base import ImportanceWeights, shares
from trl_explore.episodes import Episodes


class PerDecision(ImportanceWeights):
    """A_t = Σ_{j ≥ t} γ^{j−t} C_j r_j − C_t b_t, with C_j = Π_{k ≤ j} π(a_k|s_k) / μ(a_k|s_k).

    A reward is weighted with the actions that led to it, not with those that came after, whose
    ratios have mean 1. Unbiased exactly where ``Trajectory`` is, with less variance (Precup,
    Sutton & Singh 2000, §3).

    With ``self_normalize`` C_j is divided by its mean over the trial's episodes of the iteration
    at the same step, where an episode that is over counts with its last C; with one episode per
    update C is then 1, and nothing is corrected. ``clip`` bounds C.
    Arguments are those of ``ImportanceWeights``.

    Example:
        >>> PerDecision(self_normalize=True).self_normalize
        True
    """

    def advantage(
        self, episodes: Episodes, baseline: Tensor | float, log_ratio: Tensor | None
    ) -> Tensor:
        """Σ_{j ≥ t} γ^{j−t} C_j r_j − C_t b_t [frames]."""
        assert log_ratio is not None
        log_weight = self._clipped(episodes.cumulated(log_ratio))
        weight = _shares_at_step(episodes, log_weight) if self.self_normalize else log_weight.exp()
        weight = weight.to(episodes.reward.dtype)
        returns = episodes.to_go(weight * episodes.reward)
        return returns - weight * baseline


def _shares_at_step(episodes: Episodes, log_weight: Tensor) -> Tensor:
    """C divided by its mean at every frame's step over the episodes of its trial [frames]."""
    steps = int(episodes.step.max()) + 1
    last = log_weight[episodes.ends].unsqueeze(1)
    grid = last.repeat(1, steps)  # what an episode counts with when it is over
    grid[episodes.index, episodes.step] = log_weight
    group = episodes.owner.unsqueeze(1) * steps + torch.arange(steps, device=grid.device)
    found = shares(grid.reshape(-1), group.reshape(-1), episodes.trials * steps)
    return found.reshape(grid.shape)[episodes.index, episodes.step]
