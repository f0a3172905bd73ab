"""The ratio of every single action."""

from __future__ import annotations

from torch import Tensor

from trl_explore.corrections.base import ImportanceWeights, shares
from trl_explore.episodes import Episodes


class PerStep(ImportanceWeights):
    """A_t = ρ_t · (G_t − b_t), with ρ_t = π(a_t|s_t) / μ(a_t|s_t).

    Corrects which action was taken in s_t. What it leaves as it is: the states, which are those
    that μ visits, and the rewards behind a_t, which are those of μ. So the expected gradient is
    Σ_s d_μ(s) Σ_a ∇π(a|s) Q_μ(s, a) (Degris, White & Sutton 2012, "Off-policy actor-critic",
    eq. 5, with Q_μ in the place of Q_π). It points uphill for π wherever Q_μ and Q_π order the
    actions alike. Exactly unbiased where μ = π, and for episodes of one step.

    With ``self_normalize`` ρ_t is divided by its mean over the trial's frames.
    Arguments are those of ``ImportanceWeights``.

    Example:
        >>> PerStep(clip=2.0).clip
        2.0
    """

    def advantage(
        self, episodes: Episodes, baseline: Tensor | float, log_ratio: Tensor | None
    ) -> Tensor:
        """ρ_t · (G_t − b_t) [frames]."""
        assert log_ratio is not None
        log_weight = self._clipped(log_ratio)
        if self.self_normalize:
            weight = shares(log_weight, episodes.trial, episodes.trials)
        else:
            weight = log_weight.exp()
        returns = episodes.returns
        return weight.to(returns.dtype) * (returns - baseline)
