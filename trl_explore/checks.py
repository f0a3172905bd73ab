"""Argument checks: each error is one line with the argument, its value and what is allowed."""

from __future__ import annotations

import math
from collections.abc import Collection
from contextlib import suppress
from numbers import Integral, Real
from typing import Any


def check_number(
    name: str,
    value: Any,
    low: float = -math.inf,
    high: float = math.inf,
    *,
    low_open: bool = False,
) -> float:
    """Return ``value`` as a float if it is a finite number within the bounds.

    Raises:
        ValueError: if it is not; the message names the argument, the value and the range.

    Example:
        >>> check_number("epsilon", 0.3, 0, 1)
        0.3
        >>> check_number("epsilon", 2, 0, 1)
        Traceback (most recent call last):
        ...
        ValueError: epsilon must be a number in [0, 1], got 2
    """
    number = math.nan
    if isinstance(value, Real) and not isinstance(value, bool):
        with suppress(OverflowError):
            number = float(value)
    above = number > low if low_open else number >= low
    if not (math.isfinite(number) and above and number <= high):
        raise ValueError(
            f"{name} must be a number {interval(low, high, low_open=low_open)}, got {value!r}"
        )
    return number


MAX_THREADS = 64
LARGEST = 2**63 - 1
"""The largest integer that a results column can hold."""


def check_integer(name: str, value: Any, low: int, high: int | None = None) -> int:
    """Return ``value`` as an int if it is an integer from ``low`` to ``high``.

    Raises:
        ValueError: if it is not; the message names the argument, the value and the bounds.
    """
    number = None
    if isinstance(value, Integral) and not isinstance(value, bool):
        number = int(value)
    if number is None or number < low:
        raise ValueError(f"{name} must be an integer >= {low}, got {value!r}")
    if high is not None and number > high:
        raise ValueError(f"{name} must be an integer <= {high}, got {value!r}")
    return number


def check_flag(name: str, value: Any) -> bool:
    """Return ``value`` if it is a bool.

    Raises:
        ValueError: if it is not; the message names the argument and the value.
    """
    if not isinstance(value, bool):
        raise ValueError(f"{name} must be true or false, got {value!r}")
    return value


def interval(low: float, high: float, *, low_open: bool = False) -> str:
    """A range in words, such as ``in [0, 1]`` or ``> 0``."""
    if math.isinf(high) and math.isinf(low):
        return "that is finite"
    if math.isinf(high):
        return f"{'>' if low_open else '>='} {low:g}"
    if math.isinf(low):
        return f"<= {high:g}"
    return f"in {'(' if low_open else '['}{low:g}, {high:g}]"


def withdraw(cls: type, attribute: str, value: bool, methods: Collection[str]) -> None:
    """Withdraw a declaration from a class that overrides a method without declaring it again.

    Class attributes declare what a class can do. An inherited declaration may no longer hold once
    a subclass overrides one of the methods that it describes. Call this in ``__init_subclass__``:
    it sets the attribute to the safe ``value`` unless the subclass declares it.

    Example:
        >>> class Base:
        ...     fast = True
        ...     def __init_subclass__(cls):
        ...         withdraw(cls, "fast", False, ["run"])
        >>> class Same(Base): ...
        >>> class Changed(Base):
        ...     def run(self): ...
        >>> class Stated(Base):
        ...     fast = True
        ...     def run(self): ...
        >>> Same.fast, Changed.fast, Stated.fast
        (True, False, True)
    """
    for ancestor in cls.__mro__:
        if attribute in vars(ancestor):
            return
        if not vars(ancestor).keys().isdisjoint(methods):
            setattr(cls, attribute, value)
            return


def holds(instance: object, attribute: str, methods: Collection[str]) -> bool:
    """Whether an object's methods are those that the declaration of its class covers.

    ``withdraw`` sees what a class overrides when it is made, and not what is put into the object,
    or into its class later.

    Example:
        >>> class Base:
        ...     fast = True
        ...     def run(self): ...
        >>> base = Base()
        >>> holds(base, "fast", ["run"])
        True
        >>> base.run = print
        >>> holds(base, "fast", ["run"])
        False
    """
    kind = type(instance)
    stated = next(cls for cls in kind.__mro__ if attribute in vars(cls))
    same = all(getattr(kind, name, None) is getattr(stated, name, None) for name in methods)
    return same and vars(instance).keys().isdisjoint(methods)


def first_line(error: BaseException) -> str:
    """The first line of an error's message."""
    return str(error).strip().split("\n")[0] or type(error).__name__
