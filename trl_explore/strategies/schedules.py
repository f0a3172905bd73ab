"""Schedules: functions of the iteration, or of the number of frames, for any parameter."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trl_explore.checks import check_integer, check_number

Value = float | NDArray[np.float64]


class Schedule(ABC):
    """A function i -> value of the iteration i = 0, 1, 2, ..., or of the number of frames.

    An iteration is one update of a trial. Frames are those given to the strategy's ``step``. The
    value is one number for all trials, or an array [trials] with one per trial.

    Attributes:
        clock: what i counts, "iterations" or "frames".
        bounds: the smallest and largest value that the schedule takes or approaches.
    """

    clock = "iterations"
    bounds: tuple[float, float]

    @abstractmethod
    def __call__(self, iteration: int) -> Value:
        """The value in ``iteration``, counted from 0."""

    def _within(self, value: float) -> float:
        """The value, which rounding may have moved out of the bounds."""
        low, high = self.bounds
        return min(max(value, low), high)

    def __repr__(self) -> str:
        own = (f"{name}={value}" for name, value in vars(self).items() if name != "bounds")
        return f"{type(self).__name__}({', '.join(own)})"


class Constant(Schedule):
    """value(i) = value.

    Args:
        value: one number, or one per trial.

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
        elif np.ndim(value) == 1 and np.size(value):
            self.value = np.array([check_number("value", _scalar(v)) for v in values])
        else:
            raise ValueError(f"value must be a number or one number per trial, got {value}")
        self.bounds = _span(self.value)

    def __call__(self, iteration: int) -> Value:
        """The value in ``iteration``, counted from 0."""
        return self.value


class _Walk(Schedule):
    """From ``initial`` at 0 to ``final`` after some iterations or frames, then constant."""

    def __init__(
        self,
        initial: float,
        final: float,
        iterations: int | None = None,
        *,
        frames: int | None = None,
    ) -> None:
        self.initial = check_number("initial", initial)
        self.final = check_number("final", final)
        self.bounds = _span([initial, final])
        if frames is None:
            self.iterations = check_integer("iterations", iterations, 1)
        elif iterations is None:
            self.frames = check_integer("frames", frames, 1)
            self.clock = "frames"
        else:
            raise ValueError(
                f"give iterations or frames, not both: got {iterations!r} and {frames!r}"
            )

    def __call__(self, iteration: int) -> float:
        """The value in ``iteration``, counted from 0."""
        length = self.frames if self.clock == "frames" else self.iterations
        progress = self._progress(min(iteration / length, 1.0))
        return self._within(self.initial + (self.final - self.initial) * progress)

    @abstractmethod
    def _progress(self, time: float) -> float:
        """The fraction of the change done after a fraction of the time, both in [0, 1]."""


class Linear(_Walk):
    """value(i) = initial + (final − initial) · min(i / iterations, 1).

    Args:
        initial: the value at 0.
        final: the value at the end and later.
        iterations: the number of iterations until ``final``, >= 1.
        frames: the number of frames until ``final``, >= 1, in place of ``iterations``; i is then
            the number of frames.

    Raises:
        ValueError: if a value is not finite, or not exactly one length >= 1 is given.

    Example:
        >>> [Linear(1.0, 0.0, iterations=4)(i) for i in (0, 1, 4, 9)]
        [1.0, 0.75, 0.0, 0.0]
    """

    def _progress(self, time: float) -> float:
        return time


class Cosine(_Walk):
    """value(i) = final + (initial − final) · (1 + cos(π · min(i / iterations, 1))) / 2.

    Slow at both ends and fastest in the middle (Loshchilov & Hutter 2017, "SGDR", eq. 5, without
    restarts).

    Arguments are those of ``Linear``.

    Example:
        >>> [round(Cosine(1.0, 0.0, iterations=3)(i), 6) for i in (0, 1, 2, 3, 9)]
        [1.0, 0.75, 0.25, 0.0, 0.0]
    """

    def _progress(self, time: float) -> float:
        return (1 - math.cos(math.pi * time)) / 2


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
        self.bounds = _span([initial, initial if decay == 1 else 0])

    def __call__(self, iteration: int) -> float:
        """The value in ``iteration``, counted from 0."""
        return self.initial * self.decay**iteration


class Inverse(Schedule):
    """value(i) = initial / (1 + rate · i)^power.

    At power 1, the step sizes of Robbins & Monro (1951). For powers in (1/2, 1] the sum of the step
    sizes diverges and the sum of their squares converges.

    Args:
        initial: the value in iteration 0.
        rate: the rate of decay, >= 0; at power 1 the value is half in iteration 1 / rate.
        power: > 0.

    Raises:
        ValueError: if an argument is out of range.

    Example:
        >>> [Inverse(1.0, rate=0.5)(i) for i in (0, 2, 6)]
        [1.0, 0.5, 0.25]
    """

    def __init__(self, initial: float, rate: float, power: float = 1.0) -> None:
        self.initial = check_number("initial", initial)
        self.rate = check_number("rate", rate, 0)
        self.power = check_number("power", power, 0, low_open=True)
        self.bounds = _span([initial, initial if rate == 0 else 0])

    def __call__(self, iteration: int) -> float:
        """The value in ``iteration``, counted from 0."""
        return self.initial * (1 + self.rate * iteration) ** -self.power


class Piecewise(Schedule):
    """Linear interpolation between knots (i_k, value_k), i_0 < i_1 < ...; constant outside.

    value(i) = value_k + (value_{k+1} − value_k) · (i − i_k) / (i_{k+1} − i_k),  i_k <= i <= i_{k+1}

    Args:
        knots: at least one pair (iteration, value), iterations ascending.

    Raises:
        ValueError: if a knot is not a pair of an integer >= 0 and a finite number, or the
            iterations do not ascend.

    Example:
        >>> schedule = Piecewise([(0, 1.0), (100, 0.2), (200, 0.0)])
        >>> [schedule(i) for i in (0, 50, 100, 150, 1000)]
        [1.0, 0.6, 0.2, 0.1, 0.0]
    """

    def __init__(self, knots: Sequence[Sequence[float]]) -> None:
        if isinstance(knots, str) or not np.iterable(knots) or not len(knots):
            raise ValueError(f"knots must be pairs (iteration, value), got {knots!r}")
        for knot in knots:
            if isinstance(knot, str) or not np.iterable(knot) or len(knot) != 2:
                raise ValueError(f"a knot must be a pair (iteration, value), got {knot!r}")
        self.knots = [
            (check_integer("iteration of a knot", _scalar(i), 0), check_number("value", _scalar(v)))
            for i, v in knots
        ]
        iterations = [i for i, _ in self.knots]
        if any(a >= b for a, b in pairwise(iterations)):
            raise ValueError(f"the iterations of the knots must ascend, got {iterations}")
        self.bounds = _span([value for _, value in self.knots])

    def __call__(self, iteration: int) -> float:
        """The value in ``iteration``, counted from 0."""
        iterations, values = zip(*self.knots, strict=True)
        return self._within(float(np.interp(iteration, iterations, values)))


class Rows(Schedule):
    """The values of some trials from a schedule with one value per trial.

    Args:
        schedule: the schedule of all trials.
        rows: the trials to keep.

    Example:
        >>> Rows(Constant([0.1, 0.2, 0.3]), slice(1, 3))(0)
        array([0.2, 0.3])
    """

    def __init__(self, schedule: Schedule, rows: slice) -> None:
        self.schedule, self.rows, self.clock = schedule, rows, schedule.clock
        self.bounds = schedule.bounds

    def __call__(self, iteration: int) -> Value:
        """The value in ``iteration``, counted from 0."""
        value = self.schedule(iteration)
        return value[self.rows] if isinstance(value, np.ndarray) else value


Parameter = float | Sequence[float] | Schedule
"""A parameter of a strategy: a number, one number per trial, or a schedule."""


def as_schedule(
    name: str, value: Parameter, low: float, high: float, *, low_open: bool = False
) -> Schedule:
    """A schedule from a number, a list of one number per trial, or a schedule.

    Raises:
        ValueError: if the schedule takes a value outside the bounds.
    """
    if not isinstance(value, Schedule):
        numbers: Any = [value] if isinstance(value, str) or np.ndim(value) == 0 else value
        for number in numbers:
            check_number(name, _scalar(number), low, high, low_open=low_open)
        return Constant(value)
    for bound in value.bounds:
        # A decay may approach an open bound without reaching it.
        check_number(name, bound, low, high)
    if low_open and np.any(value(0) == low):
        check_number(name, low, low, high, low_open=True)
    return value


def _span(values: Value | Sequence[float]) -> tuple[float, float]:
    return float(np.min(values)), float(np.max(values))


def _scalar(value: Any) -> Any:
    """The number in a 0-d array; anything else unchanged."""
    return value.item() if isinstance(value, np.ndarray | np.generic) and value.ndim == 0 else value
