"""Follow the policy, except in a share ε of the frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from trl_explore.schedules import Schedule, as_schedule
from trl_explore.strategies.continuous.mixture import ContinuousMixture, ContinuousMixtureStrategy


class EpsilonUniform(ContinuousMixtureStrategy):
    """The policy's Gaussian with weight 1 − ε, uniform over the box with weight ε.

    μ(·|s) = (1 − ε) · N(loc(s), diag(scale(s)²)) + ε · U(low, high)

    the counterpart of a softmax with ε. Its density is exact, outside of the box too.

    Args:
        epsilon: ε in [0, 1], a number, one number per trial, or a schedule of the iteration.
        options: the arguments of ``ContinuousStrategy``.

    Raises:
        ValueError: if ε leaves [0, 1] in any iteration, or the box is not finite.

    Example:
        >>> import math, torch
        >>> from torchrl.data import Bounded
        >>> mixture = EpsilonUniform(0.5, spec=Bounded(-1.0, 1.0, shape=(1,)))
        >>> zero, one = torch.zeros(1), torch.ones(1)
        >>> density = mixture.log_prob(zero, loc=zero, scale=one).exp()
        >>> math.isclose(density, 0.5 / math.sqrt(math.tau) + 0.25, rel_tol=1e-6)
        True
    """

    differentiable = True
    boxed = True

    def __init__(self, epsilon: float | Sequence[float] | Schedule = 0.3, **options: Any) -> None:
        super().__init__(**options)
        self.epsilon = as_schedule("epsilon", epsilon, 0, 1)

    def mixture(self) -> ContinuousMixture:
        """A point on the edge from the Gaussian to uniform."""
        epsilon = self.epsilon(self.iteration)
        return ContinuousMixture(gaussian=1 - epsilon, uniform=epsilon)


class EpsilonMean(EpsilonUniform):
    """The mean action with weight 1 − ε, uniform over the box with weight ε; as ε-greedy.

    μ(·|s) = (1 − ε) · δ(loc(s)) + ε · U(low, high)

    A mixture with a point has no density: the strategy writes no "action_log_prob", and no
    importance weight exists. ``EpsilonUniform`` has one.

    Args:
        epsilon: ε in [0, 1], a number, one number per trial, or a schedule of the iteration.
        options: the arguments of ``ContinuousStrategy``.

    Raises:
        ValueError: if ε leaves [0, 1] in any iteration, or the box is not finite.
    """

    exact = False
    differentiable = False

    def mixture(self) -> ContinuousMixture:
        """A point on the edge from the mean to uniform."""
        epsilon = self.epsilon(self.iteration)
        return ContinuousMixture(mean=1 - epsilon, uniform=epsilon)
