"""Exploit, except in a share ε of the frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from trl_explore.schedules import Exponential, Schedule, as_schedule
from trl_explore.strategies.mixture import Mixture, MixtureStrategy


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

    def __init__(self, epsilon: float | Sequence[float] | Schedule = 0.3, **options: Any) -> None:
        super().__init__(**options)
        self.epsilon = as_schedule("epsilon", epsilon, 0, 1)

    def mixture(self) -> Mixture:
        """A point on the edge from greedy to uniform."""
        epsilon = self.epsilon(self.iteration)
        return Mixture(greedy=1 - epsilon, uniform=epsilon)


class DecayingEpsilonGreedy(EpsilonGreedy):
    """ε-greedy with ε_i = decay^i in iteration i = 0, 1, ...      (thesis, §2.2.4, appendix A.4).

    A name for ``EpsilonGreedy(Exponential(1.0, decay))``.

    Args:
        decay: in [0, 1].
        options: the arguments of ``Strategy``.

    Raises:
        ValueError: if the decay is not in [0, 1].
    """

    def __init__(self, decay: float = 0.99, **options: Any) -> None:
        super().__init__(Exponential(1.0, decay), **options)
