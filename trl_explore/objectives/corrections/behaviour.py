"""The gradient of the behaviour policy μ."""

from __future__ import annotations

from typing import Any, cast

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import Tensor
from torch.distributions import Categorical, Distribution, Independent
from torchrl.modules import ProbabilisticActor

from trl_explore.objectives.corrections.correction import NoCorrection
from trl_explore.strategies import BaseStrategy, ContinuousStrategy, Strategy


class Behaviour(NoCorrection):
    """A_t = G_t − b_t, and ∇log μ(a_t|s_t) in place of ∇log π(a_t|s_t).

    The agent is then μ, and the gradient is that of μ's own return: on-policy, unbiased (at γ = 1,
    or with the factor γ^t), and without a ratio and its variance. It exists if μ is differentiable
    in the logits: softmax at a temperature, and its mixtures with uniform (ε-softmax). It does not
    exist with a share of argmax, whose probabilities are piecewise constant. If μ does not depend
    on the policy (uniform, or ε = 1 in an iteration), the gradient is 0. An entropy bonus in the
    loss is then also that of μ.

    Example:
        >>> from trl_explore.strategies import Argmax
        >>> Behaviour().actor(None, Argmax())
        Traceback (most recent call last):
        ...
        ValueError: Behaviour needs probabilities differentiable in the logits; Argmax has none
    """

    def actor(
        self, actor: ProbabilisticActor, strategy: BaseStrategy | None = None
    ) -> ProbabilisticActor:
        """μ as a function of the parameters of π."""
        if strategy is None or not strategy.differentiable:
            name = "no strategy" if strategy is None else type(strategy).__name__
            raise ValueError(
                f"{type(self).__name__} needs probabilities differentiable in the "
                f"{'logits' if isinstance(strategy, Strategy) else 'policy'}; {name} has none"
            )
        if strategy.is_target():
            return actor
        if isinstance(strategy, ContinuousStrategy):
            return _continuous(actor, strategy)
        return _discrete(actor, cast(Strategy, strategy))


def _discrete(actor: ProbabilisticActor, strategy: Strategy) -> ProbabilisticActor:
    """μ(·|s) over n actions as a distribution with the parameters of the target policy."""
    networks: Any = [*actor.module[:-1], _Probs(strategy)]
    return ProbabilisticActor(
        cast(Any, TensorDictSequential(*networks)),
        in_keys=["probs"],
        distribution_class=_Heads if strategy.joint else Categorical,
        distribution_kwargs={"strategy": strategy} if strategy.joint else {"validate_args": False},
    )


class _Heads(Independent):
    """Several heads, each of which draws an action of its own."""

    def __init__(self, probs: Tensor, strategy: Strategy) -> None:
        super().__init__(Categorical(probs, validate_args=False), 1, validate_args=False)
        self.index = strategy.index

    def log_prob(self, value: Tensor) -> Tensor:
        return super().log_prob(self.index(value))


def _continuous(actor: ProbabilisticActor, strategy: ContinuousStrategy) -> ProbabilisticActor:
    """The density of μ(·|s) over continuous actions, with the parameters of the target policy."""
    networks: Any = actor.module[:-1]
    keys: Any = {
        "loc": strategy.loc_key,
        "scale": strategy.scale_key,
        "trial": strategy.trial_key,
    }
    return ProbabilisticActor(
        cast(Any, TensorDictSequential(*networks)),
        in_keys=keys,
        distribution_class=_Density,
        distribution_kwargs={"strategy": strategy},
    )


class _Density(Distribution):
    """The density of a continuous strategy as a torch distribution."""

    def __init__(
        self, loc: Tensor, scale: Tensor, trial: Tensor, strategy: ContinuousStrategy
    ) -> None:
        super().__init__(loc.shape[:-1], loc.shape[-1:], validate_args=False)
        self.parameters, self.strategy = (loc, scale, trial), strategy

    def log_prob(self, value: Tensor) -> Tensor:
        log_prob = self.strategy.log_prob(value, *self.parameters)
        loc, scale, _ = self.parameters
        return _connected(log_prob, (loc + scale).sum(-1))

    def entropy(self) -> Tensor:
        raise ValueError(
            f"correction=behaviour needs entropy_coeff=0 with {type(self.strategy).__name__}: "
            "its entropy has no closed form"
        )


class _Probs(TensorDictModuleBase):
    """Writes "probs" [*batch, n_actions]: μ for the logits that the strategy reads."""

    def __init__(self, strategy: Strategy) -> None:
        super().__init__()
        self.in_keys = [strategy.logits_key]  # pyright: ignore[reportAttributeAccessIssue]
        self.out_keys = ["probs"]  # pyright: ignore[reportAttributeAccessIssue]
        self.probs_of = strategy.probs_of  # a function: the strategy is no part of the actor

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        probs = self.probs_of(tensordict)
        return tensordict.set("probs", _connected(probs, tensordict.get(self.in_keys[0])))


def _connected(found: Tensor, source: Tensor) -> Tensor:
    """``found``, with gradient 0 instead of none if it does not depend on ``source``."""
    if found.requires_grad or not source.requires_grad:
        return found
    return found + 0 * source.masked_fill(source == -torch.inf, 0)
