"""Sample size: which difference n trials would find, and how many trials a difference needs.

All by the normal approximation. ``sd`` ≥ 0 is the standard deviation of one pair's difference
(``Comparison.sd``); for unpaired trials √(s_a² + s_b²) with n trials in each configuration.
``power`` is the probability to find the difference, ``level`` 1 - α of the two-sided test; both lie
in (0, 1), else ValueError.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from trl_explore.statistics.estimates import LEVEL, check_level, normal_quantile

POWER = 0.80
# Beyond this a number of trials is no advice but a sign that the difference is nil.
MOST_TRIALS = 100_000_000


def detectable_difference(
    sd: float, n: ArrayLike, *, power: float = POWER, level: float = LEVEL
) -> NDArray[np.float64]:
    """Smallest difference of means found with the given power: δ = (z_{1-α/2} + z_power) sd / √n.

    δ has the unit of ``sd`` and the shape of ``n``, the number of pairs.

    Raises:
        ValueError: n < 1 or sd < 0.

    Source: Lachin, Controlled Clinical Trials 2 (1981).

    >>> round(float(detectable_difference(100.0, 30)), 1)
    51.1

    """
    n_pairs = np.asarray(n, dtype=np.float64)
    if (n_pairs < 1).any() or not sd >= 0:
        raise ValueError(f"n={n}, sd={sd}: n ≥ 1 and sd ≥ 0 are needed")
    return np.asarray(sum(_z(power, level)) * sd / np.sqrt(n_pairs))


def trials_for_difference(
    sd: float, difference: float, *, power: float = POWER, level: float = LEVEL
) -> int | None:
    """Pairs needed to find a difference of means: n = ⌈((z_{1-α/2} + z_power) sd / δ)²⌉.

    At least :func:`fewest_pairs`, below which a permutation test finds nothing. None where no
    number of trials (up to 10⁸) would do: the ``difference`` δ is 0 or not known (NaN).

    Source: Lachin, Controlled Clinical Trials 2 (1981).

    >>> trials_for_difference(100.0, 50.0)
    32

    """
    z = sum(_z(power, level))
    if not (math.isfinite(sd) and math.isfinite(difference)) or difference == 0:
        return None
    n = _whole((z * sd / difference) ** 2)
    return None if n is None else max(n, fewest_pairs(level))


def fewest_pairs(level: float = LEVEL) -> int:
    """Pairs below which no difference is found, however large: 2 / 2^n ≤ α, n = ⌈1 + log₂ 1/α⌉.

    The smallest p of a two-sided sign-flip test of n pairs is 2 / 2^n: all differences have one
    sign.

    >>> fewest_pairs(0.95), fewest_pairs(1 - 0.05 / 10)
    (6, 9)
    """
    check_level(level)
    return math.ceil(1.0 - math.log2(1.0 - level) - 1e-9)


def trials_for_rate_bound(
    rate: float, bound: float, *, power: float = POWER, level: float = LEVEL
) -> int | None:
    """Trials after which Wilson's interval around ``rate`` would exclude ``bound``.

    n = ⌈(z_{1-α/2} √(p₀(1-p₀)) + z_power √(p(1-p)))² / (p - p₀)²⌉ for p₀ = bound. At p = 0
    (or 1) the second term is nil: the first n at which an unbroken row settles the question. None
    where ``rate`` equals ``bound``.

    Raises:
        ValueError: a rate outside [0, 1].

    Source: Fleiss, Levin & Paik, Statistical Methods for Rates and Proportions (2003), §2.5.

    >>> trials_for_rate_bound(0.0, 0.05)
    73

    """
    for p in (rate, bound):
        if not 0.0 <= p <= 1.0:
            raise ValueError(f"rate={p}: a proportion lies in [0, 1]")
    z_level, z_power = _z(power, level)
    z_sd = z_level * math.sqrt(bound * (1 - bound)) + z_power * math.sqrt(rate * (1 - rate))
    return None if rate == bound else _whole((z_sd / (rate - bound)) ** 2)


def _whole(n: float) -> int | None:
    # The small number undoes rounding just above a whole number.
    return max(2, math.ceil(n - 1e-9)) if n <= MOST_TRIALS else None


def _z(power: float, level: float) -> tuple[float, float]:
    check_level(level)
    if not 0.0 < power < 1.0:
        raise ValueError(f"power={power}: a power lies in (0, 1), for example 0.8")
    return normal_quantile(level), float(stats.norm.ppf(power))
