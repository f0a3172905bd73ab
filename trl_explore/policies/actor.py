"""The target policy π as a distribution, for the loss; it excludes exploration."""

from __future__ import annotations

from functools import cached_property
from typing import Any, TypeGuard

import torch
from tensordict import NestedKey, TensorDictBase, is_tensor_collection
from tensordict.nn import (
    CompositeDistribution,
    ProbabilisticTensorDictSequential,
    TensorDictModule,
)
from torch import Tensor
from torch.distributions import Categorical as TorchCategorical
from torch.distributions import Distribution
from torchrl.modules import IndependentNormal, MaskedCategorical, ProbabilisticActor

from trl_explore.checks import holds
from trl_explore.numerics.densities import categorical_log_prob, gaussian_entropy, gaussian_log_prob
from trl_explore.numerics.dispatch import transformed
from trl_explore.policies.layers import LaneLinear, has_hooks
from trl_explore.policies.softmax import LinearPolicy


class SoftmaxCategorical(TorchCategorical):
    """π = softmax(logits) over actions; like torch's Categorical, but faster for log π(a|s).

    Args:
        logits: [*batch, n_actions], may be unnormalised.
        mask: [*batch, n_actions], bool or 0 and 1; False: the action has probability 0.

    Raises:
        ValueError: if the mask has another shape than the logits, or a state has no action of
            finite logit left.
    """

    def __init__(self, logits: Tensor, mask: Tensor | None = None) -> None:
        if logits.dtype in (torch.bfloat16, torch.float16):
            logits = logits.float()  # log π has about three digits in half precision
        self._unnormalised = logits if mask is None else masked_logits(logits, mask)
        self._num_events = logits.shape[-1]
        Distribution.__init__(self, batch_shape=logits.shape[:-1], validate_args=False)

    @cached_property
    def logits(self) -> Tensor:
        """Log π(·|s) [*batch, n_actions]."""
        return self._unnormalised.log_softmax(-1)

    @cached_property
    def probs(self) -> Tensor:
        """π(·|s) [*batch, n_actions]."""
        return self._unnormalised.softmax(-1)

    @property
    def param_shape(self) -> torch.Size:
        """The shape of the logits."""
        return self._unnormalised.shape

    def log_prob(self, value: Tensor) -> Tensor:
        """The log-probability of ``value``, which broadcasts with the batch."""
        shape = torch.broadcast_shapes(value.shape, self.batch_shape)
        logits = self._unnormalised.expand(*shape, self._num_events)
        return categorical_log_prob(logits, value.expand(shape))

    def expand(self, batch_shape: torch.Size, _instance: None = None) -> SoftmaxCategorical:
        """The same distribution over a larger batch."""
        return SoftmaxCategorical(self._unnormalised.expand(*batch_shape, self._num_events))

    @property
    def deterministic_sample(self) -> Tensor:
        """The most probable action [*batch]; TorchRL uses it in deterministic modes."""
        return self._unnormalised.argmax(-1)


def masked_logits(logits: Tensor, mask: Tensor) -> Tensor:
    """The logits [*batch, n_actions] with −∞ where ``mask``, bool or 0 and 1, is false.

    Raises:
        ValueError: if the mask has another shape than the logits, or a state has no action of
            finite logit left.
    """
    if mask.shape != logits.shape:
        raise ValueError(
            f"the action mask is {list(mask.shape)}, but the logits are {list(logits.shape)}"
        )
    logits = logits.masked_fill(~mask.bool(), -torch.inf)
    if not transformed(logits) and bool((logits == -torch.inf).all(-1).any()):
        raise ValueError("the action mask allows no action of finite logit in a state")
    return logits


class SoftmaxActor(ProbabilisticActor):
    """The target policy π = softmax(logits), on top of a module that writes "logits".

    It shares its parameters with ``policy`` and is for the loss (``get_dist``). In the environment,
    the behaviour policy is the policy followed by a strategy.

    Args:
        policy: a module that writes the logits.
        masked: whether the mask [*batch, n_actions] is a required input of the actor. In the loss,
            π obeys a mask whenever the data have one.
        logits_key: the entry with the logits [*batch, n_actions].
        action_mask_key: the entry with the mask.
    """

    def __init__(
        self,
        policy: TensorDictModule,
        *,
        masked: bool = False,
        logits_key: NestedKey = "logits",
        action_mask_key: NestedKey = "action_mask",
    ) -> None:
        self.masked, self.logits_key, self.action_mask_key = masked, logits_key, action_mask_key
        keys = {"logits": logits_key, **({"mask": action_mask_key} if masked else {})}
        super().__init__(
            policy,
            in_keys=keys,  # pyright: ignore[reportArgumentType] - a dict is allowed
            distribution_class=SoftmaxCategorical,
        )


class DiagonalGaussian(IndependentNormal):
    """π = N(loc, diag(scale²)), as TorchRL's ``IndependentNormal``, with sums in a fixed order.

    Args:
        loc: [*batch, n_dims].
        scale: [*batch, n_dims], > 0.
    """

    def __init__(self, loc: Tensor, scale: Tensor) -> None:
        super().__init__(loc, scale, validate_args=False)

    def log_prob(self, value: Tensor) -> Tensor:
        """Log density [*batch] of ``value`` [*batch, n_dims], which broadcasts."""
        normal = self.base_dist
        return gaussian_log_prob(*torch.broadcast_tensors(value, normal.loc, normal.scale))

    def entropy(self) -> Tensor:
        """Differential entropy [*batch] of π before clipping of actions (nats)."""
        return gaussian_entropy(self.base_dist.scale)


class GaussianActor(ProbabilisticActor):
    """The target policy π = N(loc, diag(scale²)), on top of a module that writes "loc" and "scale".

    Like ``SoftmaxActor``, it shares its parameters with ``policy`` and is for the loss.

    Args:
        policy: a module that writes "loc" and "scale" [*batch, n_dims].
    """

    def __init__(self, policy: TensorDictModule) -> None:
        super().__init__(policy, in_keys=["loc", "scale"], distribution_class=DiagonalGaussian)


def actor_of(policy: TensorDictModule) -> ProbabilisticActor:
    """The target policy as a distribution, chosen by the entries that the policy writes.

    "logits" give a softmax; "loc" and "scale" give a Gaussian.

    Raises:
        ValueError: if the policy writes neither.
    """
    written = set(policy.out_keys)
    if "logits" in written:
        return SoftmaxActor(policy)
    if {"loc", "scale"} <= written:
        return GaussianActor(policy)
    raise ValueError(
        f"a policy must write logits, or loc and scale; {type(policy).__name__} writes "
        f"{', '.join(map(str, policy.out_keys))}"
    )


def frame_log_prob(
    actor: ProbabilisticTensorDictSequential, tensordict: TensorDictBase, action: Tensor
) -> Tensor:
    """Log π(a|s) of every frame, with its gradient.

    ``action`` [frames, ...] are indices or one-hot for a categorical π.

    Returns:
        [frames, ...]: one number per frame, or several that belong to one action each, such as
        those of the agents.

    Raises:
        ValueError: if the actions do not fit the distribution.
    """
    distribution: Any = frame_distribution(actor, tensordict)
    if isinstance(distribution, CompositeDistribution):
        found: Any = distribution.log_prob(tensordict)
        if not is_tensor_collection(found):
            return found
        parts: Any = list(found.values(True, True))
        if len({part.shape for part in parts}) > 1:
            parts = [part.reshape(len(part), -1).sum(-1) for part in parts]
        return torch.stack(parts).sum(0)
    shape = distribution.batch_shape + distribution.event_shape
    indexed = type(distribution) in INDEXED
    found = fitted(action, shape, distribution.param_shape[-1] if indexed else None)
    if not indexed or found.shape == shape:
        log_prob = distribution.log_prob(found)
        if log_prob.shape == distribution.batch_shape:
            return log_prob
    raise ValueError(
        f"the actions are {list(action.shape)}, but those of the actor are {list(shape)}"
    )


INDEXED = (SoftmaxCategorical, TorchCategorical, MaskedCategorical)
"""The distributions over n actions that take the index of the action."""


def fitted(action: Tensor, shape: torch.Size, n_actions: int | None = None) -> Tensor:
    """The actions in a shape, so that [n] and [n, 1] do not broadcast to [n, n].

    One-hot actions [*shape, n_actions] become indices; others are reshaped if their number fits.

    Example:
        >>> fitted(torch.tensor([[0, 1], [1, 0]]), torch.Size([2]), 2).tolist()
        [1, 0]
    """
    if action.shape == shape:
        return action
    if n_actions is not None and action.shape == (*shape, n_actions):
        return action.long().argmax(-1)
    return action.reshape(shape) if action.numel() == shape.numel() else action


def frame_distribution(
    actor: ProbabilisticTensorDictSequential, tensordict: TensorDictBase
) -> Distribution:
    """π(·|s) of every frame; a softmax obeys an action mask if the data have one.

    Raises:
        KeyError: if an entry is missing.
        ValueError: if the mask allows only actions of logit −∞, or has another shape.
    """
    # On a copy, because the actor writes to its input.
    if not is_softmax(actor):
        return actor.get_dist(tensordict.copy())
    mask = tensordict.get(actor.action_mask_key, None)
    if actor.masked and mask is None:
        raise KeyError(f"missing key: {actor.action_mask_key!r}")
    logits = actor[0](tensordict.copy()).get(actor.logits_key)
    return SoftmaxCategorical(logits, mask)


def frame_entropy(actor: ProbabilisticTensorDictSequential, tensordict: TensorDictBase) -> Tensor:
    """H(π(·|s)) of every frame (nats), shaped as ``frame_log_prob``.

    Raises:
        ValueError: if the distribution has no entropy in closed form.
    """
    distribution: Any = frame_distribution(actor, tensordict)
    try:
        return distribution.entropy()
    except NotImplementedError:
        name = type(distribution).__name__
        raise ValueError(f"entropy_coeff must be 0: {name} has no entropy in closed form") from None


def has_linear_softmax(actor: ProbabilisticTensorDictSequential) -> bool:
    """Whether π = softmax(W[trial] observation), whose gradient has a closed form.

    The policy declares it in ``linear_softmax``. False with forward hooks, which may change the
    logits, and for a policy that holds another module.
    """
    if not is_softmax(actor) or actor.masked:
        return False
    policy: Any = actor[0]
    if not getattr(policy, "linear_softmax", False) or has_hooks(policy):
        return False
    if not holds(policy, "linear_softmax", ["forward"]):
        return False
    if type(policy).forward is not LinearPolicy.forward:
        return True  # a class that says so itself
    return type(policy.module) is LaneLinear and policy.module.bias is None


def is_softmax(actor: ProbabilisticTensorDictSequential) -> TypeGuard[SoftmaxActor]:
    """Whether π is the softmax of what the policy writes; a subclass may change ``get_dist``."""
    own = "get_dist" not in vars(actor) and type(actor).get_dist is SoftmaxActor.get_dist
    return own and isinstance(actor, SoftmaxActor)
