"""The target policy π as a distribution, for the loss; it excludes exploration."""

from __future__ import annotations

from functools import cached_property
from typing import Any, TypeGuard

import torch
from tensordict import TensorDictBase, is_tensor_collection
from tensordict.nn import (
    CompositeDistribution,
    ProbabilisticTensorDictSequential,
    TensorDictModule,
)
from torch import Tensor
from torch.distributions import Categorical as TorchCategorical
from torch.distributions import Distribution
from torchrl.modules import IndependentNormal, ProbabilisticActor

from trl_explore.checks import holds
from trl_explore.numerics.densities import categorical_log_prob, gaussian_entropy, gaussian_log_prob
from trl_explore.numerics.score import lane_sum
from trl_explore.policies.policy import LaneLinear, has_hooks
from trl_explore.policies.softmax import LinearPolicy


class SoftmaxCategorical(TorchCategorical):
    """π = softmax(logits) over actions; like torch's Categorical, but faster for log π(a|s).

    Args:
        logits: [*batch, n_actions], may be unnormalised.
        mask: [*batch, n_actions] bool, False where an action is not allowed (probability 0).
    """

    def __init__(self, logits: Tensor, mask: Tensor | None = None) -> None:
        self._unnormalised = logits if mask is None else logits.masked_fill(~mask, -torch.inf)
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


class SoftmaxActor(ProbabilisticActor):
    """The target policy π = softmax(logits), on top of a module that writes "logits".

    It shares its parameters with ``policy`` and is for the loss (``get_dist``). In the environment,
    the behaviour policy is the policy followed by a strategy.

    Args:
        policy: a module that writes "logits".
        masked: whether "action_mask" [*batch, n_actions] is a required input of the actor. In the
            loss, π obeys a mask whenever the data have one.
    """

    def __init__(self, policy: TensorDictModule, *, masked: bool = False) -> None:
        self.masked = masked
        keys = {"logits": "logits", **({"mask": "action_mask"} if masked else {})}
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
    """Log π(a|s) of every frame [frames], with its gradient.

    Args:
        actor: the target policy, any ``ProbabilisticActor``.
        tensordict: flat frames [frames] with the entries that the actor reads.
        action: [frames, ...].

    Raises:
        ValueError: if the actor gives more than one log-probability per frame.
    """
    distribution: Any = frame_distribution(actor, tensordict)
    composite = isinstance(distribution, CompositeDistribution)
    log_prob = distribution.log_prob(tensordict if composite else action)
    if is_tensor_collection(log_prob):
        log_prob = torch.stack([*log_prob.values(True, True)]).sum(0)
    if log_prob.numel() != len(tensordict):
        raise ValueError(
            f"log π is {list(log_prob.shape)} for {len(tensordict)} frames; a distribution over "
            "several action dimensions must sum them (torch.distributions.Independent)"
        )
    return log_prob.reshape(-1)


def frame_distribution(
    actor: ProbabilisticTensorDictSequential, tensordict: TensorDictBase
) -> Distribution:
    """π(·|s) of every frame; it obeys an action mask if the data have one."""
    # On a copy, because the actor writes to its input.
    if not is_softmax(actor):
        return actor.get_dist(tensordict.copy())
    mask = tensordict.get("action_mask", None)
    if actor.masked and mask is None:
        raise KeyError("missing key: 'action_mask'")
    return SoftmaxCategorical(actor[0](tensordict.copy()).get("logits"), mask)


def score_sum(
    actor: ProbabilisticTensorDictSequential,
    tensordict: TensorDictBase,
    action: Tensor,
    advantage: Tensor,
    trial: Tensor,
    trials: int,
) -> Tensor:
    """S_k = Σ_{i: trial_i = k} A_i log π(a_i|s_i), whose gradient is the policy gradient.

    Args:
        actor: the target policy, any ``ProbabilisticActor``.
        tensordict: flat frames [frames] with the entries that the actor reads.
        action: [frames, ...].
        advantage: A, a factor per frame [frames], without gradient.
        trial: [frames] int64 in [0, trials).
        trials: the number of trials.

    Returns:
        S [trials].

    Raises:
        ValueError: if the actor gives more than one log-probability per frame.
    """
    log_prob = frame_log_prob(actor, tensordict, action)
    return lane_sum(log_prob * advantage, trial, trials)


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
