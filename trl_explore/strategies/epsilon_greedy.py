"""ε-greedy and its relatives: two-part mixtures with weight ε."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from torch import Tensor

from trl_explore.strategies.mixture import Mixture, MixtureStrategy
from trl_explore.strategies.schedules import Exponential, Schedule


class EpsilonGreedy(MixtureStrategy):
    """Argmax with weight 1 − ε, uniform with weight ε.

    μ(a|s) = (1 − ε) · 1[a ∈ A*] / |A*| + ε / n_actions      (Sutton & Barto, §2.2; thesis, §2.2.3)

    Args:
        epsilon: ε in [0, 1], a number, one number per trial, or a schedule of the iteration.
        options: the arguments of ``Strategy``.

    Raises:
        ValueError: if ε leaves [0, 1] in any iteration.

    Example:
        >>> import torch
        >>> EpsilonGreedy(0.2).probs(torch.tensor([0.0, 4.0, -1.0, 4.0]))
        tensor([0.0500, 0.4500, 0.0500, 0.4500])
    """

    epsilon: Tensor

    def __init__(self, epsilon: float | Sequence[float] | Schedule = 0.3, **options: Any) -> None:
        super().__init__(**options)
        self.follow("epsilon", epsilon, 0, 1)

    def mixture(self) -> Mixture:
        """Argmax with weight 1 − ε, uniform with weight ε."""
        return Mixture(greedy=1 - self.epsilon, uniform=self.epsilon)


class DecayingEpsilonGreedy(EpsilonGreedy):
    """ε-greedy with ε_i = decay^i in iteration i = 0, 1, ...      (thesis, §2.2.4, appendix A.4).

    Short for ``EpsilonGreedy(Exponential(1.0, decay))``.

    Args:
        decay: the factor per iteration, in [0, 1].
        options: the arguments of ``Strategy``.

    Raises:
        ValueError: if ``decay`` is not in [0, 1].
    """

    def __init__(self, decay: float = 0.99, **options: Any) -> None:
        super().__init__(Exponential(1.0, decay), **options)


class EpsilonSoftmax(MixtureStrategy):
    """Softmax at a temperature with weight 1 − ε, uniform with weight ε.

    μ(a|s) = (1 − ε) · softmax(logits / T)_a + ε / n_actions

    The ε-soft form of the softmax policy (Sutton & Barto, §5.4: every action has at least
    ε / n_actions). At T = 1 the ratio π/μ is at most 1 / (1 − ε).

    Args:
        epsilon: ε in [0, 1], a number, one number per trial, or a schedule of the iteration.
        temperature: T > 0, in the same forms; a schedule may reach 0, the limit.
        options: the arguments of ``Strategy``.

    Raises:
        ValueError: if ε leaves [0, 1] in any iteration, or T is not a positive number.

    Example:
        >>> import math, torch
        >>> EpsilonSoftmax(0.2).probs(torch.tensor([0.0, math.log(3)]))
        tensor([0.3000, 0.7000])
    """

    differentiable = True
    epsilon: Tensor
    temperature: Tensor

    def __init__(
        self,
        epsilon: float | Sequence[float] | Schedule = 0.1,
        temperature: float | Sequence[float] | Schedule = 1.0,
        **options: Any,
    ) -> None:
        super().__init__(**options)
        self.follow("epsilon", epsilon, 0, 1)
        self.follow("temperature", temperature, 0, float("inf"), low_open=True)

    def mixture(self) -> Mixture:
        """Softmax with weight 1 − ε, uniform with weight ε."""
        return Mixture(softmax=1 - self.epsilon, uniform=self.epsilon, temperature=self.temperature)


class MaxBoltzmann(MixtureStrategy):
    """Argmax with weight 1 − ε, softmax at a temperature with weight ε.

    μ(a|s) = (1 − ε) · 1[a ∈ A*] / |A*| + ε · softmax(logits / T)_a

    (Wiering 1999, "Explorations in Efficient Reinforcement Learning", chapter 5, the Max-Boltzmann
    rule). T → ∞ gives ε-greedy, ε = 1 softmax.

    Args:
        epsilon: ε in [0, 1], a number, one number per trial, or a schedule of the iteration.
        temperature: T > 0, in the same forms; a schedule may reach 0, the limit.
        options: the arguments of ``Strategy``.

    Raises:
        ValueError: if ε leaves [0, 1] in any iteration, or T is not a positive number.

    Example:
        >>> import math, torch
        >>> MaxBoltzmann(0.4).probs(torch.tensor([0.0, math.log(3)]))
        tensor([0.1000, 0.9000])
    """

    epsilon: Tensor
    temperature: Tensor

    def __init__(
        self,
        epsilon: float | Sequence[float] | Schedule = 0.3,
        temperature: float | Sequence[float] | Schedule = 1.0,
        **options: Any,
    ) -> None:
        super().__init__(**options)
        self.follow("epsilon", epsilon, 0, 1)
        self.follow("temperature", temperature, 0, float("inf"), low_open=True)

    def mixture(self) -> Mixture:
        """Argmax with weight 1 − ε, softmax with weight ε."""
        return Mixture(1 - self.epsilon, self.epsilon, temperature=self.temperature)
