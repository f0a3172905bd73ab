"""Strategies over vectors of real numbers: the base class and the mixture family."""

from __future__ import annotations

from abc import abstractmethod
from functools import reduce
from typing import Any, ClassVar, NamedTuple, cast

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import Bounded, TensorSpec, Unbounded
from torchrl.data.tensor_specs import ContinuousBox

from trl_explore.checks import check_flag, holds, settle
from trl_explore.numerics.densities import gaussian_log_prob
from trl_explore.strategies.schedules import Value
from trl_explore.strategies.strategy import (
    BaseStrategy,
    exploring,
    numbers,
    present,
    read,
    rows,
)


class ContinuousStrategy(BaseStrategy):
    """A behaviour policy μ(·|s) over actions a ∈ ℝⁿ, made from a policy π = N(loc, diag(scale²)).

    A subclass defines ``draw`` and, if μ has a density, ``log_prob``. The action box [low, high]
    comes from an action spec, given here or by a collector. The environment clips actions to the
    box; the action that is written and its density are those before clipping.

    With ``squashed``, π is TorchRL's ``TanhNormal(loc, scale, low=low, high=high)``: the tanh of
    the Gaussian, scaled to the box.

    The strategy explores if TorchRL's exploration type is RANDOM or unset. Under MODE, MEAN or
    DETERMINISTIC it takes loc (its tanh if squashed), with log-probability 0: that of a certain
    action, not a density.

    Reads "loc" and "scale" [*batch, n_dims]; a strategy that does not use the scale works with a
    deterministic actor.
    Writes "action" [*batch, n_dims] and "action_log_prob" [*batch] (joint log density, nats).

    Args:
        spec: the action spec (``Bounded`` or ``Unbounded``, possibly in a ``Composite``). The
            agents of a group may have different boxes.
        loc_key: the entry with the mean of π.
        scale_key: the entry with the standard deviation of π.
        squashed: whether π is a ``TanhNormal``.
        action_key: the entry to write the action to.
        log_prob_key: the entry to write the log density to; None: beside the action, with the
            suffix "_log_prob".
        noise_key: the entry with uniform numbers in [0, 1) that decide the draw [*batch,
            n_dims + 1], one per action dimension, and one more; None: there is none, except from
            a collector of this package.
        trial_key: the entry with the trial of each frame [*batch]; read only if a parameter differs
            between trials.

    Raises:
        ValueError: if the spec is of another kind.
    """

    actions = "continuous"
    boxed = False
    """Whether the strategy draws from the box, which must then be finite."""
    scaled = True
    """Whether the strategy uses the scale of π."""
    low: Tensor | None
    high: Tensor | None

    def __init__(
        self,
        *,
        spec: TensorSpec | None = None,
        loc_key: NestedKey = "loc",
        scale_key: NestedKey = "scale",
        squashed: bool = False,
        action_key: NestedKey = "action",
        log_prob_key: NestedKey | None = None,
        noise_key: NestedKey | None = None,
        trial_key: NestedKey = "trial",
    ) -> None:
        super().__init__(
            [loc_key, scale_key] if self.scaled else [loc_key],
            action_key=action_key,
            log_prob_key=log_prob_key,
            noise_key=noise_key,
            trial_key=trial_key,
        )
        self.loc_key, self.scale_key = loc_key, scale_key
        self.squashed = check_flag("squashed", squashed)
        self.register_buffer("low", None, persistent=False)
        self.register_buffer("high", None, persistent=False)
        if spec is not None:
            self.serve(spec)

    def serve(self, spec: TensorSpec) -> None:
        """Check the action spec; store the number of dimensions and the box."""
        super().serve(spec)
        spec = self._leaf(spec)
        if not isinstance(spec, Bounded | Unbounded) or not spec.shape:
            raise ValueError(
                "the action spec must be a Bounded or Unbounded vector, "
                f"got {type(spec).__name__} of shape {list(spec.shape)}"
            )
        space = cast(ContinuousBox, spec.space)
        low, high = space.low.double(), space.high.double()
        if isinstance(spec, Unbounded):  # torchrl's bounds are the largest finite numbers
            low, high = torch.full_like(low, -torch.inf), torch.full_like(high, torch.inf)
        first = [bound.reshape(-1, spec.shape[-1])[0] for bound in (low, high)]
        if bool((low == first[0]).all() and (high == first[1]).all()):  # one box for all lanes
            low, high = first
        if (self.boxed or self.squashed) and not (high - low).isfinite().all():
            raise ValueError(
                f"{type(self).__name__} needs an action box that is finite, "
                f"got [{low.tolist()}, {high.tolist()}]"
            )
        self.low, self.high = low, high
        self.noise_size = spec.shape[-1] + 1

    @abstractmethod
    def draw(self, loc: Tensor, scale: Tensor, noise: Tensor, trial: Tensor | None) -> Tensor:
        """The action [*batch, n_dims], in double, for noise [*batch, n_dims + 1]."""
        raise NotImplementedError(f"{type(self).__name__} does not define draw")

    def log_prob(
        self, action: Tensor, loc: Tensor, scale: Tensor, trial: Tensor | None = None
    ) -> Tensor:
        """Log density log μ(a|s) [*batch] in the current iteration, differentiable.

        Args:
            action: [*batch, n_dims].
            loc: [*batch, n_dims].
            scale: [*batch, n_dims].
            trial: [*batch] int64, needed only if parameters differ between trials.

        Raises:
            ValueError: if μ has no density.
        """
        raise ValueError(f"the actions of {type(self).__name__} have no density")

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Draw "action" from μ and write "action_log_prob"."""
        loc = read(tensordict, self.loc_key)
        scale = read(tensordict, self.scale_key) if self.scaled else loc
        self._check(loc)
        if exploring():
            trial = self._trial(tensordict)
            noise = self._noise(tensordict, loc.shape[:-1], loc.device).double()
            wide = loc.double(), scale.double()
            # The density is that of the action as written, after rounding.
            action = self.draw(*wide, noise, trial).to(loc.dtype)
            log_prob = self.log_prob(action.double(), *wide, trial) if self.exact else None
        else:
            action, log_prob = self._squash(loc.double()).to(loc.dtype), loc.new_zeros(())
            log_prob = log_prob.expand(loc.shape[:-1]).clone()
        tensordict.set(self.action_key, action)
        if self.exact and log_prob is not None:
            precision = torch.promote_types(loc.dtype, torch.float32)
            tensordict.set(self.log_prob_key, log_prob.to(precision))
        return tensordict

    def _check(self, loc: Tensor) -> None:
        """Check loc; set the number of dimensions if no spec is given."""
        n_dims = loc.shape[-1]
        if self.low is None:
            if self.boxed or self.squashed:
                raise ValueError(
                    f"{type(self).__name__} needs the action box: pass the action spec as spec"
                )
            self.noise_size = n_dims + 1
        elif n_dims != self.low.shape[-1]:
            raise ValueError(
                f"loc has {n_dims} dimensions, but the actions have {self.low.shape[-1]}"
            )

    def _box(self, like: Tensor) -> tuple[Tensor, Tensor]:
        assert self.low is not None
        assert self.high is not None
        return self.low.to(like), self.high.to(like)

    def _squash(self, x: Tensor) -> Tensor:
        """The action for a point x of the Gaussian: x, or its tanh scaled to the box."""
        if not self.squashed:
            return x
        low, high = self._box(x)
        return low + (high - low) * (x.tanh().clamp(-SATURATED, SATURATED) + 1) / 2

    def _unsquash(self, action: Tensor) -> tuple[Tensor, Tensor | float]:
        """The point x of the Gaussian for an action, and the sum of log |∂action_j/∂x_j|."""
        if not self.squashed:
            return action, 0.0
        low, high = self._box(action)
        y = (2 * (action - low) / (high - low) - 1).clamp(-SATURATED, SATURATED)
        return y.atanh(), ((high - low) / 2 * (1 - y * y)).log().sum(-1)


COLDEST = 1e-6
"""The smallest temperature; a Gaussian of scale 0 has no density."""
BELOW_ONE = 1 - 2**-53
"""The largest number below 1."""
SATURATED = 1 - 2**-20
"""The largest tanh, so that an action rounded to float32 is within the box and has a density."""


class ContinuousMixture(NamedTuple):
    """The weights and temperature in one iteration; each a number [], or one per trial [trials].

    The weights are non-negative and sum to 1; the temperature is >= 0 and kept at 1e-6 or above.
    """

    mean: Value | Tensor = 0.0
    gaussian: Value | Tensor = 0.0
    uniform: Value | Tensor = 0.0
    temperature: Value | Tensor = 1.0


class ContinuousMixtureStrategy(ContinuousStrategy):
    """A mixture of the mean, the Gaussian and the uniform distribution over the box.

    μ(·|s) = w_mean · δ(loc) + w_gaussian · N(loc, diag((T · scale)²)) + w_uniform · U(low, high)

    the counterpart of the discrete ``MixtureStrategy``. The last noise number chooses the component
    (in increasing order: uniform, Gaussian, mean). The others go through the component's inverse
    CDF, one per dimension:

        a_j = low_j + u_j (high_j − low_j)  or  a_j = loc_j + T scale_j Φ⁻¹(u_j)

    so that all strategies of the family use the same random numbers. A subclass returns the weights
    and T for the current iteration from ``mixture``. If w_mean is not always 0, μ has no density,
    and the subclass sets ``exact = False``.

    Attributes:
        mixes_policy: whether ``mixture`` mixes the Gaussian of the target policy itself. False in a
            class that overrides one of the methods in ``REPLACED``, unless the class declares it.
    """

    REPLACED = ("forward", "draw", "log_prob")
    mixes_policy: ClassVar[bool] = True

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        settle(cls, "mixes_policy", False, cls.REPLACED)

    @abstractmethod
    def mixture(self) -> ContinuousMixture:
        """Weights and temperature in the current iteration."""

    def bind(
        self,
        policy: TensorDictModuleBase,
        trials: int,
        *,
        seed: int | None = None,
        first_trial: int = 0,
    ) -> None:
        """Connect the strategy to its target policy."""
        super().bind(policy, trials, seed=seed, first_trial=first_trial)
        for name, value in self.mixture()._asdict().items():
            if np.shape(value) not in ((), (trials,)):
                raise ValueError(f"{name} has {len(value)} values, but there are {trials} trials")

    def on_policy(self) -> bool | NDArray[np.bool_]:
        """Whether μ is the Gaussian of the policy: the mixture is Gaussian alone, at T = 1."""
        mean, _, uniform, temperature = map(np.asarray, numbers(self.mixture()))
        if not (self.mixes_policy and holds(self, "mixes_policy", self.REPLACED)):
            return False
        found = np.equal(mean, 0) & np.equal(uniform, 0) & np.equal(temperature, 1)
        return found if np.ndim(found) else bool(found)

    def draw(self, loc: Tensor, scale: Tensor, noise: Tensor, trial: Tensor | None) -> Tensor:
        """The action [*batch, n_dims] for noise [*batch, n_dims + 1]."""
        point = self.mixture()
        mean, _, uniform, temperature = self._point(point, trial, loc)
        corner, u = noise[..., -1:].clamp(max=BELOW_ONE), noise[..., :-1]
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
