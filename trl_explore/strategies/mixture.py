"""Mixtures of argmax, softmax and uniform: weights, probabilities, ties."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple, cast

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from trl_explore.checks import holds, withdraw
from trl_explore.strategies.discrete import Strategy, actions_outermost
from trl_explore.strategies.frames import readable, rows
from trl_explore.strategies.schedules import Value
from trl_explore.strategies.strategy import BaseStrategy


class Mixture(NamedTuple):
    """The weights and temperature in one iteration; each a number [], or one per trial [trials].

    The weights are non-negative and sum to 1; the temperature is >= 0, where 0 is the limit. A
    part whose weight is the Python number 0 is never computed.
    """

    greedy: Value | Tensor = 0.0
    softmax: Value | Tensor = 0.0
    uniform: Value | Tensor = 0.0
    temperature: Value | Tensor = 1.0


class MixtureFamily(BaseStrategy):
    """What mixtures over n actions and over vectors have in common.

    A subclass returns the weights and the temperature for the current iteration from ``mixture``:
    a named tuple of the weight of the certain action, of the policy and of uniform, and T.

    Attributes:
        mixes_policy: whether ``mixture`` mixes the output of the target policy itself. False in a
            class that overrides one of the methods in ``REPLACED``, unless the class declares it.
    """

    REPLACED: ClassVar[tuple[str, ...]] = ()
    mixes_policy: ClassVar[bool] = True

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        withdraw(cls, "mixes_policy", False, cls.REPLACED)

    @abstractmethod
    def mixture(self) -> Any:
        """Weights and temperature in the current iteration."""

    def allocate(self, policy: TensorDictModuleBase, trials: int) -> None:
        """Check the mixture."""
        self.checked_mixture(trials)

    def on_policy(self) -> bool | NDArray[np.bool_]:
        """Whether μ = π: the mixture is the policy alone, at T = 1."""
        mixed = self.mixes_policy and holds(self, "mixes_policy", self.REPLACED)
        if not mixed:
            return False
        certain, _, uniform, temperature = numbers(self.mixture())
        found = np.equal(certain, 0) & np.equal(uniform, 0) & np.equal(temperature, 1)
        return found if isinstance(found, np.ndarray) else bool(found)

    def checked_mixture(self, trials: int) -> Any:
        """The mixture of the current iteration as numbers, checked for ``trials`` trials.

        Raises:
            ValueError: if a per-trial entry does not have one value for every trial, or the
                weights are negative or do not sum to 1.
        """
        mixture = self.mixture()
        if all([type(value) is float for value in mixture]):  # noqa: C419 - faster
            one, two, three = mixture[:3]
            if min(one, two, three) >= 0 and abs(one + two + three - 1.0) <= 1e-6:
                return mixture
        point = type(mixture)(*numbers(mixture))
        for name, value in point._asdict().items():
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
                f"{weights[0]}, {weights[1]} and {weights[2]}"
            )
        return point


class MixtureStrategy(MixtureFamily, Strategy):
    """A mixture of argmax, softmax and uniform.

    μ(a|s) = w_greedy · 1[a ∈ A*] / |A*| + w_softmax · softmax(logits / T)_a + w_uniform / n

    with A* the actions of largest logit (ties share) and n the number of actions that the mask
    allows. A subclass returns the weights and T for the current iteration from ``mixture``.

    Attributes:
        compilable: whether ``mixture`` and ``behaviour_parameters`` fully determine μ, so that a
            collector may compile the strategy. False in a class that overrides one of the methods
            in ``REPLACED``, which compiled code does not call, unless the class declares it.
    """

    REPLACED = ("forward", "explore", "preferences", "probs")
    compilable: ClassVar[bool] = True
    mixes_policy: ClassVar[bool] = True

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        withdraw(cls, "compilable", False, cls.REPLACED)

    def behaviour_parameters(self, parameters: Sequence[Tensor]) -> list[Tensor]:
        """The parameters with which the policy's logits equal the strategy's ``preferences``.

        A strategy that overrides ``preferences`` is compilable only if it overrides this too.
        """
        return list(parameters)

    def probs(self, logits: Tensor, trial: Tensor | None = None) -> Tensor:
        """μ(·|s) [*batch, n_actions] in the current iteration."""
        mixture = self.mixture()
        if self._reads_trial:
            mixture = Mixture(*(rows(value, trial, logits) for value in mixture))
        return mixture_probs(logits, mixture)


def mixture_probs(logits: Tensor, mixture: Mixture) -> Tensor:
    """The probabilities [*batch, n_actions] of a mixture, whose entries broadcast to ``logits``.

    NaN in a row without a logit above −∞, if the mixture uses the logits' order or their −∞.

    Example:
        >>> mixture_probs(torch.tensor([0.0, 4.0, -1.0, 4.0]), Mixture(greedy=0.8, uniform=0.2))
        tensor([0.0500, 0.4500, 0.0500, 0.4500])
    """
    limits, (greedy, soft, uniform, temperature) = torch.finfo(logits.dtype), mixture
    if not present(soft):
        logits = actions_outermost(logits)
    ordered = present(greedy) or present(soft)
    largest = logits.amax(-1, keepdim=True) if ordered else logits
    found = None
    if present(greedy) or present(uniform):
        found = _shares(logits, largest, greedy, uniform)
    if not present(soft):
        return torch.zeros_like(logits) if found is None else found
    # To avoid overflow, subtract the maximum first and keep T within the dtype's range.
    exponent = logits - largest
    if isinstance(temperature, Tensor):
        exponent = exponent / temperature.clamp(limits.tiny, limits.max)
    elif temperature != 1:
        exponent = exponent / min(max(float(temperature), limits.tiny), limits.max)
    power = exponent.exp()
    total = power.sum(-1, keepdim=True)
    if isinstance(soft, float) and found is not None:
        return torch.addcdiv(found, power, total, value=soft)
    power = (power * cast(Tensor, soft) if isinstance(soft, Tensor) or soft != 1 else power) / total
    return power if found is None else found + power


def _shares(
    logits: Tensor, largest: Tensor, greedy: Value | Tensor, uniform: Value | Tensor
) -> Tensor:
    """The weight of argmax among the actions of largest logit plus that of uniform among all."""
    lowest = torch.finfo(logits.dtype).min
    plain = isinstance(greedy, float) and isinstance(uniform, float) and readable(logits)
    if plain and logits.numel() and logits.amin().item() >= lowest:  # no −∞ or NaN
        low, high = _levels(
            logits.dtype, logits.shape[-1], cast(float, greedy), cast(float, uniform)
        )
        if not greedy:
            return torch.full_like(logits, low)
        best = logits >= largest
        if best.count_nonzero().item() * logits.shape[-1] == logits.numel():  # no ties
            return torch.full_like(logits, low).masked_fill_(best, high)
    found = None
    if present(greedy):  # a row of −∞ has no best action
        best = logits >= largest.clamp(min=lowest)
        found = _share(best, logits.dtype, greedy)
    if not present(uniform):
        return cast(Tensor, found)
    every = _share(logits >= lowest, logits.dtype, uniform)
    return every if found is None else found + every


@lru_cache
def _levels(dtype: torch.dtype, n: int, greedy: float, uniform: float) -> tuple[float, float]:
    """The shares of another action and of a single best one, rounded as ``_share`` rounds."""
    number = np.float32 if dtype is torch.float32 else np.float64
    low = number(1) / number(n) * number(uniform)
    return float(low), float(number(greedy) + low)


def _share(members: Tensor, dtype: torch.dtype, weight: Value | Tensor) -> Tensor:
    """A weight that some of the actions share equally."""
    share = members.type(dtype)
    return share * (share.sum(-1, keepdim=True).reciprocal() * cast(Tensor, weight))


def numbers(values: Iterable[Value | Tensor]) -> list[Value]:
    """The same values as numbers and arrays instead of tensors."""
    return [
        value if not isinstance(value, Tensor)
        else value.numpy(force=True) if value.ndim else value.item()
        for value in values
    ]  # fmt: skip


def present(weight: Value | Tensor) -> bool:
    """Whether a part of a mixture can have a weight: False only for the Python number 0."""
    return not isinstance(weight, int | float) or weight != 0
