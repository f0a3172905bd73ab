"""Mixtures of the mean, the Gaussian and uniform, for Gaussian policies."""

from __future__ import annotations

from functools import reduce
from typing import Any, NamedTuple

import torch
from torch import Tensor

from trl_explore.numerics.densities import gaussian_log_prob
from trl_explore.strategies.continuous import ContinuousStrategy
from trl_explore.strategies.frames import rows
from trl_explore.strategies.mixture import MixtureFamily, present
from trl_explore.strategies.schedules import Parameter, Value
from trl_explore.strategies.strategy import BELOW_ONE

COLDEST = 1e-6
"""The smallest temperature; a Gaussian of scale 0 has no density."""


class ContinuousMixture(NamedTuple):
    """The weights and temperature in one iteration; each a number [], or one per trial [trials].

    The weights are non-negative and sum to 1; the temperature is >= 0 and kept at 1e-6 or above.
    """

    mean: Value | Tensor = 0.0
    gaussian: Value | Tensor = 0.0
    uniform: Value | Tensor = 0.0
    temperature: Value | Tensor = 1.0


class ContinuousMixtureStrategy(MixtureFamily, ContinuousStrategy):
    """A mixture of the mean, the Gaussian and the uniform distribution over the box.

    μ(·|s) = w_mean · δ(loc) + w_gaussian · N(loc, diag((T · scale)²)) + w_uniform · U(low, high)

    the counterpart of the discrete ``MixtureStrategy``. The last noise number chooses the component
    (in increasing order: uniform, Gaussian, mean). The others go through the component's inverse
    CDF, one per dimension:

        a_j = low_j + u_j (high_j − low_j)  or  a_j = loc_j + T scale_j Φ⁻¹(u_j)

    so that all strategies of the family use the same random numbers. A subclass returns the weights
    and T for the current iteration from ``mixture``. If w_mean is not always 0, μ has no density,
    and the subclass sets ``exact = False``.
    """

    REPLACED = ("forward", "draw", "log_prob")
    mixes_policy = True

    def draw(self, loc: Tensor, scale: Tensor, noise: Tensor, trial: Tensor | None) -> Tensor:
        """The action [*batch, n_dims] for noise [*batch, n_dims + 1]."""
        point = self.mixture()
        mean, _, uniform, temperature = self._point(point, trial, loc)
        corner, u = noise[..., -1:], noise[..., :-1]
        action = self._squash(loc)
        if present(point.gaussian):
            # Φ⁻¹ is finite only strictly between 0 and 1.
            z = torch.special.ndtri(u.clamp(1 - BELOW_ONE, BELOW_ONE))
            moved = self._squash(loc + temperature * scale * z)
            action = torch.where(corner < 1 - mean, moved, action)
        if present(point.uniform):
            low, high = self._box(loc)
            action = torch.where(corner < uniform, low + u * (high - low), action)
        return action

    def log_prob(
        self, action: Tensor, loc: Tensor, scale: Tensor, trial: Tensor | None = None
    ) -> Tensor:
        """Log density log μ(a|s) [*batch] in the current iteration."""
        if not self.exact:
            return super().log_prob(action, loc, scale, trial)
        self._check(loc)
        point = self.mixture()
        _, gaussian, uniform, temperature = self._point(point, trial, loc)
        terms: list[Tensor] = []
        if present(point.gaussian):
            x, log_slope = self._unsquash(action)
            log_prob = gaussian_log_prob(x, loc, temperature * scale) - log_slope
            terms.append(log_prob + gaussian.log().squeeze(-1))
        if present(point.uniform):
            low, high = self._box(loc)
            inside = ((low <= action) & (action <= high)).all(-1)
            log_prob = uniform.log().squeeze(-1) - (high - low).log().sum(-1)
            terms.append(torch.where(inside, log_prob, -torch.inf))
        return reduce(_log_sum, terms)

    def _point(self, point: ContinuousMixture, trial: Tensor | None, loc: Tensor) -> list[Tensor]:
        """The weights of mean, Gaussian and uniform, and T: each [], or a column [*batch, 1]."""
        values = (rows(value, trial, loc) for value in point)
        *weights, temperature = (
            torch.as_tensor(value, dtype=loc.dtype, device=loc.device) for value in values
        )
        return [*weights, temperature.clamp(min=COLDEST)]


def _log_sum(a: Tensor, b: Tensor) -> Tensor:
    """log(eᵃ + eᵇ); unlike torch's, independent of the position in the tensor."""
    distance = (a - b).abs().nan_to_num(torch.inf, torch.inf)  # both −∞
    return torch.maximum(a, b) + torch.log1p(torch.exp(-distance))


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
        temperature: T > 0, a number, one number per trial, or a schedule.
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

    def __init__(self, temperature: Parameter = 1.0, **options: Any) -> None:
        super().__init__(**options)
        self.follow("temperature", temperature, low_open=True)

    def mixture(self) -> ContinuousMixture:
        """All weight on the Gaussian."""
        return ContinuousMixture(gaussian=1.0, temperature=self.temperature)


class EpsilonUniform(ContinuousMixtureStrategy):
    """The policy's Gaussian with weight 1 − ε, uniform over the box with weight ε.

    μ(·|s) = (1 − ε) · N(loc(s), diag(scale(s)²)) + ε · U(low, high)

    the counterpart of ``EpsilonSoftmax``. Its density is exact, outside the box too.

    Args:
        epsilon: ε in [0, 1], a number, one number per trial, or a schedule.
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

    def __init__(self, epsilon: Parameter = 0.3, **options: Any) -> None:
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
        epsilon: ε in [0, 1], a number, one number per trial, or a schedule.
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
