"""Importance weights: per step, per decision, per trajectory, and towards another strategy."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from tensordict.nn import ProbabilisticTensorDictSequential
from torch import Tensor
from torchrl.modules import ProbabilisticActor

from trl_explore.objectives.corrections.correction import ImportanceWeights, shares
from trl_explore.objectives.episodes import Episodes
from trl_explore.strategies import BaseStrategy, Strategy


class PerStep(ImportanceWeights):
    """A_t = ρ_t · (G_t − b_t), with ρ_t = π(a_t|s_t) / μ(a_t|s_t).

    Corrects the action taken in s_t, but not the state distribution or the rewards after a_t, which
    are those of μ. So the expected gradient is Σ_s d_μ(s) Σ_a ∇π(a|s) Q_μ(s, a) (Degris, White &
    Sutton 2012, "Off-policy actor-critic", eq. 5, with Q_μ in place of Q_π). It is an ascent
    direction for π if Q_μ and Q_π rank the actions alike. Exactly unbiased if μ = π, and for
    episodes of one step.

    With ``self_normalize``, ρ_t is divided by its mean over the trial's frames.
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
        weight = self._weights(log_ratio, episodes.trial, episodes.trials)
        returns = episodes.returns
        return weight.to(returns.dtype) * (returns - baseline)


class PerDecision(ImportanceWeights):
    """A_t = Σ_{j ≥ t} γ^{j−t} C_j r_j − C_t b_t, with C_j = Π_{k ≤ j} π(a_k|s_k) / μ(a_k|s_k).

    Each reward is weighted by the ratios of the actions before it, not of those after it, whose
    ratios have mean 1. Unbiased under the same conditions as ``Trajectory``, with less variance
    (Precup, Sutton & Singh 2000, §3).

    With ``self_normalize``, C_j is divided by its mean over the trial's episodes of the iteration
    at the same step, where an ended episode counts with its last C. With one episode per update, C
    is then 1 and nothing is corrected. ``clip`` bounds C.
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
    """C divided by its mean over the trial's episodes at the frame's step [frames]."""
    steps = int(episodes.step.max()) + 1
    last = log_weight[episodes.ends].unsqueeze(1)
    grid = last.repeat(1, steps)  # an ended episode keeps its last value
    grid[episodes.index, episodes.step] = log_weight
    group = episodes.owner.unsqueeze(1) * steps + torch.arange(steps, device=grid.device)
    found = shares(grid.reshape(-1), group.reshape(-1), episodes.trials * steps)
    return found.reshape(grid.shape)[episodes.index, episodes.step]


class Trajectory(ImportanceWeights):
    """A_t = W · (G_t − b_t), with W = Π_j π(a_j|s_j) / μ(a_j|s_j) over the whole episode.

    Unbiased for the gradient of π's return (at γ = 1, or with the factor γ^t) for every strategy
    with μ > 0 wherever π > 0: ε-greedy, softmax at any temperature, and any mixture with a share of
    uniform or softmax; not for argmax (Precup, Sutton & Singh 2000, "Eligibility traces for
    off-policy policy evaluation", §2; Sutton & Barto, §5.5). The variance grows exponentially with
    the length of the episode.

    With ``self_normalize``, W is divided by its mean over the trial's episodes of the iteration.
    With one episode per update, W is then 1 and nothing is corrected. ``clip`` bounds W.
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
        log_weight = episodes.by_episode(log_ratio)
        weight = self._weights(log_weight, episodes.owner, episodes.trials)
        returns = episodes.returns
        return weight.to(returns.dtype)[episodes.index] * (returns - baseline)


class AsIf(PerStep):
    """A_t = w_t · (G_t − b_t), with w_t = μ'(a_t|s_t) / μ(a_t|s_t) and μ' another strategy's.

    The agent acts by μ and learns with the bias of an uncorrected agent that acts by μ'. In every
    state, the expected term of the gradient is that of the other agent:

        E_{a ~ μ}[w · ∇log π(a|s) Q(s, a)] = Σ_a μ'(a|s) ∇log π(a|s) Q(s, a)

    The states, and the rewards after an action, remain those of μ. So the action that the gradient
    assumes can be changed without the data: with μ = softmax and μ' = ε-greedy, the data are
    on-policy and only the gradient has the bias of ε-greedy. μ' = π gives ``PerStep``, and μ' = μ
    no correction, up to rounding. The weights need μ(a|s) > 0 wherever μ'(a|s) > 0.

    Args:
        strategy: gives μ' for the logits of the target policy. It is in the same iteration of its
            schedules as the strategy that collects the data; without one, the caller advances it.

    Raises:
        ValueError: if μ' is not a function of logits and iteration alone, with exact probabilities
            of discrete actions.

    Example:
        >>> from trl_explore.strategies import EpsilonGreedy, VDBE
        >>> AsIf(EpsilonGreedy(0.3)).needs_log_prob
        True
        >>> AsIf(VDBE())
        Traceback (most recent call last):
        ...
        ValueError: AsIf needs a strategy whose probabilities follow from logits and iteration \
alone; VDBE's do not
    """

    def __init__(self, strategy: Strategy) -> None:
        super().__init__()
        name = type(strategy).__name__
        if not isinstance(strategy, Strategy):
            raise ValueError(f"{type(self).__name__} needs a strategy over discrete actions, "
                             f"got {name}")  # fmt: skip
        if not strategy.exact or strategy.learns_from_data or strategy.per_episode:
            raise ValueError(
                f"{type(self).__name__} needs a strategy whose probabilities follow from logits "
                f"and iteration alone; {name}'s do not"
            )
        self.strategy = strategy
        self._acting: BaseStrategy | None = None

    def actor(
        self, actor: ProbabilisticActor, strategy: BaseStrategy | None = None
    ) -> ProbabilisticActor:
        """π, if the strategy has exact probabilities of discrete actions."""
        if strategy is not None and not isinstance(strategy, Strategy):
            raise ValueError(
                f"{type(self).__name__} needs discrete actions; {type(strategy).__name__} draws "
                "continuous ones"
            )
        self._acting = strategy
        return super().actor(actor, strategy)

    def take(self, rows: slice, trials: int) -> None:
        """Keep only some of the trials in the parameters of μ'."""
        self.strategy.take(rows, trials)

    def on_policy(self, strategy: BaseStrategy) -> bool | NDArray[np.bool_]:
        """Whether μ' = μ = π by construction."""
        return np.logical_and(strategy.on_policy(), self._present().on_policy())

    def log_numerator(
        self, actor: ProbabilisticTensorDictSequential, frames: TensorDictBase, action: Tensor
    ) -> Tensor:
        """Log μ'(a|s) of every frame [frames]."""
        return self._present().log_prob(actor[0](frames.copy()), action)

    def _present(self) -> Strategy:
        """The strategy of μ', in the iteration of the strategy that collects the data."""
        if self._acting is not None:
            self.strategy.keep_pace(self._acting)
        return self.strategy
