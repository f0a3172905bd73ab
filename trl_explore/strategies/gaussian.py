"""Strategies for Gaussian policies: mean, Gaussian, uniform, and mixtures of two."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from torch import Tensor

from trl_explore.strategies.continuous import ContinuousMixture, ContinuousMixtureStrategy
from trl_explore.strategies.schedules import Schedule


class MeanAction(ContinuousMixtureStrategy):
    """The mean of the policy's Gaussian, the counterpart of argmax.

    μ(·|s) = δ(loc(s))      (Silver et al. 2014, "Deterministic policy gradient algorithms", §3)

    It has no density: the strategy writes no "action_log_prob", and no importance weight exists.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> state = TensorDict({"loc": torch.tensor([0.5, -2.0]), "scale": torch.ones(2)})
        >>> MeanAction()(state)["action"]
        tensor([ 0.5000, -2.0000])
    """

    exact = False
    scaled = False

    def mixture(self) -> ContinuousMixture:
        """All weight on the mean."""
        return ContinuousMixture(mean=1.0)


class UniformAction(ContinuousMixtureStrategy):
    """Uniform over the action box, independent of the policy; the counterpart of ``Random``.

    μ(a|s) = Π_j 1[low_j ≤ a_j ≤ high_j] / (high_j − low_j)

    Raises:
        ValueError: if the box is not finite.

    Example:
        >>> import torch
        >>> from torchrl.data import Bounded
        >>> uniform = UniformAction(spec=Bounded(-2.0, 2.0, shape=(1,)))
        >>> zero, one = torch.zeros(1), torch.ones(1)
        >>> uniform.log_prob(zero, loc=zero, scale=one).exp()
        tensor(0.2500)
    """

    differentiable = True
    boxed = True
    scaled = False

    def mixture(self) -> ContinuousMixture:
        """All weight on uniform."""
        return ContinuousMixture(uniform=1.0)


class Gaussian(ContinuousMixtureStrategy):
    """The policy's Gaussian at a temperature; at T = 1 it is the policy, and data are on-policy.

    μ(·|s) = N(loc(s), diag((T · scale(s))²))      (T = 1: Williams 1992, §6; Sutton & Barto, §13.7)

    T → 0 gives the mean action. T is kept at 1e-6 or above, because at 0 there is no density.

    Args:
        temperature: T > 0, a number, one number per trial, or a schedule of the iteration.
        options: the arguments of ``ContinuousStrategy``.

    Raises:
        ValueError: if T is not a positive number.

    Example:
        >>> import math, torch
        >>> zero, one = torch.zeros(1), torch.ones(1)
        >>> density = Gaussian(temperature=2.0).log_prob(zero, loc=zero, scale=one).exp()
        >>> density * math.sqrt(math.tau)
        tensor(0.5000)
    """

    differentiable = True
    temperature: Tensor

    def __init__(
        self, temperature: float | Sequence[float] | Schedule = 1.0, **options: Any
    ) -> None:
        super().__init__(**options)
        self.follow("temperature", temperature, 0, float("inf"), low_open=True)

    def mixture(self) -> ContinuousMixture:
        """All weight on the Gaussian."""
        return ContinuousMixture(gaussian=1.0, temperature=self.temperature)


class EpsilonUniform(ContinuousMixtureStrategy):
    """The policy's Gaussian with weight 1 − ε, uniform over the box with weight ε.

    μ(·|s) = (1 − ε) · N(loc(s), diag(scale(s)²)) + ε · U(low, high)

    the counterpart of ``EpsilonSoftmax``. Its density is exact, outside the box too.

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
    epsilon: Tensor

    def __init__(self, epsilon: float | Sequence[float] | Schedule = 0.3, **options: Any) -> None:
        super().__init__(**options)
        self.follow("epsilon", epsilon, 0, 1)

    def mixture(self) -> ContinuousMixture:
        """The Gaussian with weight 1 − ε, uniform with weight ε."""
        return ContinuousMixture(gaussian=1 - self.epsilon, uniform=self.epsilon)


class EpsilonMean(EpsilonUniform):
    """The mean action with weight 1 − ε, uniform over the box with weight ε, like ε-greedy.

    μ(·|s) = (1 − ε) · δ(loc(s)) + ε · U(low, high)

    A mixture with a point mass has no density: the strategy writes no "action_log_prob", and no
    importance weight exists. ``EpsilonUniform`` has one.

    Args:
        epsilon: ε in [0, 1], a number, one number per trial, or a schedule of the iteration.
        options: the arguments of ``ContinuousStrategy``.

    Raises:
        ValueError: if ε leaves [0, 1] in any iteration, or the box is not finite.
    """

    exact = False
    differentiable = False
    scaled = False

    def mixture(self) -> ContinuousMixture:
        """The mean with weight 1 − ε, uniform with weight ε."""
        return ContinuousMixture(mean=1 - self.epsilon, uniform=self.epsilon)
