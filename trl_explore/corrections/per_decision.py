"""The ratio of the actions up to each reward."""

from __future__ import annotations

import torch
from torch import Tensor

from trl_explore.corrections.base import ImportanceWeights
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
        weight = self._clipped(episodes.cumulated(log_ratio))
        if self.self_normalize:
            weight = weight / _mean_at_step(episodes, weight)
        weight = weight.to(episodes.reward.dtype)
        returns = episodes.to_go(weight * episodes.reward)
        return returns - weight * baseline


def _mean_at_step(episodes: Episodes, weight: Tensor) -> Tensor:
    """The mean of C at every frame's step over the episodes of its trial [frames]."""
    steps = int(episodes.step.max()) + 1
    grid = weight.new_zeros(len(episodes.owner), steps)
    grid[episodes.index, episodes.step] = weight
    over = torch.arange(steps, device=weight.device) > episodes.step[episodes.ends].unsqueeze(1)
    grid = torch.where(over, weight[episodes.ends].unsqueeze(1), grid)
    total = weight.new_zeros(episodes.trials, steps).index_add_(0, episodes.owner, grid)
    mean = total / episodes.episodes_of_trial.clamp(min=1).unsqueeze(1)
    return mean[episodes.trial, episodes.step]
