"""Exploit, except in a share ε of the frames, where the better actions are the likelier ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from trl_explore.schedules import Schedule, as_schedule
from trl_explore.strategies.mixture import Mixture, MixtureStrategy


class MaxBoltzmann(MixtureStrategy):
    """Argmax with weight 1 − ε, softmax at a temperature with weight ε.

    μ(a|s) = (1 − ε) · 1[a ∈ A*] / |A*| + ε · softmax(logits / T)_a

    (Wiering 1999, "Explorations in Efficient Reinforcement Learning", chapter 5, the Max-Boltzmann
    rule). T → ∞ gives ε-greedy, ε = 1 softmax.

    Args:
        epsilon: ε in [0, 1], a number, one number per trial, or a schedule of the iteration.
        temperature: T > 0, likewise; it may fall to 0, the limit.
        options: the arguments of ``Strategy``.

    Raises:
        ValueError: if ε leaves [0, 1] in any iteration, or T is not a positive number.

    Example:
        >>> import math, torch
        >>> MaxBoltzmann(0.4).probs(torch.tensor([0.0, math.log(3)]))
        tensor([0.1000, 0.9000])
    """

    def __init__(
        self,
        epsilon: float | Sequence[float] | Schedule = 0.3,
        temperature: float | Sequence[float] | Schedule = 1.0,
        **options: Any,
    ) -> None:
        super().__init__(**options)
        self.epsilon = as_schedule("epsilon", epsilon, 0, 1)
        self.temperature = as_schedule("temperature", temperature, 0, float("inf"), low_open=True)

    def mixture(self) -> Mixture:
        """A point on the edge from greedy to softmax."""
        epsilon = self.epsilon(self.iteration)
        return Mixture(1 - epsilon, epsilon, temperature=self.temperature(self.iteration))
