"""Strategies over vectors of real numbers: the base class."""

from __future__ import annotations

from abc import abstractmethod
from typing import Unpack, cast

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import dispatch
from torch import Tensor
from torchrl.data import Bounded, TensorSpec, Unbounded
from torchrl.data.tensor_specs import ContinuousBox

from trl_explore.checks import check_flag
from trl_explore.strategies.frames import read
from trl_explore.strategies.strategy import BaseStrategy, Keys, exploring

SATURATED = 1 - 2**-20
"""The largest tanh, so that an action rounded to float32 is within the box and has a density."""


class ContinuousStrategy(BaseStrategy):
    """A behaviour policy μ(·|s) over actions a ∈ ℝⁿ, made from a policy π = N(loc, diag(scale²)).

    A subclass defines ``draw`` and, if μ has a density, ``log_prob``. The action box [low, high]
    comes from an action spec, given here or by a collector. The environment clips actions to the
    box; the action that is written and its density are those before clipping.

    With ``squashed``, π is TorchRL's ``TanhNormal(loc, scale, low=low, high=high)``: the tanh of
    the Gaussian, scaled to the box.

    The strategy explores if TorchRL's exploration type is RANDOM or unset. Under any other
    type it takes loc (its tanh if squashed), with log-probability 0: that of a certain action, not
    a density.

    Reads "loc" and "scale" [*batch, n_dims]; a strategy that does not use the scale works with a
    deterministic actor.
    Writes "action" [*batch, n_dims] and "action_log_prob" [*batch] (joint log density, nats).

    Args:
        spec: the action spec (``Bounded`` or ``Unbounded``, possibly in a ``Composite``). The
            agents of a group may have different boxes.
        loc_key: the entry with the mean of π.
        scale_key: the entry with the standard deviation of π.
        squashed: whether π is a ``TanhNormal``.
        keys: the keys of ``BaseStrategy``; the noise is [*batch, n_dims + 1], one number per action
            dimension, and one more.

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
        **keys: Unpack[Keys],
    ) -> None:
        super().__init__([loc_key, scale_key] if self.scaled else [loc_key], **keys)
        self.loc_key, self.scale_key = loc_key, scale_key
        self.squashed = check_flag("squashed", squashed)
        self.register_buffer("low", None, persistent=False)
        self.register_buffer("high", None, persistent=False)
        if spec is not None:
            self.set_spec(spec)

    def set_spec(self, spec: TensorSpec) -> None:
        """Check the action spec; store the number of dimensions and the box."""
        super().set_spec(spec)
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

        ``trial`` [*batch] int64 is needed only if parameters differ between trials.

        Raises:
            ValueError: if μ has no density.
        """
        raise ValueError(f"the actions of {type(self).__name__} have no density")

    @dispatch(auto_batch_size=False)
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Draw "action" from μ and write "action_log_prob"."""
        loc = read(tensordict, self.loc_key)
        scale = read(tensordict, self.scale_key) if self.scaled else loc
        self._check(loc)
        if exploring():
            trial = self._trial(tensordict)
            noise = self._noise(tensordict, loc.shape[:-1], loc.device)
            wide = loc.double(), scale.double()
            # The density is that of the action as written, after rounding.
            action = self.draw(*wide, noise, trial).to(loc.dtype)
            log_prob = self.log_prob(action.double(), *wide, trial) if self.exact else None
        else:
            action = self._squash(loc.double()).to(loc.dtype)
            log_prob = loc.new_zeros(loc.shape[:-1])
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
