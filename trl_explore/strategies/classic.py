"""The classic strategies: random, argmax, ε-greedy, softmax, and other mixtures of them."""

from __future__ import annotations

from typing import Unpack

from torch import Tensor

from trl_explore.strategies.discrete import Options
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
        options: the arguments of ``Strategy``, such as ``spec`` and ``logits_key``.

    Raises:
        ValueError: if ε leaves [0, 1] in any iteration.

    Example:
        >>> import torch
        >>> EpsilonGreedy(0.2).probs(torch.tensor([0.0, 4.0, -1.0, 4.0]))
        tensor([0.0500, 0.4500, 0.0500, 0.4500])
    """

    epsilon: Tensor

    def __init__(self, epsilon: Parameter = 0.3, **options: Unpack[Options]) -> None:
        super().__init__(**options)
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

    def __init__(self, decay: float = 0.99, **options: Unpack[Options]) -> None:
        super().__init__(Exponential(1.0, decay), **options)


class Softmax(MixtureStrategy):
    """Softmax of the logits at a temperature; at T = 1 it is the policy, and data are on-policy.

    μ(a|s) = exp(logits_a / T) / Σ_b exp(logits_b / T)      (Sutton & Barto, §2.8; thesis, §2.2.5)

    The thesis prints exp(x^T) but means x / T. T → 0 gives argmax, T → ∞ uniform.

    Args:
        temperature: T > 0, a number, one number per trial, or a schedule, which may reach the
            limit 0: argmax.
        options: the arguments of ``Strategy``, such as ``spec`` and ``logits_key``.

    Raises:
        ValueError: if T is not a positive number.

    Example:
        >>> import torch
        >>> Softmax(temperature=2.0).probs(torch.tensor([0.0, 2.0])).sum()
        tensor(1.)
    """

    differentiable = True
    temperature: Tensor

    def __init__(self, temperature: Parameter = 1.0, **options: Unpack[Options]) -> None:
        super().__init__(**options)
        self.follow("temperature", temperature, low_open=True)

    def mixture(self) -> Mixture:
        """All weight on softmax."""
        return Mixture(softmax=1.0, temperature=self.now("temperature"))


class EpsilonSoftmax(MixtureStrategy):
    """Softmax at a temperature with weight 1 − ε, uniform with weight ε.

    μ(a|s) = (1 − ε) · softmax(logits / T)_a + ε / n_actions

    The ε-soft form of the softmax policy (Sutton & Barto, §5.4: every action has at least
    ε / n_actions). At T = 1 the ratio π/μ is at most 1 / (1 − ε).

    Args:
        epsilon: ε in [0, 1], a number, one number per trial, or a schedule.
        temperature: T > 0, in the same forms; a schedule may reach 0, the limit.
        options: the arguments of ``Strategy``.

    Raises:
        ValueError: if ε leaves [0, 1] in any iteration, or T is not a positive number.

    Example:
        >>> import math, torch
        >>> EpsilonSoftmax(0.2).probs(torch.tensor([0.0, math.log(3)]))
        tensor([0.3000, 0.7000])
    """

    differentiable = True
    epsilon: Tensor
    temperature: Tensor

    def __init__(
        self, epsilon: Parameter = 0.1, temperature: Parameter = 1.0, **options: Unpack[Options]
    ) -> None:
        super().__init__(**options)
        self.follow("epsilon", epsilon, 0, 1)
        self.follow("temperature", temperature, low_open=True)

    def mixture(self) -> Mixture:
        """Softmax with weight 1 − ε, uniform with weight ε."""
        epsilon = self.now("epsilon")
        return Mixture(0.0, 1 - epsilon, epsilon, self.now("temperature"))


class MaxBoltzmann(MixtureStrategy):
    """Argmax with weight 1 − ε, softmax at a temperature with weight ε.

    μ(a|s) = (1 − ε) · 1[a ∈ A*] / |A*| + ε · softmax(logits / T)_a

    (Wiering 1999, "Explorations in Efficient Reinforcement Learning", chapter 5, the Max-Boltzmann
    rule). T → ∞ gives ε-greedy, ε = 1 softmax.

    Args:
        epsilon: ε in [0, 1], a number, one number per trial, or a schedule.
        temperature: T > 0, in the same forms; a schedule may reach 0, the limit.
        options: the arguments of ``Strategy``.

    Raises:
        ValueError: if ε leaves [0, 1] in any iteration, or T is not a positive number.

    Example:
        >>> import math, torch
        >>> MaxBoltzmann(0.4).probs(torch.tensor([0.0, math.log(3)]))
        tensor([0.1000, 0.9000])
    """

    epsilon: Tensor
    temperature: Tensor

    def __init__(
        self, epsilon: Parameter = 0.3, temperature: Parameter = 1.0, **options: Unpack[Options]
    ) -> None:
        super().__init__(**options)
        self.follow("epsilon", epsilon, 0, 1)
        self.follow("temperature", temperature, low_open=True)

    def mixture(self) -> Mixture:
        """Argmax with weight 1 − ε, softmax with weight ε."""
        epsilon = self.now("epsilon")
        return Mixture(1 - epsilon, epsilon, 0.0, self.now("temperature"))


class FullMixture(MixtureStrategy):
    """Argmax, softmax and uniform, each with its own weight.

    μ(a|s) = (w_g · 1[a ∈ A*] / |A*| + w_s · softmax(logits / T)_a + w_u / n_actions) / W
    with W = w_g + w_s + w_u

    The weights are relative: they are divided by their sum in every iteration, so each may follow
    its own schedule. Every strategy of the thesis is a special case.

    Args:
        greedy: w_g >= 0, a number, one number per trial, or a schedule.
        softmax: w_s >= 0, in the same forms.
        uniform: w_u >= 0, in the same forms.
        temperature: T > 0, in the same forms; a schedule may reach 0, the limit.
        options: the arguments of ``Strategy``.

    Raises:
        ValueError: if a weight is negative, T is not a positive number, or all weights are 0.

    Example:
        >>> import torch
        >>> FullMixture(greedy=2, softmax=0, uniform=2).probs(torch.tensor([0.0, 4.0]))
        tensor([0.2500, 0.7500])
    """

    greedy: Tensor
    softmax: Tensor
    uniform: Tensor
    temperature: Tensor

    def __init__(
        self,
        greedy: Parameter = 0.4,
        softmax: Parameter = 0.4,
        uniform: Parameter = 0.2,
        temperature: Parameter = 1.0,
        **options: Unpack[Options],
    ) -> None:
        super().__init__(**options)
        for name, weight in {"greedy": greedy, "softmax": softmax, "uniform": uniform}.items():
            self.follow(name, weight)
        self.follow("temperature", temperature, low_open=True)
        self._check_weights()

    @property
    def differentiable(self) -> bool:
        """Whether the weight of argmax is 0 in every iteration."""
        return self.schedules["greedy"].bounds[1] == 0

    def mixture(self) -> Mixture:
        """The weights divided by their sum."""
        greedy, softmax, uniform = map(self.now, ("greedy", "softmax", "uniform"))
        total = greedy + softmax + uniform
        return Mixture(greedy / total, softmax / total, uniform / total, self.now("temperature"))

    def _refresh(self) -> None:
        super()._refresh()
        self._check_weights()

    def _check_weights(self) -> None:
        weights = [self.greedy, self.softmax, self.uniform]
        sizes = sorted({len(w) for w in weights if w.ndim})
        if len(sizes) > 1:
            raise ValueError(
                "greedy, softmax and uniform must have equally many values per trial, "
                f"got weights with {sizes} values"
            )
        total = self.greedy + self.softmax + self.uniform
        if not bool(((total > 0) & total.isfinite()).all()):
            raise ValueError(
                "greedy + softmax + uniform must be a positive number, "
                f"got {total.tolist()} in iteration {int(self.iteration)}"
            )
