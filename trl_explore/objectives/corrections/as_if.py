"""The bias of another strategy on purpose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from tensordict import TensorDictBase
from tensordict.nn import ProbabilisticTensorDictSequential
from torch import Tensor
from torchrl.modules import ProbabilisticActor

from trl_explore.objectives.corrections.importance import PerStep
from trl_explore.strategies import BaseStrategy, Strategy


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
