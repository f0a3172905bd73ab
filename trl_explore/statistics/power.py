"""Power and sample size: the difference that n trials detect, the trials that a difference needs.

All functions use the normal approximation. ``sd`` ≥ 0 is the standard deviation of a paired
difference (``Comparison.sd``), or √(s_a² + s_b²) for unpaired trials, with n trials in each
configuration. ``power`` is the probability of detecting the difference; ``level`` is 1 - α of the
two-sided test. Both lie in (0, 1), otherwise ValueError.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from trl_explore.statistics.estimates import LEVEL, Estimate, check_level

POWER = 0.80
"""The probability of detecting the difference."""
Z_POWER = float(special.ndtri(POWER))
# The largest number of trials whose relabellings are counted.
COUNTED = 1000
MOST_TRIALS = 100_000
"""More trials of each configuration than that are "more than can be run", ``inf``."""


def detectable_difference(sd: float, n: ArrayLike, *, level: float = LEVEL) -> NDArray[np.float64]:
    """Smallest mean difference detected with 80 % power: δ = (z_{1-α/2} + z_power) sd / √n.

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
    return np.asarray((_z(level) + Z_POWER) * sd / np.sqrt(n_pairs))


def trials_for_difference(sd: float, difference: float, *, level: float = LEVEL) -> float | None:
    """Pairs needed to detect a difference of means: n = ⌈((z_{1-α/2} + z_power) sd / δ)²⌉.

    At least :func:`fewest_pairs`, because with fewer no difference is significant. ``inf`` if more
    than ``MOST_TRIALS`` are needed; None if the ``difference`` δ is 0 or NaN.

    Source: Lachin, Controlled Clinical Trials 2 (1981).

    >>> trials_for_difference(100.0, 50.0)
    32
    """
    z = _z(level) + Z_POWER
    if not (math.isfinite(sd) and math.isfinite(difference)) or difference == 0:
        return None
    return max(_whole((z * sd / difference) ** 2), fewest_pairs(level))


def trials_to_settle(estimate: Estimate, bound: float, n: int) -> float | None:
    """Trials after which the interval of an estimate from n trials would exclude ``bound``.

    n' = ⌈n ((z_{1-α/2} + z_power) / z_{1-α/2} · h / |θ̂ - bound|)²⌉, with h the distance from θ̂ to
    the end of its interval on the side of the bound, and α that of the interval

    ``inf`` if more than ``MOST_TRIALS`` are needed. None if there is no interval, or if θ̂ is within
    one standard error (h / z) of the bound: n' is then noise, because θ̂ may lie anywhere near it.

    >>> trials_to_settle(Estimate(50.0, -10.0, 110.0), 0.0, 20)
    59
    """
    z = _z(estimate.level)
    gap = estimate.value - bound
    h = estimate.value - estimate.low if gap > 0 else estimate.high - estimate.value
    if not math.isfinite(h) or abs(gap) <= h / z:
        return None
    return _whole(n * ((z + Z_POWER) / z * h / gap) ** 2)


def trials_text(n: float | None, unknown: str = "") -> str:
    """Write a number of trials for a table.

    >>> trials_text(1234), trials_text(math.inf), trials_text(None)
    ('1,200', 'more than 100,000', '')
    """
    if n is None:
        return unknown
    if n == math.inf:
        return f"more than {MOST_TRIALS:,}"
    return f"{float(f'{n:.2g}'):,.0f}"


def least_p(n_a: int, n_b: int, *, paired: bool) -> float:
    """The smallest p of a two-sided test that assumes nothing of the distribution.

    2 / 2ⁿ for n pairs; 2 over the number of relabellings of independent trials.

    >>> least_p(3, 3, paired=True), least_p(3, 3, paired=False)
    (0.25, 0.1)
    """
    if paired:
        return 2.0 ** (1 - n_a)
    return 2.0 / math.comb(n_a + n_b, n_a) if n_a + n_b <= COUNTED else 0.0


def fewest_pairs(level: float = LEVEL) -> int:
    """Fewest pairs for a significant difference: 2 / 2^n ≤ α, n = ⌈1 + log₂ 1/α⌉.

    2 / 2^n is the smallest p of a two-sided test of n pairs that assumes nothing of their
    distribution, if all differences have the same sign.

    >>> fewest_pairs(0.95), fewest_pairs(1 - 0.05 / 10)
    (6, 9)
    """
    check_level(level)
    return math.ceil(1.0 - math.log2(1.0 - level) - 1e-9)


def trials_for_rate_bound(rate: float, bound: float, *, level: float = LEVEL) -> float | None:
    """Trials after which Wilson's interval around ``rate`` would exclude ``bound``.

    n = ⌈(z_{1-α/2} √(p₀(1-p₀)) + z_power √(p(1-p)))² / (p - p₀)²⌉ for p₀ = bound. At p = 0
    or 1 the second term is 0, and n is the smallest number of trials, all with the same outcome,
    that settles the question. None if ``rate`` equals ``bound``.

    Raises:
        ValueError: a rate outside [0, 1].

    Source: Fleiss, Levin & Paik, Statistical Methods for Rates and Proportions (2003), §2.5.

    >>> trials_for_rate_bound(0.0, 0.05)
    73
    """
    for p in (rate, bound):
        if not 0.0 <= p <= 1.0:
            raise ValueError(f"rate={p}: a proportion lies in [0, 1]")
    z_sd = _z(level) * math.sqrt(bound * (1 - bound)) + Z_POWER * math.sqrt(rate * (1 - rate))
    return None if rate == bound else _whole((z_sd / (rate - bound)) ** 2)


def _whole(n: float) -> float:
    # 1e-9 corrects results that rounding moved just above an integer.
    return max(2, math.ceil(n - 1e-9)) if n <= MOST_TRIALS else math.inf


def _z(level: float) -> float:
    check_level(level)
    return float(special.ndtri((1 + level) / 2))
