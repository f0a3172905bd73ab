"""The shared part of every strategy over vectors of real numbers."""

from __future__ import annotations

from abc import abstractmethod
from functools import reduce
from typing import NamedTuple, cast

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import Bounded, TensorSpec, Unbounded
from torchrl.data.tensor_specs import ContinuousBox

from trl_explore.numerics.densities import gaussian_log_prob
from trl_explore.strategies.schedules import Value
from trl_explore.strategies.strategy import BaseStrategy, check_trials, exploring, rows


class ContinuousStrategy(BaseStrategy):
    """A behaviour policy μ(·|s) over actions a ∈ ℝⁿ, made from a policy π = N(loc, diag(scale²)).

    A subclass states ``draw`` and, where μ has a density, ``log_prob``. The box [low, high] of the
    actions is known from an action spec, given here or by a collector. The environment clips what
    lies outside; the action that is written and its density are those before clipping.

    Under ``ExplorationType.RANDOM``, or none set, the strategy explores. Under MODE, MEAN or
    DETERMINISTIC it takes loc, with log-probability 0: that of a certain action, not a density.

    Reads "loc" and "scale" [*batch, n_dims]; if present "noise" [*batch, n_dims + 1] (uniform in
    [0, 1): one number for each dimension of the action, and a last one) and "trial" [*batch].
    Writes "action" [*batch, n_dims] and "action_log_prob" [*batch] (log density of all n_dims
    together, nats).

    Args:
        spec: the action spec (``Bounded`` or ``Unbounded``, also in a ``Composite``).
        loc_key: the entry with the mean of π.
        scale_key: the entry with its standard deviation.
        action_key: the entry to write the action to.
        seed: seed of the module's own generator, used where no "noise" entry is given.

    Raises:
        ValueError: if the spec is not of a kind served.
    """

    actions = "continuous"
    boxed = False
    """Whether it draws from the box, which then must be finite."""

    def __init__(
        self,
        *,
        spec: TensorSpec | None = None,
        loc_key: NestedKey = "loc",
        scale_key: NestedKey = "scale",
        action_key: NestedKey = "action",
        seed: int = 0,
    ) -> None:
        super().__init__([loc_key, scale_key], action_key=action_key, seed=seed)
        self.loc_key, self.scale_key = loc_key, scale_key
        self.box: tuple[Tensor, Tensor] | None = None
        if spec is not None:
            self.serve(spec)

    def serve(self, spec: TensorSpec) -> None:
        """Learn which actions the environment takes: their number of dimensions and the box."""
        super().serve(spec)
        spec = self._leaf(spec)
        if not isinstance(spec, Bounded | Unbounded) or not spec.shape:
            raise ValueError(
                "a continuous strategy serves Bounded and Unbounded action specs over vectors, "
                f"got {type(spec).__name__} of shape {list(spec.shape)}"
            )
        # Every lane of an environment has the same box.
        space = cast(ContinuousBox, spec.space)
        low, high = (
            bound.double().reshape(-1, spec.shape[-1])[0] for bound in (space.low, space.high)
        )
        if isinstance(spec, Unbounded):  # torchrl's bounds are the largest numbers then
            low, high = torch.full_like(low, -torch.inf), torch.full_like(high, torch.inf)
        if self.boxed and not (high - low).isfinite().all():
            raise ValueError(
                f"{type(self).__name__} draws from the box of the actions, which must be finite, "
                f"got [{low.tolist()}, {high.tolist()}]"
            )
        self.box = low, high
        self.noise_size = len(low) + 1

    @abstractmethod
    def draw(self, loc: Tensor, scale: Tensor, noise: Tensor, trial: Tensor | None) -> Tensor:
        """The action [*batch, n_dims], in double, of noise [*batch, n_dims + 1]."""
        raise NotImplementedError(f"{type(self).__name__} does not state its draw")

    def log_prob(
        self, action: Tensor, loc: Tensor, scale: Tensor, trial: Tensor | None = None
    ) -> Tensor:
        """Log density log μ(a|s) [*batch] in the current iteration, differentiable.

        Args:
            action: [*batch, n_dims].
            loc: [*batch, n_dims].
            scale: [*batch, n_dims].
            trial: [*batch] int64, needed only where parameters differ between trials.

        Raises:
            ValueError: if μ has no density.
        """
        raise ValueError(f"the actions of {type(self).__name__} have no density")

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Draw "action" from μ and write "action_log_prob"."""
        loc, scale = tensordict.get(self.loc_key), tensordict.get(self.scale_key)
        self._check(loc)
        if exploring():
            trial = tensordict.get("trial", None)
            wide = loc.double(), scale.double()
            drawn = self.draw(*wide, self._noise(tensordict, loc).double(), trial)
            # The density is that of the action as it is written, after rounding.
            action = drawn.to(loc.dtype)
            log_prob = self.log_prob(action.double(), *wide, trial) if self.exact else None
        else:
            action, log_prob = loc.clone(), torch.zeros_like(loc[..., 0])
        tensordict.set(self.action_key, action)
        if self.exact and log_prob is not None:
            tensordict.set("action_log_prob", log_prob.to(loc.dtype))
        return tensordict

    def _check(self, loc: Tensor) -> None:
        """Learn the number of dimensions where no spec has been given."""
        n_dims = loc.shape[-1]
        if self.box is None:
            if self.boxed:
                raise ValueError(
                    f"{type(self).__name__} draws from the box of the actions: give it their spec"
                )
            self.noise_size = n_dims + 1
        elif n_dims != len(self.box[0]):
            raise ValueError(
                f"loc has {n_dims} dimensions, but the actions have {len(self.box[0])}"
            )


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
        """Learn which policy the strategy serves."""
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
