"""The gradient of the behaviour policy itself."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import Tensor
from torch.distributions import Categorical, Distribution
from torchrl.modules import ProbabilisticActor

from trl_explore.objectives.corrections.correction import NoCorrection
from trl_explore.strategies import BaseStrategy, ContinuousStrategy, Strategy


class Behaviour(NoCorrection):
    """A_t = G_t − b_t, and ∇log μ(a_t|s_t) in the place of ∇log π(a_t|s_t).

    The agent is then μ, and the gradient that of μ's own return: on-policy, and unbiased (at
    γ = 1, or with the factor γ^t), with no ratio and its variance. It exists where μ depends
    differentiably on the logits: softmax at a temperature, and mixtures of it with the uniform
    corner (ε-softmax); not with a share of argmax, whose probabilities are piecewise constant.
    Where μ does not follow the policy at all (uniform, or ε = 1 in an iteration) it is 0. An
    entropy bonus in the loss is then that of μ, too.

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
        """μ, as a function of the parameters of π."""
        if strategy is None or not strategy.differentiable:
            name = "no strategy" if strategy is None else type(strategy).__name__
            raise ValueError(
                f"{type(self).__name__} needs probabilities differentiable in the "
                f"{'logits' if isinstance(strategy, Strategy) else 'policy'}; {name} has none"
            )
        if isinstance(strategy, ContinuousStrategy):
            return ContinuousBehaviourActor(actor, strategy)
        assert isinstance(strategy, Strategy)
        return BehaviourActor(actor, strategy)


class BehaviourActor(ProbabilisticActor):
    """μ(·|s) as a distribution whose parameters are those of the target policy.

    Args:
        actor: the target policy, whose first module writes "logits".
        strategy: states μ for logits; shared with the collector, so that both are in the same
            iteration of their schedules.
    """

    def __init__(self, actor: ProbabilisticActor, strategy: Strategy) -> None:
        super().__init__(
            TensorDictSequential(actor[0], _Probs(strategy)),  # pyright: ignore[reportArgumentType]
            in_keys=["probs"],
            distribution_class=Categorical,
            distribution_kwargs={"validate_args": False},
        )


class ContinuousBehaviourActor(ProbabilisticActor):
    """The density of μ(·|s) over continuous actions, whose parameters are those of the target.

    Args:
        actor: the target policy, whose first module writes "loc" and "scale".
        strategy: states log μ for them; shared with the collector.
    """

    def __init__(self, actor: ProbabilisticActor, strategy: ContinuousStrategy) -> None:
        super().__init__(
            actor[0],  # pyright: ignore[reportArgumentType]
            in_keys=["loc", "scale", "trial"],
            distribution_class=_Density,
            distribution_kwargs={"strategy": strategy},
        )


class _Density(Distribution):
    """What a continuous strategy says of its density."""

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
            f"the entropy of {type(self.strategy).__name__} has no formula; "
            "correction=behaviour needs entropy_coeff=0 here"
        )


class _Probs(TensorDictModuleBase):
    """Writes "probs" [*batch, n_actions], μ for the "logits"."""

    def __init__(self, strategy: Strategy) -> None:
        super().__init__()
        self.in_keys = ["logits", "trial"]  # pyright: ignore[reportAttributeAccessIssue]
        self.out_keys = ["probs"]  # pyright: ignore[reportAttributeAccessIssue]
        self.probs = strategy.probs

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        logits, mask = tensordict.get("logits"), tensordict.get("action_mask", None)
        if mask is not None:
            logits = logits.masked_fill(~mask, -torch.inf)
        probs = self.probs(logits, tensordict.get("trial"))
        return tensordict.set("probs", _connected(probs, logits))


def _connected(found: Tensor, source: Tensor) -> Tensor:
    """``found``; its gradient is 0, and not missing, where it does not depend on ``source``."""
    if found.requires_grad or not source.requires_grad:
        return found
    return found + 0 * source.masked_fill(source == -torch.inf, 0)
