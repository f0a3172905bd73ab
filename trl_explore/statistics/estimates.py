"""A number with its interval, the form in which every estimate leaves this package."""

from __future__ import annotations

from dataclasses import dataclass

LEVEL = 0.95


@dataclass(frozen=True)
class Estimate:
    """Point estimate θ̂ with a two-sided interval [low, high] at confidence ``level``.

    ``nan`` bounds mean that the data allow no interval (a single trial, say); every question
    about such an interval is answered with no. ``inf`` means "not reached within the cap".

    Attributes:
        value: the point estimate, in the unit of the quantity.
        low: lower end, same unit.
        high: upper end, same unit.
        level: confidence level in (0, 1).

    >>> Estimate(0.4, 0.3, 0.49).below(0.5)
    True

    """

    value: float
    low: float
    high: float
    level: float = LEVEL

    def above(self, bound: float) -> bool:
        """Whether the whole interval lies strictly above ``bound``."""
        return self.low > bound

    def below(self, bound: float) -> bool:
        """Whether the whole interval lies strictly below ``bound``."""
        return self.high < bound

    def inside(self, low: float, high: float) -> bool:
        """Whether the whole interval lies within the closed range [low, high]."""
        return low <= self.low and self.high <= high

    def outside(self, low: float, high: float) -> bool:
        """Whether the interval and the range [low, high] have no point in common."""
        return self.below(low) or self.above(high)


def check_level(level: float) -> None:
    """Raise ValueError unless ``level`` is a confidence level in (0, 1)."""
    if not 0.0 < level < 1.0:
        raise ValueError(f"level={level}: a confidence level lies in (0, 1), for example 0.95")
