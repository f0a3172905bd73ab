"""The ratio of whole episodes."""

from __future__ import annotations

from torch import Tensor

from trl_explore.corrections.base import ImportanceWeights, shares
from trl_explore.episodes import Episodes


class Trajectory(ImportanceWeights):
    """A_t = W · (G_t − b_t), with W = Π_j π(a_j|s_j) / μ(a_j|s_j) over the whole episode.

    Unbiased for the gradient of π's return (at γ = 1, or with the factor γ^t) for every strategy
    with μ > 0 wherever π > 0: ε-greedy, softmax at any temperature, and any mixture with a share
    of the uniform or softmax corner; not for argmax (Precup, Sutton & Singh 2000, "Eligibility
    traces for off-policy policy evaluation", §2; Sutton & Barto, §5.5). Its variance grows
    exponentially with the length of the episode.

    With ``self_normalize`` W is divided by its mean over the trial's episodes of the iteration;
    with one episode per update W is then 1, and nothing is corrected. ``clip`` bounds W.
    Arguments are those of ``ImportanceWeights``.

    Example:
        >>> Trajectory().clip is None
        True
    """

    def advantage(
        self, episodes: Episodes, baseline: Tensor | float, log_ratio: Tensor | None
    ) -> Tensor:
        """W · (G_t − b_t) [frames]."""
        assert log_ratio is not None
        log_weight = self._clipped(episodes.by_episode(log_ratio))
        if self.self_normalize:
            weight = shares(log_weight, episodes.owner, episodes.trials)
        else:
            weight = log_weight.exp()
        returns = episodes.returns
        return weight.to(returns.dtype)[episodes.index] * (returns - baseline)
