"""The uncorrected advantage, and the base class of importance weights."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from tensordict.nn import ProbabilisticTensorDictSequential
from torch import Tensor
from torchrl.modules import ProbabilisticActor

from trl_explore.checks import check_flag, check_number, withdraw
from trl_explore.numerics.layers import lane_sum
from trl_explore.objectives.episodes import Episodes
from trl_explore.policies.actor import frame_log_prob
from trl_explore.strategies import BaseStrategy


class NoCorrection:
    """A_t = G_t − b_t: the data are treated as if they came from π (the thesis).

    The gradient Σ_t A_t ∇log π(a_t|s_t) is unbiased only if μ = π. Under ε-greedy, argmax or a
    temperature other than 1, it is the gradient of neither π's return nor μ's.

    Example:
        >>> NoCorrection().needs_log_prob
        False
    """

    needs_log_prob: ClassVar[bool] = False
    """Whether the correction needs log μ(a|s), in "action_log_prob"."""
    leaves_returns: ClassVar[bool] = True
    """Whether ``advantage`` is exactly G_t − b_t. False in a class that overrides it, unless the
    class declares it."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        withdraw(cls, "leaves_returns", False, ["advantage"])

    def actor(
        self, actor: ProbabilisticActor, strategy: BaseStrategy | None = None
    ) -> ProbabilisticActor:
        """The distribution whose score function the loss uses: π, or its replacement.

        Raises:
            ValueError: if the correction does not support this strategy.
        """
        return actor

    def take(self, rows: slice, trials: int) -> None:
        """Keep only some of the trials in per-trial parameters; the arguments are a strategy's."""

    def on_policy(self, strategy: BaseStrategy) -> bool | NDArray[np.bool_]:
        """Whether every ratio is now 1 by construction; one value, or one per trial."""
        return strategy.on_policy()

    def log_numerator(
        self, actor: ProbabilisticTensorDictSequential, frames: TensorDictBase, action: Tensor
    ) -> Tensor:
        """The logarithm of the numerator of the ratios: log π(a_t|s_t) [frames]."""
        return frame_log_prob(actor, frames, action)

    def advantage(
        self, episodes: Episodes, baseline: Tensor | float, log_ratio: Tensor | None
    ) -> Tensor:
        """The factor of ∇log π(a_t|s_t) [frames].

        ``baseline`` is b_t [frames] or one number. ``log_ratio`` is log π(a_t|s_t) − log μ(a_t|s_t)
        [frames], or with another numerator; None if not needed.
        """
        if isinstance(baseline, float) and baseline == 0:
            return episodes.returns
        return episodes.returns - baseline


def as_correction(value: NoCorrection | None) -> NoCorrection:
    """A correction; None is none.

    Raises:
        ValueError: if it is no object of a class of ``corrections``.
    """
    if value is not None and not isinstance(value, NoCorrection):
        raise ValueError(f"correction must be an object such as PerStep(), got {value!r}")
    return value or NoCorrection()


class ImportanceWeights(NoCorrection):
    """The base class of importance weights: clipping, normalisation, and the requirements on μ.

    The weights need the exact μ(a|s) of every frame, and μ(a|s) > 0 wherever π(a|s) > 0. A strategy
    that never takes some actions, such as argmax, meets the first requirement but not the second:
    weights cannot correct for actions missing from the data, so the estimate remains biased.

    Args:
        clip: replaces weights w by min(w, clip) (Ionides 2008): less variance, biased; None: no
            clipping.
        self_normalize: whether weights are divided by their mean over the trial's data of the
            iteration (Hesterberg 1995; Precup, Sutton & Singh 2000): less variance, biased, but
            consistent in the number of episodes.

    Raises:
        ValueError: if ``clip`` is not positive.
    """

    needs_log_prob: ClassVar[bool] = True

    def __init__(self, clip: float | None = None, self_normalize: bool = False) -> None:
        self.clip = None if clip is None else check_number("clip", clip, 0, low_open=True)
        self.self_normalize = check_flag("self_normalize", self_normalize)

    def actor(
        self, actor: ProbabilisticActor, strategy: BaseStrategy | None = None
    ) -> ProbabilisticActor:
        """π, if the strategy has exact probabilities."""
        if strategy is not None and not strategy.exact:
            raise ValueError(
                f"{type(self).__name__} needs exact action probabilities, which "
                f"{type(strategy).__name__} does not have; correction=none works with any strategy"
            )
        return actor

    def _clipped(self, log_weight: Tensor) -> Tensor:
        """Log min(w, clip), from log w."""
        return log_weight if self.clip is None else log_weight.clamp(max=math.log(self.clip))

    def _weights(self, log_weight: Tensor, group: Tensor, groups: int) -> Tensor:
        """The clipped weights [n], with ``self_normalize`` divided by their mean over a group."""
        log_weight = self._clipped(log_weight)
        return shares(log_weight, group, groups) if self.self_normalize else log_weight.exp()


def shares(log_weight: Tensor, group: Tensor, groups: int) -> Tensor:
    """The weights divided by their mean over a group: w_i / mean{w_j: group_j = group_i} [n].

    Weights of long episodes underflow, but their quotients do not, so only quotients are computed.
    If all weights of a group are 0, the quotients are 0.

    Example:
        >>> shares(torch.tensor([-3000.0, -3000.0]), torch.tensor([0, 0]), 1)
        tensor([1., 1.])
    """
    lowest = torch.finfo(log_weight.dtype).min  # instead of −∞, so that differences are defined
    largest = log_weight.new_full((groups,), lowest)
    largest = largest.scatter_reduce(0, group, log_weight, "amax")
    weight = (log_weight - largest[group]).exp()
    count = torch.bincount(group, minlength=groups).clamp(min=1)
    mean = lane_sum(weight, group, groups) / count
    return weight / mean.clamp(min=torch.finfo(mean.dtype).tiny)[group]


def log_ratio_of(numerator: Tensor, behaviour: Tensor) -> Tensor:
    """The logarithm of a numerator, such as π, over μ, for every frame [frames].

    In double, because products of ratios are long.

    Raises:
        ValueError: if an action in the data has probability 0 under μ.
    """
    if bool((behaviour == -torch.inf).any()):
        raise ValueError("an action in the data has probability 0 under the behaviour policy")
    return numerator.double() - behaviour.double()
