"""Random, argmax, and ε-greedy between them."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from trl_explore.strategies.mixture import Mixture, MixtureStrategy
from trl_explore.strategies.schedules import Exponential, Parameter


class Random(MixtureStrategy):
    """Uniform over the actions, independent of the policy.

    μ(a|s) = 1 / n_actions      (thesis, §2.2.1)

    Example:
        >>> import torch
        >>> Random().probs(torch.tensor([0.0, 3.0]))
        tensor([0.5000, 0.5000])
    """

    differentiable = True

    def mixture(self) -> Mixture:
        """All weight on uniform."""
        return Mixture(uniform=1.0)


class Argmax(MixtureStrategy):
    """The action of largest logit; ties share.

    μ(a|s) = 1[a ∈ A*] / |A*|,   A* = argmax_a logits_a      (thesis, §2.2.2)

    Example:
        >>> import torch
        >>> Argmax().probs(torch.tensor([0.0, 4.0, -1.0, 4.0]))
        tensor([0.0000, 0.5000, 0.0000, 0.5000])
    """

    def mixture(self) -> Mixture:
        """All weight on argmax."""
        return Mixture(greedy=1.0)


class EpsilonGreedy(MixtureStrategy):
    """Argmax with weight 1 − ε, uniform with weight ε.

    μ(a|s) = (1 − ε) · 1[a ∈ A*] / |A*| + ε / n_actions      (Sutton & Barto, §2.2; thesis, §2.2.3)

    Args:
        epsilon: ε in [0, 1], a number, one number per trial, or a schedule.
        options: the arguments of ``Strategy``.

    Raises:
        ValueError: if ε leaves [0, 1] in any iteration.

    Example:
        >>> import torch
        >>> EpsilonGreedy(0.2).probs(torch.tensor([0.0, 4.0, -1.0, 4.0]))
        tensor([0.0500, 0.4500, 0.0500, 0.4500])
    """

    epsilon: Tensor

    def __init__(self, epsilon: Parameter = 0.3, **options: Any) -> None:
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
