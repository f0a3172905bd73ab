"""Random, argmax, and ε-greedy between them."""

from __future__ import annotations

from typing import Any

from tensordict import NestedKey
from torch import Tensor
from torchrl.data import TensorSpec

from trl_explore.strategies.mixture import Mixture, MixtureStrategy
from trl_explore.strategies.schedules import Exponential, Parameter


class Random(MixtureStrategy):
    """Uniform over the actions, independent of the policy.

    μ(a|s) = 1 / n_actions      (thesis, §2.2.1)

    Example:
        >>> import torch
        >>> Random().probs(torch.tensor([0.0, 3.0]))
        tensor([0.5000, 0.5000])
    """

    differentiable = True

    def mixture(self) -> Mixture:
        """All weight on uniform."""
        return Mixture(uniform=1.0)


class Argmax(MixtureStrategy):
    """The action of largest logit; ties share.

    μ(a|s) = 1[a ∈ A*] / |A*|,   A* = argmax_a logits_a      (thesis, §2.2.2)

    Example:
        >>> import torch
        >>> Argmax().probs(torch.tensor([0.0, 4.0, -1.0, 4.0]))
        tensor([0.0000, 0.5000, 0.0000, 0.5000])
    """

    def mixture(self) -> Mixture:
        """All weight on argmax."""
        return Mixture(greedy=1.0)


class EpsilonGreedy(MixtureStrategy):
    """Argmax with weight 1 − ε, uniform with weight ε.

    μ(a|s) = (1 − ε) · 1[a ∈ A*] / |A*| + ε / n_actions      (Sutton & Barto, §2.2; thesis, §2.2.3)

    Args:
        epsilon: ε in [0, 1], a number, one number per trial, or a schedule.
        spec: the action spec (``Categorical``, ``OneHot``, ``MultiCategorical`` or ``MultiOneHot``,
            possibly in a ``Composite``); None: actions are indices.
        logits_key: the entry with the logits or action values.
        action_key: the entry to write the action to.
        action_mask_key: the entry with the mask; None: "action_mask" in the group of the action.
        log_prob_key: the entry to write the log-probability to; None: beside the action, with the
            suffix "_log_prob".
        noise_key: the entry with uniform numbers in [0, 1) that decide the draw; None: torch's
            generator decides it.
        trial_key: the entry with the trial of each frame, if ε has one value per trial.
        validate_args: whether to check that every state has an allowed action with a finite logit.

    Raises:
        ValueError: if ε leaves [0, 1] in any iteration, the spec is of another kind, or a state has
            no action to draw.

    Example:
        >>> import torch
        >>> EpsilonGreedy(0.2).probs(torch.tensor([0.0, 4.0, -1.0, 4.0]))
        tensor([0.0500, 0.4500, 0.0500, 0.4500])
    """

    epsilon: Tensor

    def __init__(
        self,
        epsilon: Parameter = 0.3,
        *,
        spec: TensorSpec | None = None,
        logits_key: NestedKey = "logits",
        action_key: NestedKey = "action",
        action_mask_key: NestedKey | None = None,
        log_prob_key: NestedKey | None = None,
        noise_key: NestedKey | None = None,
        trial_key: NestedKey = "trial",
        validate_args: bool = True,
    ) -> None:
        super().__init__(
            spec=spec,
            logits_key=logits_key,
            action_key=action_key,
            action_mask_key=action_mask_key,
            log_prob_key=log_prob_key,
            noise_key=noise_key,
            trial_key=trial_key,
            validate_args=validate_args,
        )
        self.follow("epsilon", epsilon, 0, 1)

    def mixture(self) -> Mixture:
        """Argmax with weight 1 − ε, uniform with weight ε."""
        epsilon = self.now("epsilon")
        return Mixture(greedy=1 - epsilon, uniform=epsilon)


class DecayingEpsilonGreedy(EpsilonGreedy):
    """ε-greedy with ε_i = decay^i in iteration i = 0, 1, ...      (thesis, §2.2.4, appendix A.4).

    Short for ``EpsilonGreedy(Exponential(1.0, decay))``.

    Args:
        decay: the factor per iteration, in [0, 1].
        options: the arguments of ``Strategy``.

    Raises:
        ValueError: if ``decay`` is not in [0, 1].
    """

    def __init__(self, decay: float = 0.99, **options: Any) -> None:
        super().__init__(Exponential(1.0, decay), **options)
