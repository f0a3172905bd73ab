"""Schedules: functions of the iteration.

A parameter of a strategy is a schedule; it decays or grows because its schedule does, not because
the strategy is another class. Iterations count from 0 and advance once per update of a trial,
never per frame.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trl_explore.checks import check_integer, check_number

Value = float | NDArray[np.float64]


class Schedule(ABC):
    """A function i -> value of the iteration i = 0, 1, 2, ...

    The value is a number that holds for every trial, or an array [trials] with one for each.
    """

    @abstractmethod
    def __call__(self, iteration: int) -> Value:
        """The value in ``iteration``, counted from 0."""

    @property
    @abstractmethod
    def bounds(self) -> tuple[float, float]:
        """The smallest and the largest value that the schedule ever takes or approaches."""


class Constant(Schedule):
    """value(i) = value, one number, or one for each trial.

    Raises:
        ValueError: if a value is not a finite number.

    Example:
        >>> Constant(0.3)(1000)
        0.3
        >>> Constant([0.1, 0.2])(0)
        array([0.1, 0.2])
    """

    def __init__(self, value: float | Sequence[float] | NDArray[Any]) -> None:
        self.value: Value
        values: Any = value
        if isinstance(value, str) or np.ndim(value) == 0:
            self.value = check_number("value", _scalar(value))
        elif np.ndim(value) != 1 or len(values) == 0:
            raise ValueError(f"value must be a number or one number per trial, got {value}")
        else:
            self.value = np.array([check_number("value", _scalar(v)) for v in values])

    def __call__(self, iteration: int) -> Value:
        """The value in ``iteration``, counted from 0."""
        return self.value

    @property
    def bounds(self) -> tuple[float, float]:
        """The smallest and the largest value."""
        return float(np.min(self.value)), float(np.max(self.value))


class Linear(Schedule):
    """value(i) = initial + (final − initial) · min(i / iterations, 1).

    Args:
        initial: the value in iteration 0.
        final: the value from iteration ``iterations`` on.
        iterations: the length of the walk, > 0.

    Raises:
        ValueError: if an argument is not finite or ``iterations`` < 1.

    Example:
        >>> [Linear(1.0, 0.0, iterations=4)(i) for i in (0, 1, 4, 9)]
        [1.0, 0.75, 0.0, 0.0]
    """

    def __init__(self, initial: float, final: float, iterations: int) -> None:
        self.initial = check_number("initial", initial)
        self.final = check_number("final", final)
        self.iterations = check_integer("iterations", iterations, 1)

    def __call__(self, iteration: int) -> float:
        """The value in ``iteration``, counted from 0."""
        progress = min(iteration / self.iterations, 1.0)
        return self.initial + (self.final - self.initial) * progress

    @property
    def bounds(self) -> tuple[float, float]:
        """The smallest and the largest value."""
        return min(self.initial, self.final), max(self.initial, self.final)


class Exponential(Schedule):
    """value(i) = initial · decay^i.

    Args:
        initial: the value in iteration 0.
        decay: the factor per iteration, in [0, 1].

    Raises:
        ValueError: if ``initial`` is not finite or ``decay`` is not in [0, 1].

    Example:
        >>> Exponential(1.0, 0.5)(3)
        0.125
    """

    def __init__(self, initial: float, decay: float) -> None:
        self.initial = check_number("initial", initial)
        self.decay = check_number("decay", decay, 0, 1)

    def __call__(self, iteration: int) -> float:
        """The value in ``iteration``, counted from 0."""
        return self.initial * self.decay**iteration

    @property
    def bounds(self) -> tuple[float, float]:
        """The smallest and the largest value."""
        limit = self.initial if self.decay == 1 else 0.0
        return min(self.initial, limit), max(self.initial, limit)


def as_schedule(
    name: str,
    value: float | Sequence[float] | Schedule,
    low: float,
    high: float,
    *,
    low_open: bool = False,
) -> Schedule:
    """A schedule from a number, a list of one number per trial, or a schedule.

    Raises:
        ValueError: if a value that it takes lies outside of the bounds.
    """
    if not isinstance(value, Schedule):
        single = isinstance(value, str) or np.ndim(value) == 0
        for number in [value] if single else value:  # type: ignore[union-attr]
            check_number(name, _scalar(number), low, high, low_open=low_open)
        return Constant(value)
    for bound in value.bounds:
        # A decay may approach an open bound without ever reaching it.
        check_number(name, bound, low, high)
    if low_open and np.any(value(0) == low):
        check_number(name, low, low, high, low_open=True)
    return value


def _scalar(value: Any) -> Any:
    """A 0-d array as the number in it; anything else as it is."""
    return value.item() if isinstance(value, np.ndarray | np.generic) and value.ndim == 0 else value
