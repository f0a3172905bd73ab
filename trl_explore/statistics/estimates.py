"""Estimates with intervals: proportions, quantiles and linear combinations of them.

The standard deviation and the skewness depend on the rarest trials, and no interval for them has
the right coverage at the numbers of trials of an experiment. Differences of quantiles describe the
same and can be tested.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import floor, hypot, inf, log10, sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

LEVEL = 0.95


@dataclass(frozen=True)
class Estimate:
    """Point estimate θ̂ with a two-sided interval [low, high] at confidence ``level``.

    ``nan`` bounds mean that there is no interval (for a single trial, for example); all methods
    then return False. ``inf`` means "not reached within the cap".

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

    def within(self, least: float, most: float) -> Estimate:
        """The estimate of a quantity that lies in [least, most]: the interval is cut off there.

        >>> Estimate(0.9, 0.5, 1.3).within(0.0, 1.0)
        Estimate(value=0.9, low=0.5, high=1.0, level=0.95)
        """
        return replace(self, low=max(self.low, least), high=min(self.high, most))


def check_level(level: float) -> None:
    """Raise ValueError unless ``level`` is a confidence level in (0, 1)."""
    if not 0.0 < level < 1.0:
        raise ValueError(f"level={level}: a confidence level lies in (0, 1), for example 0.95")


def normal_quantile(level: float) -> float:
    """Z = Φ⁻¹((1 + level) / 2), the half-width of a two-sided normal interval."""
    return float(stats.norm.isf((1.0 - level) / 2.0))


def pass_rate(successes: float, trials: int, *, level: float = LEVEL) -> Estimate:
    """Binomial proportion p̂ = k / n with Wilson's score interval.

    (p̂ + z²/2n ± z √(p̂(1-p̂)/n + z²/4n²)) / (1 + z²/n),  z = Φ⁻¹((1 + level) / 2)

    The set of p that the score test does not reject. Unlike p̂ ± z·se, it stays in [0, 1] and has
    nonzero width at k = 0 and k = n. k need not be an integer, so that ties can count half;
    ``scipy.stats.binomtest`` does not allow this.

    Raises:
        ValueError: n < 1, or k outside 0..n.

    Source: Wilson, JASA 22 (1927); Brown, Cai & DasGupta, Statistical Science 16 (2001).

    >>> estimate = pass_rate(0, 30)
    >>> round(estimate.low, 3), round(estimate.high, 3)
    (0.0, 0.114)
    """
    check_level(level)
    if trials < 1:
        raise ValueError(f"trials={trials}: a proportion needs at least one trial")
    if not 0 <= successes <= trials:
        raise ValueError(f"successes={successes}: between 0 and trials={trials} are possible")
    low, high = wilson(successes, trials, normal_quantile(level))
    return Estimate(successes / trials, low, high, level)


def wilson(successes: float, trials: int, z: float) -> tuple[float, float]:
    """Bounds of Wilson's interval with ``z`` standard errors; see :func:`pass_rate`."""
    p, n = successes / trials, trials
    scale = 1 + z**2 / n
    center = (p + z**2 / (2 * n)) / scale
    width = z * sqrt(p * (1.0 - p) / n + z**2 / (4.0 * n**2)) / scale
    # At k = 0 and k = n the bound is exactly 0 or 1; the formula has a rounding error of 1e-17.
    return (0.0 if successes == 0 else center - width, 1.0 if successes == n else center + width)


def exact_rate(successes: float, trials: int, *, level: float = LEVEL) -> Estimate:
    """Binomial proportion p̂ = k / n with the exact interval of Clopper and Pearson.

    [B((1 - level)/2; k, n - k + 1), B((1 + level)/2; k + 1, n - k)],  B: quantile of Beta(a, b)

    Each bound errs in at most (1 - level)/2 of samples at every p and n, which Wilson's bounds do
    not near 0 and 1: the choice where a rate is compared with a margin such as 1 %. k need not be
    an integer.

    Raises:
        ValueError: as :func:`pass_rate`.

    Source: Clopper & Pearson, Biometrika 26 (1934).

    >>> round(exact_rate(0, 30).high, 3), round(exact_rate(30, 30).low, 3)
    (0.116, 0.884)
    """
    value, tail = pass_rate(successes, trials, level=level).value, (1.0 - level) / 2.0
    k, n = successes, trials
    low = 0.0 if k == 0 else float(stats.beta.ppf(tail, k, n - k + 1))
    high = 1.0 if k == n else float(stats.beta.isf(tail, k + 1, n - k))
    return Estimate(value, low, high, level)


def decimals(e: Estimate) -> int:
    """Decimal places that show two significant digits of the interval's length, 0 to 6.

    Without a length, those that show three digits of the value.

    >>> decimals(Estimate(0.5, 0.4, 0.6)), decimals(Estimate(500.0, 400.0, 600.0))
    (2, 0)
    """
    length = e.high - e.low
    if not 0 < length < inf:
        return min(max(2 - floor(log10(abs(e.value))), 0), 6) if 0 < abs(e.value) < inf else 0
    return min(max(1 - floor(log10(length)), 0), 6)


def flat(values: Mapping[str, Any]) -> dict[str, Any]:
    """Flat row of a table: an :class:`Estimate` becomes ``x``, ``x_low``, ``x_high``."""
    row: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Estimate):
            row |= {key: value.value, f"{key}_low": value.low, f"{key}_high": value.high}
        else:
            row[key] = value
    return row


def quantile(values: ArrayLike, p: float, *, level: float = LEVEL) -> Estimate:
    """The p-quantile of a sample [n], with the interval between two of its order statistics.

    Covers at every n and for every distribution; an end is infinite if n is too small for it.

    Source: Conover, Practical Nonparametric Statistics (1999), §3.2; ``scipy.stats.quantile_test``.

    >>> e = quantile(range(100), 0.5)
    >>> e.low, e.high
    (39.0, 60.0)
    """
    check_level(level)
    x = np.asarray(values, dtype=np.float64)
    if len(x) == 0:
        raise ValueError("a quantile needs at least one value")
    ends = stats.quantile_test(x, p=p).confidence_interval(level)
    low = -np.inf if np.isnan(ends.low) else float(ends.low)
    high = np.inf if np.isnan(ends.high) else float(ends.high)
    return Estimate(float(np.quantile(x, p)), low, high, level)


def combination(
    values: ArrayLike, weights: Sequence[tuple[float, float]], *, level: float = LEVEL
) -> Estimate:
    """Σ w · quantile(p) for pairs (p, w), with MOVER's interval from those of the quantiles.

    Quantiles of a sample are positively correlated. Their correlation is taken as 0, which makes
    the interval too long for differences of quantiles.

    >>> combination(range(101), [(0.75, 1.0), (0.25, -1.0)]).value  # the interquartile range
    50.0
    """
    parts = [(w, quantile(values, p, level=level)) for p, w in weights]
    value = sum(w * e.value for w, e in parts)
    down = [w * (e.value - e.low) if w > 0 else -w * (e.high - e.value) for w, e in parts]
    up = [w * (e.high - e.value) if w > 0 else -w * (e.value - e.low) for w, e in parts]
    return Estimate(value, value - hypot(*down), value + hypot(*up), level)
