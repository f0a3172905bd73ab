"""Mixtures of argmax, softmax and uniform: weights, probabilities, ties."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, NamedTuple, cast

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from trl_explore.checks import holds, settle
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
        settle(cls, "mixes_policy", False, cls.REPLACED)

    @abstractmethod
    def mixture(self) -> Any:
        """Weights and temperature in the current iteration."""

    def allocate(self, policy: TensorDictModuleBase, trials: int) -> None:
        """Check the mixture."""
        self.checked_mixture(trials)

    def on_policy(self) -> bool | NDArray[np.bool_]:
        """Whether μ = π: the mixture is the policy alone, at T = 1."""
        mixed = self.mixes_policy and holds(self, "mixes_policy", self.REPLACED)
        return mixed and is_policy_alone(*numbers(self.mixture()))

    def checked_mixture(self, trials: int) -> Any:
        """The mixture of the current iteration as numbers, checked for ``trials`` trials.

        Raises:
            ValueError: if a per-trial entry does not have one value for every trial, or the
                weights are negative or do not sum to 1.
        """
        mixture = self.mixture()
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


def is_policy_alone(
    certain: Value, policy: Value, uniform: Value, temperature: Value
) -> bool | NDArray[np.bool_]:
    """Whether a mixture of numbers is the policy at T = 1; one value, or one per trial.

    Example:
        >>> is_policy_alone(0.0, 1.0, 0.0, 1.0), is_policy_alone(1.0, 0.0, 0.0, 1.0)
        (True, False)
        >>> is_policy_alone(0.0, 1.0, 0.0, np.array([1.0, 0.5]))
        array([ True, False])
    """
    found = np.equal(certain, 0) & np.equal(uniform, 0) & np.equal(temperature, 1)
    return found if isinstance(found, np.ndarray) else bool(found)


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
        settle(cls, "compilable", False, cls.REPLACED)

    @abstractmethod
    def mixture(self) -> Mixture:
        """Weights and temperature in the current iteration."""

    def behaviour_parameters(self, parameters: Sequence[Tensor]) -> list[Tensor]:
        """The parameters with which the policy's logits equal the strategy's ``preferences``.

        A strategy that overrides ``preferences`` is compilable only if it overrides this too.

        Args:
            parameters: parameters of the target policy given to ``bind``.
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
    limits = torch.finfo(logits.dtype)
    greedy, soft, uniform = map(present, mixture[:3])
    if not soft:
        logits = actions_outermost(logits)
    largest, found = logits.amax(-1, keepdim=True), None
    if soft:
        # To avoid overflow, subtract the maximum first and keep T within the dtype's range.
        exponent, temperature = logits - largest, mixture.temperature
        if isinstance(temperature, Tensor):
            exponent = exponent / temperature.clamp(limits.tiny, limits.max)
        elif temperature != 1:
            exponent = exponent / min(max(float(temperature), limits.tiny), limits.max)
        power = exponent.exp()
        found = power / power.sum(-1, keepdim=True)
        found = found if is_one(mixture.softmax) else found * cast(Tensor, mixture.softmax)
    each = _number_of_all(logits, mixture.uniform) if greedy or uniform else 0.0
    if greedy:
        # A row of −∞ has no best action; the other parts find that by themselves.
        best = logits >= (largest if soft or uniform else largest.clamp(min=limits.min))
        weight = mixture.greedy
        if each is None or not isinstance(weight, float) or _have_ties(best):
            found = _plus_share(found, best, logits.dtype, weight)
        elif found is not None:
            found = torch.add(found, best, alpha=weight)
        else:
            highest = _number_like(logits)(weight) + _number_like(logits)(each)
            return torch.full_like(logits, each).masked_fill_(best, float(highest))
    if not uniform:
        return torch.zeros_like(logits) if found is None else found
    if each is None:
        return _plus_share(found, logits >= limits.min, logits.dtype, mixture.uniform)
    return torch.full_like(logits, each) if found is None else found + each


def _number_of_all(logits: Tensor, weight: Value | Tensor) -> float | None:
    """Each action's part of a weight that all share; None if a logit is −∞, NaN or not readable."""
    plain = isinstance(weight, float) and logits.numel() > 0 and readable(logits)
    if not (plain and logits.amin().item() >= torch.finfo(logits.dtype).min):
        return None
    number = _number_like(logits)
    return float(number(1) / number(logits.shape[-1]) * number(weight))


def _number_like(logits: Tensor) -> type[np.floating]:
    """The numbers of numpy that round as the logits."""
    return np.float32 if logits.dtype is torch.float32 else np.float64


def _have_ties(best: Tensor) -> bool:
    """Whether a row has more than one best action, if every row has one [*batch, n_actions]."""
    return best.count_nonzero().item() * best.shape[-1] != best.numel()


def _plus_share(
    found: Tensor | None, members: Tensor, dtype: torch.dtype, weight: Value | Tensor
) -> Tensor:
    """``found`` plus a weight that some of the actions share equally."""
    share = members.type(dtype)
    each = share.sum(-1, keepdim=True).reciprocal()
    each = each if is_one(weight) else each * cast(Tensor, weight)
    return share * each if found is None else torch.addcmul(found, share, each)


def numbers(values: Iterable[Value | Tensor]) -> list[Value]:
    """The same values as numbers and arrays instead of tensors."""
    return [
        value if not isinstance(value, Tensor)
        else value.numpy(force=True) if value.ndim else value.item()
        for value in values
    ]  # fmt: skip


def is_one(weight: Value | Tensor) -> bool:
    """Whether a weight is the Python number 1."""
    return isinstance(weight, int | float) and weight == 1


def present(weight: Value | Tensor) -> bool:
    """Whether a part of a mixture can have a weight: False only for the Python number 0."""
    return not isinstance(weight, int | float) or weight != 0
