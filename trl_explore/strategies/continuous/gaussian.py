"""Explore as widely as the policy says."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from trl_explore.schedules import Schedule, as_schedule
from trl_explore.strategies.continuous.mixture import ContinuousMixture, ContinuousMixtureStrategy


class Gaussian(ContinuousMixtureStrategy):
    """The Gaussian of the policy at a temperature; at T = 1 the policy itself, data on-policy.

    μ(·|s) = N(loc(s), diag((T · scale(s))²))      (T = 1: Williams 1992, §6; Sutton & Barto, §13.7)

    T → 0 gives the mean action. Where a schedule falls below 1e-6, T stays there: at 0 there is no
    density.

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

    def __init__(
        self, temperature: float | Sequence[float] | Schedule = 1.0, **options: Any
    ) -> None:
        super().__init__(**options)
        self.temperature = as_schedule("temperature", temperature, 0, float("inf"), low_open=True)

    def mixture(self) -> ContinuousMixture:
        """The corner of the Gaussian."""
        return ContinuousMixture(gaussian=1.0, temperature=self.temperature(self.iteration))
