"""The mean of the other episodes of the same iteration."""

from __future__ import annotations

from torch import Tensor

from trl_explore.objectives.baselines.baseline import Baseline
from trl_explore.objectives.episodes import Episodes


class LeaveOneOut(Baseline):
    """b_t = mean of G_t over the other episodes of the trial in the same iteration, at step t.

    An episode that ends before t counts as G_t = 0. Unbiased: the other episodes are independent of
    the action (Kool, van Hoof & Welling 2019, "Buy 4 REINFORCE samples, get a
    baseline for free!", eq. 8, here for every step). Needs at least two episodes per update.

    Raises:
        ValueError: when called, if a trial has a single episode.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> reward, done = torch.tensor([4.0, 2.0]), torch.tensor([True, True])
        >>> two = Episodes(TensorDict({}, [2]), reward, done, torch.zeros(2).long(), 1, 1.0)
        >>> LeaveOneOut()(two)
        tensor([2., 4.])
    """

    def forward(self, episodes: Episodes) -> Tensor:
        """The mean return of the other episodes at the frame's step [frames]."""
        if not len(episodes):
            return episodes.reward
        count = episodes.episodes_of_trial[episodes.trial]
        if bool((count < 2).any()):
            raise ValueError(
                "baseline leave_one_out needs at least two episodes of every trial in the data: "
                "episodes_per_update >= 2"
            )
        steps = int(episodes.step.max()) + 1
        returns = episodes.returns
        grid = returns.new_zeros(len(episodes.owner), steps)
        grid[episodes.index, episodes.step] = returns
        total = returns.new_zeros(episodes.trials, steps).index_add_(0, episodes.owner, grid)
        others = total[episodes.trial, episodes.step] - returns
        return others / (count - 1).to(returns.dtype)
