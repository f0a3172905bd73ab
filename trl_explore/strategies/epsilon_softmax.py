"""Follow the policy, except in a share ε of the frames, where every action is equally likely."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from trl_explore.schedules import Schedule, as_schedule
from trl_explore.strategies.mixture import Mixture, MixtureStrategy


class EpsilonSoftmax(MixtureStrategy):
    """Softmax at a temperature with weight 1 − ε, uniform with weight ε.

    μ(a|s) = (1 − ε) · softmax(logits / T)_a + ε / n_actions

    The ε-soft form of the softmax policy (Sutton & Barto, §5.4: every action has at least
    ε / n_actions). At T = 1 the ratio π/μ is at most 1 / (1 − ε).

    Args:
        epsilon: ε in [0, 1], a number, one number per trial, or a schedule of the iteration.
        temperature: T > 0, likewise; it may fall to 0, the limit.
        options: the arguments of ``Strategy``.

    Raises:
        ValueError: if ε leaves [0, 1] in any iteration, or T is not a positive number.

    Example:
        >>> import math, torch
        >>> EpsilonSoftmax(0.2).probs(torch.tensor([0.0, math.log(3)]))
        tensor([0.3000, 0.7000])
    """

    differentiable = True

    def __init__(
        self,
        epsilon: float | Sequence[float] | Schedule = 0.1,
        temperature: float | Sequence[float] | Schedule = 1.0,
        **options: Any,
    ) -> None:
        super().__init__(**options)
        self.epsilon = as_schedule("epsilon", epsilon, 0, 1)
        self.temperature = as_schedule("temperature", temperature, 0, float("inf"), low_open=True)

    def mixture(self) -> Mixture:
        """A point on the edge from softmax to uniform."""
        epsilon = self.epsilon(self.iteration)
        return Mixture(
            softmax=1 - epsilon, uniform=epsilon, temperature=self.temperature(self.iteration)
        )
