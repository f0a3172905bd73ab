"""Mixtures of argmax, softmax and uniform; the thesis's five strategies are special cases."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from functools import reduce
from operator import add
from typing import Any, ClassVar, NamedTuple, cast

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from trl_explore.checks import holds, settle
from trl_explore.strategies.schedules import Schedule, Value
from trl_explore.strategies.strategy import Strategy, numbers, present, rows


class Mixture(NamedTuple):
    """The weights and temperature in one iteration; each a number [], or one per trial [trials].

    The weights are non-negative and sum to 1; the temperature is >= 0, where 0 is the limit. A
    part whose weight is the Python number 0 is never computed.
    """

    greedy: Value | Tensor = 0.0
    softmax: Value | Tensor = 0.0
    uniform: Value | Tensor = 0.0
    temperature: Value | Tensor = 1.0


class MixtureStrategy(Strategy):
    """A mixture of argmax, softmax and uniform.

    μ(a|s) = w_greedy · 1[a ∈ A*] / |A*| + w_softmax · softmax(logits / T)_a + w_uniform / n

    with A* the actions of largest logit (ties share) and n the number of actions that the mask
    allows. A subclass returns the weights and T for the current iteration from ``mixture``.

    Attributes:
        compilable: whether ``mixture`` and ``behaviour_parameters`` fully determine μ, so that a
            collector may compile the strategy. False in a class that overrides one of the methods
            in ``REPLACED``, which compiled code does not call, unless the class declares it.
        mixes_policy: whether ``mixture`` mixes the logits of the target policy itself. False in a
            class that overrides one of the methods in ``REPLACED``, unless the class declares it.
    """

    REPLACED = ("forward", "explore", "preferences", "probs")
    compilable: ClassVar[bool] = True
    mixes_policy: ClassVar[bool] = True

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        settle(cls, "compilable", False, cls.REPLACED)
        settle(cls, "mixes_policy", False, cls.REPLACED)

    @abstractmethod
    def mixture(self) -> Mixture:
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
        self.checked_mixture(trials)

    def on_policy(self) -> bool | NDArray[np.bool_]:
        """Whether μ = softmax(logits): the mixture is softmax alone, at T = 1."""
        mixed = holds(self, "mixes_policy", self.REPLACED)
        return mixed and self.mixes_policy and is_softmax_alone(Mixture(*numbers(self.mixture())))

    def checked_mixture(self, trials: int) -> Mixture:
        """The mixture of the current iteration as numbers, checked for ``trials`` trials.

        Raises:
            ValueError: if a per-trial entry does not have one value for every trial, or the
                weights are negative or do not sum to 1.
        """
        point = Mixture(*numbers(self.mixture()))
        for name, value in zip(Mixture._fields, point, strict=True):
            if not isinstance(value, float) and np.shape(value) not in ((), (trials,)):
                raise ValueError(
                    f"{name} has {np.size(value)} values, but there are {trials} trials"
                )
        weights = point[:3]
        negative = any([w < 0 if isinstance(w, float) else np.any(w < 0) for w in weights])  # noqa: C419 - faster
        error = abs(sum(weights) - 1.0)
        if negative or not (error <= 1e-6 if isinstance(error, float) else np.all(error <= 1e-6)):
            raise ValueError(
                f"{type(self).__name__}: the weights of a mixture must be >= 0 and sum to 1, got "
                f"{point.greedy}, {point.softmax} and {point.uniform}"
            )
        return point

    def behaviour_parameters(self, parameters: Sequence[Tensor]) -> list[Tensor]:
        """The parameters with which the policy's logits equal the strategy's ``preferences``.

        A strategy that overrides ``preferences`` is compilable only if it overrides this too.

        Args:
            parameters: parameters of the target policy given to ``bind``.
        """
        return list(parameters)

    def probs(self, logits: Tensor, trial: Tensor | None = None) -> Tensor:
        """μ(·|s) [*batch, n_actions] in the current iteration."""
        mixture = Mixture(*(rows(value, trial, logits) for value in self.mixture()))
        return mixture_probs(logits, mixture)


def is_softmax_alone(mixture: Mixture) -> bool | NDArray[np.bool_]:
    """Whether a mixture of numbers is softmax at T = 1; one value, or one per trial.

    Example:
        >>> is_softmax_alone(Mixture(softmax=1.0)), is_softmax_alone(Mixture(greedy=1.0))
        (True, False)
        >>> is_softmax_alone(Mixture(softmax=1.0, temperature=np.array([1.0, 0.5])))
        array([ True, False])
    """
    others = np.equal(mixture.greedy, 0) & np.equal(mixture.uniform, 0)
    found = others & np.equal(mixture.temperature, 1)
    return found if isinstance(found, np.ndarray) else bool(found)


def mixture_probs(logits: Tensor, mixture: Mixture) -> Tensor:
    """The probabilities [*batch, n_actions] of a mixture, whose entries broadcast to ``logits``.

    NaN in a row without a logit above −∞, if the mixture uses the logits' order or their −∞.

    Example:
        >>> mixture_probs(torch.tensor([0.0, 4.0, -1.0, 4.0]), Mixture(greedy=0.8, uniform=0.2))
        tensor([0.0500, 0.4500, 0.0500, 0.4500])
    """
    terms: list[Tensor] = []
    limits = torch.finfo(logits.dtype)
    soft, uniform = present(mixture.softmax), present(mixture.uniform)
    if not soft and logits.shape[-1] <= 8 and logits.numel() > 1000:
        # With the actions outermost in memory, torch works on many frames at a time.
        logits = logits.movedim(-1, 0).contiguous().movedim(0, -1)
    largest = logits.amax(-1, keepdim=True)
    if present(mixture.greedy):
        # A row of −∞ has no best action; the other parts find that by themselves.
        floor = largest if soft or uniform else largest.clamp(min=limits.min)
        terms.append(_share(logits >= floor, logits.dtype, mixture.greedy))
    if soft:
        # To avoid overflow, subtract the maximum first and keep T within the dtype's range.
        temperature = mixture.temperature
        if isinstance(temperature, Tensor):
            temperature = temperature.clamp(limits.tiny, limits.max)
        else:
            temperature = min(max(float(temperature), limits.tiny), limits.max)
        soft_max = torch.softmax((logits - largest) / temperature, -1)
        terms.append(soft_max * cast(Tensor, mixture.softmax))
    if uniform:
        terms.append(_share(logits >= limits.min, logits.dtype, mixture.uniform))
    return reduce(add, terms)


def _share(members: Tensor, dtype: torch.dtype, weight: Value | Tensor) -> Tensor:
    """A weight shared equally by some of the actions."""
    share = members.to(dtype)
    return share * (share.sum(-1, keepdim=True).reciprocal() * cast(Tensor, weight))


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


class Softmax(MixtureStrategy):
    """Softmax of the logits at a temperature; at T = 1 it is the policy, and data are on-policy.

    μ(a|s) = exp(logits_a / T) / Σ_b exp(logits_b / T)      (Sutton & Barto, §2.8; thesis, §2.2.5)

    The thesis prints exp(x^T) but means x / T. T → 0 gives argmax, T → ∞ uniform.

    Args:
        temperature: T > 0, a number, one number per trial, or a schedule of the iteration, which
            may reach 0, the limit: argmax.
        options: the arguments of ``Strategy``.

    Raises:
        ValueError: if T is not a positive number.

    Example:
        >>> import torch
        >>> Softmax(temperature=2.0).probs(torch.tensor([0.0, 2.0])).sum()
        tensor(1.)
    """

    differentiable = True
    temperature: Tensor

    def __init__(
        self, temperature: float | Sequence[float] | Schedule = 1.0, **options: Any
    ) -> None:
        super().__init__(**options)
        self.follow("temperature", temperature, 0, float("inf"), low_open=True)

    def mixture(self) -> Mixture:
        """All weight on softmax."""
        return Mixture(softmax=1.0, temperature=self.temperature)


Parameter = float | Sequence[float] | Schedule


class FullMixture(MixtureStrategy):
    """Argmax, softmax and uniform, each with its own weight.

    μ(a|s) = (w_g · 1[a ∈ A*] / |A*| + w_s · softmax(logits / T)_a + w_u / n_actions) / W
    with W = w_g + w_s + w_u

    The weights are relative: they are divided by their sum in every iteration, so each may follow
    its own schedule. Every strategy of the thesis is a special case.

    Args:
        greedy: w_g >= 0, a number, one number per trial, or a schedule of the iteration.
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

    learns_from_data = False
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
        **options: Any,
    ) -> None:
        super().__init__(**options)
        for name, weight in {"greedy": greedy, "softmax": softmax, "uniform": uniform}.items():
            self.follow(name, weight, 0, float("inf"))
        self.follow("temperature", temperature, 0, float("inf"), low_open=True)
        self._check_weights()

    @property
    def differentiable(self) -> bool:
        """Whether the weight of argmax is 0 in every iteration."""
        return self.schedules["greedy"].bounds[1] == 0

    def mixture(self) -> Mixture:
        """The weights divided by their sum."""
        total = self.greedy + self.softmax + self.uniform
        weights = self.greedy / total, self.softmax / total, self.uniform / total
        return Mixture(*weights, temperature=self.temperature)

    def step(self, frames: TensorDictBase | int | None = None) -> None:
        """Advance the schedules, and check that a weight is left."""
        super().step(frames)
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
