"""The whole family: all three corners at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from trl_explore.schedules import Schedule, as_schedule
from trl_explore.strategies.mixture import Mixture, MixtureStrategy

Parameter = float | Sequence[float] | Schedule


class FullMixture(MixtureStrategy):
    """Argmax, softmax and uniform, each with a weight of its own.

    μ(a|s) = (w_g · 1[a ∈ A*] / |A*| + w_s · softmax(logits / T)_a + w_u / n_actions) / W
    with W = w_g + w_s + w_u

    The weights are relative: the rule is to divide by their sum, in every iteration, so that each
    may follow a schedule of its own. Every strategy of the thesis is a point of it.

    Args:
        greedy: w_g >= 0, a number, one number per trial, or a schedule of the iteration.
        softmax: w_s >= 0, likewise.
        uniform: w_u >= 0, likewise.
        temperature: T > 0, likewise; it may fall to 0, the limit.
        options: the arguments of ``Strategy``.

    Raises:
        ValueError: if a weight is negative, T is not a positive number, or all weights are 0.

    Example:
        >>> import torch
        >>> FullMixture(greedy=2, softmax=0, uniform=2).probs(torch.tensor([0.0, 4.0]))
        tensor([0.2500, 0.7500])
    """

    def __init__(
        self,
        greedy: Parameter = 0.4,
        softmax: Parameter = 0.4,
        uniform: Parameter = 0.2,
        temperature: Parameter = 1.0,
        **options: Any,
    ) -> None:
        super().__init__(**options)
        self.greedy = as_schedule("greedy", greedy, 0, float("inf"))
        self.softmax = as_schedule("softmax", softmax, 0, float("inf"))
        self.uniform = as_schedule("uniform", uniform, 0, float("inf"))
        self.temperature = as_schedule("temperature", temperature, 0, float("inf"), low_open=True)
        self.mixture()

    @property
    def differentiable(self) -> bool:
        """Whether the argmax has no share, in any iteration."""
        return self.greedy.bounds[1] == 0

    def mixture(self) -> Mixture:
        """The weights divided by their sum."""
        weights = [w(self.iteration) for w in (self.greedy, self.softmax, self.uniform)]
        shapes = {np.shape(w) for w in weights} - {()}
        if len(shapes) > 1:
            raise ValueError(f"the weights have {sorted(s[0] for s in shapes)} values for trials")
        total = weights[0] + weights[1] + weights[2]
        if np.any(total == 0) or not np.all(np.isfinite(total)):
            raise ValueError(
                "greedy + softmax + uniform must be a positive number, "
                f"got {total} in iteration {self.iteration}"
            )
        return Mixture(*(w / total for w in weights), temperature=self.temperature(self.iteration))
