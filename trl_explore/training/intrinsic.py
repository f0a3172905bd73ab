"""An intrinsic reward for what has been tried rarely, kept apart from the score."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import nn

from trl_explore.checks import check_number
from trl_explore.strategies.count_bonus import VisitCounts


class CountReward(nn.Module):
    """Add β / √N(φ(s), a) to the reward of every frame.

    N counts how often the trial has taken the action in the cell φ(s) (``VisitCounts``), this
    iteration included, so that it is at least 1. It is the bonus of MBIE-EB (Strehl & Littman 2008)
    as a reward: an action that leads to something new, even many steps later, has a larger
    return. Only the loss uses it. The score, "episode_reward" and the stopping rule are those of
    the environment.

    Args:
        beta: β >= 0; 0 adds nothing and counts nothing.
        trials: the number of trials.
        n_actions: the number of actions.
        one_hot: whether observations are one-hot states; if not, φ is a hash of 12 bits.
        seed: seed of the job.
        first_trial: trial index of row 0.

    Raises:
        ValueError: if β is out of range.

    Example:
        >>> from tensordict import TensorDict
        >>> frames = TensorDict({"observation": torch.eye(2)[[0, 0, 1]], "trial": [0, 0, 0],
        ...     "action": [1, 1, 0], "next": {"reward": torch.ones(3, 1)}}, 3)
        >>> CountReward(2.0, trials=1, n_actions=2, one_hot=True)(frames)
        >>> frames["next", "reward"].squeeze(-1)
        tensor([2.4142, 2.4142, 3.0000])
    """

    def __init__(
        self,
        beta: float,
        trials: int,
        n_actions: int,
        *,
        one_hot: bool = False,
        seed: int = 0,
        first_trial: int = 0,
    ) -> None:
        super().__init__()
        self.beta = check_number("intrinsic_reward", beta, 0)
        self.n_actions = n_actions
        self.visits = VisitCounts(trials, one_hot=one_hot, seed=seed, first_trial=first_trial)

    @torch.no_grad()
    def forward(self, frames: TensorDictBase) -> None:
        """Count the frames of an iteration, and change their rewards in place."""
        if not self.beta:
            return
        state = frames.get("observation"), frames.get("trial")
        action, reward = frames.get("action"), frames.get(("next", "reward"))
        self.visits.count(state[0], action, state[1], self.n_actions)
        visits = self.visits(*state, self.n_actions).gather(-1, action.unsqueeze(-1))
        reward += self.beta / visits.to(reward.dtype).sqrt()
