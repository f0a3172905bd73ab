"""The family of the continuous strategies: a mixture of three corners."""

from __future__ import annotations

from abc import abstractmethod
from functools import reduce
from typing import NamedTuple

import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from trl_explore.ops import gaussian_log_prob
from trl_explore.schedules import Value
from trl_explore.strategies.common import check_trials, rows
from trl_explore.strategies.continuous.base import ContinuousStrategy

COLDEST = 1e-6
"""The smallest temperature: a Gaussian of scale 0 has no density."""
BELOW_ONE = 1 - 2**-53
"""The largest number below 1."""


class ContinuousMixture(NamedTuple):
    """The point of the family in one iteration; each entry one number, or one per trial [trials].

    The weights are non-negative and sum to 1; the temperature is >= 0, and kept at 1e-6 or above.
    """

    mean: Value | Tensor = 0.0
    gaussian: Value | Tensor = 0.0
    uniform: Value | Tensor = 0.0
    temperature: Value | Tensor = 1.0


class ContinuousMixtureStrategy(ContinuousStrategy):
    """A mixture of the mean, the Gaussian and the uniform distribution over the box.

    μ(·|s) = w_mean · δ(loc) + w_gaussian · N(loc, diag((T · scale)²)) + w_uniform · U(low, high)

    the counterpart of the discrete ``MixtureStrategy``. The last number of the noise chooses the
    corner (uniform where it is smallest, then the Gaussian, then the mean), the others are inverted
    through its distribution function, dimension by dimension:

        a_j = low_j + u_j (high_j − low_j)  or  a_j = loc_j + T scale_j Φ⁻¹(u_j)

    so that any two strategies of the family see the same random numbers. A subclass states the
    weights and T for the current iteration in ``mixture``; where w_mean is not always 0, μ has no
    density, and the subclass says ``exact = False``.
    """

    @abstractmethod
    def mixture(self) -> ContinuousMixture:
        """Weights and temperature in the current iteration."""

    def bind(
        self, policy: TensorDictModuleBase, trials: int, *, seed: int = 0, first_trial: int = 0
    ) -> None:
        """Learn whom the strategy serves."""
        super().bind(policy, trials, seed=seed, first_trial=first_trial)
        check_trials(trials, *self.mixture())

    def draw(self, loc: Tensor, scale: Tensor, noise: Tensor, trial: Tensor | None) -> Tensor:
        """The action [*batch, n_dims] of noise [*batch, n_dims + 1]."""
        mean, gaussian, uniform, temperature = self._point(trial, loc)
        corner, u = noise[..., -1:].clamp(max=BELOW_ONE), noise[..., :-1]
        action = loc
        if gaussian.any():
            # Φ⁻¹ is finite strictly between 0 and 1.
            z = torch.special.ndtri(u.clamp(1 - BELOW_ONE, BELOW_ONE))
            action = torch.where(corner < 1 - mean, loc + temperature * scale * z, action)
        if uniform.any():
            low, high = self._bounds(loc)
            action = torch.where(corner < uniform, low + u * (high - low), action)
        return action

    def log_prob(
        self, action: Tensor, loc: Tensor, scale: Tensor, trial: Tensor | None = None
    ) -> Tensor:
        """Log density log μ(a|s) [*batch] in the current iteration."""
        if not self.exact:
            return super().log_prob(action, loc, scale, trial)
        self._check(loc)
        _, gaussian, uniform, temperature = self._point(trial, loc)
        terms: list[Tensor] = []
        if gaussian.any():
            log_prob = gaussian_log_prob(action, loc, temperature * scale)
            terms.append(log_prob + gaussian.log().squeeze(-1))
        if uniform.any():
            low, high = self._bounds(loc)
            inside = ((low <= action) & (action <= high)).all(-1)
            log_prob = uniform.log().squeeze(-1) - (high - low).log().sum()
            terms.append(torch.where(inside, log_prob, -torch.inf))
        return reduce(_log_sum, terms)

    def _point(self, trial: Tensor | None, loc: Tensor) -> list[Tensor]:
        """The weights of mean, Gaussian and uniform, and T: each [], or a column [*batch, 1]."""
        values = (rows(value, trial, loc) for value in self.mixture())
        point = [torch.as_tensor(value, dtype=loc.dtype, device=loc.device) for value in values]
        *weights, temperature = point
        return [*weights, temperature.clamp(min=COLDEST)]

    def _bounds(self, loc: Tensor) -> tuple[Tensor, Tensor]:
        assert self.box is not None
        low, high = self.box
        return low.to(loc), high.to(loc)


def _log_sum(a: Tensor, b: Tensor) -> Tensor:
    """log(eᵃ + eᵇ), where at most one of them is −∞; unlike torch's, the same at every place."""
    return torch.maximum(a, b) + torch.log1p(torch.exp(-(a - b).abs()))
