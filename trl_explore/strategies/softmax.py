"""Explore in proportion to what the policy says."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from trl_explore.schedules import Schedule, as_schedule
from trl_explore.strategies.mixture import Mixture, MixtureStrategy


class Softmax(MixtureStrategy):
    """Softmax of the logits at a temperature; at T = 1 the policy itself, and the data on-policy.

    μ(a|s) = exp(logits_a / T) / Σ_b exp(logits_b / T)      (Sutton & Barto, §2.8; thesis, §2.2.5)

    The thesis prints exp(x^T); x / T is meant. T → 0 gives argmax, T → ∞ uniform.

    Args:
        temperature: T > 0, a number, one number per trial, or a schedule of the iteration, which
            may fall to 0: the limit, argmax.
        options: the arguments of ``Strategy``.

    Raises:
        ValueError: if T is not a positive number.

    Example:
        >>> import torch
        >>> Softmax(temperature=2.0).probs(torch.tensor([0.0, 2.0])).sum()
        tensor(1.)
    """

    differentiable = True

    def __init__(
        self, temperature: float | Sequence[float] | Schedule = 1.0, **options: Any
    ) -> None:
        super().__init__(**options)
        self.temperature = as_schedule("temperature", temperature, 0, float("inf"), low_open=True)

    def mixture(self) -> Mixture:
        """The softmax corner."""
        return Mixture(softmax=1.0, temperature=self.temperature(self.iteration))
