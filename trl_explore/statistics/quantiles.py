"""Quantiles with exact intervals, and linear combinations of them: spread and skew without moments.

The standard deviation and the skewness depend on the rarest trials; no interval of theirs covers at
the numbers of trials of an experiment. Differences of quantiles say the same and can be tested.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from trl_explore.statistics.estimates import LEVEL, Estimate, check_level


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
