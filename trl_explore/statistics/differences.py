"""Difference of two means: interval, permutation test, and whether pairing helped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trl_explore.statistics.bootstrap import RESAMPLES, bootstrap
from trl_explore.statistics.estimates import LEVEL, Estimate
from trl_explore.statistics.permutation import label_permutation_test, sign_flip_test


@dataclass(frozen=True)
class MeanDifference:
    """mean(x) - mean(y) with its uncertainty.

    Attributes:
        estimate: the difference with its bootstrap interval.
        p_value: two-sided; sign flips where paired, else permuted labels.
        paired: whether x_i and y_i are a pair.
        n: number of pairs; where unpaired, the smaller of both numbers.
        sd: standard deviation of one pair's difference; where unpaired √(s_x² + s_y²), so that
            in both designs the standard error with n trials each is about sd / √n.
        correlation: Pearson's r of the pairs; NaN where unpaired or without variance.
        variance_ratio: Var(x - y) / (Var x + Var y); below 1 pairing makes the comparison
            sharper, as if there were 1 / ratio as many trials. NaN as for the correlation.

    """

    estimate: Estimate
    p_value: float
    paired: bool
    n: int
    sd: float
    correlation: float
    variance_ratio: float

    def sign(self) -> int:
        """-1 or +1 where interval and test both exclude zero at the estimate's level, else 0.

        Both are asked because each alone errs with few trials: the bootstrap interval is too
        short, and the permutation test says nothing of the size.
        """
        if not self.p_value <= 1.0 - self.estimate.level + 1e-12:
            return 0
        return int(self.estimate.above(0.0)) - int(self.estimate.below(0.0))


def mean_difference(
    x: ArrayLike,
    y: ArrayLike,
    rng: np.random.Generator,
    *,
    paired: bool,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
    tail: bool = False,
) -> MeanDifference:
    """Δ̂ = mean(x) - mean(y) with percentile bootstrap interval and permutation p-value.

    Paired: trials are resampled as pairs and the signs of x_i - y_i flipped. Unpaired: each
    sample is resampled by itself and the labels permuted.

    Args:
        x: [n_x].
        y: [n_y], n_y = n_x where paired.
        rng: source of both procedures.
        paired: the design.
        level: confidence level.
        resamples: of the bootstrap and of the test, each.
        tail: of the test, see :func:`sign_flip_test`.

    Raises:
        ValueError: an empty sample, values that are not finite, unequal lengths where paired.

    Source: Efron & Tibshirani, An Introduction to the Bootstrap (1993), ch. 8, 13 and 15.

    >>> d = mean_difference([1, 2, 4], [2, 3, 5], np.random.default_rng(0), paired=True)
    >>> d.estimate.value, d.p_value, d.variance_ratio
    (-1.0, 0.25, 0.0)

    """
    a, b = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if min(a.size, b.size) == 0 or not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ValueError(f"samples of {a.size} and {b.size}: each needs one value, all finite")
    if not paired:
        estimate = bootstrap(_difference, [a, b], rng, level=level, resamples=resamples)
        p = label_permutation_test(a, b, rng, resamples=resamples, tail=tail)
        n = min(len(a), len(b))
        sd = float(np.sqrt(a.var(ddof=1) + b.var(ddof=1))) if n > 1 else np.nan
        return MeanDifference(estimate, p, False, n, sd, np.nan, np.nan)
    if len(a) != len(b):
        raise ValueError(f"{len(a)} and {len(b)} values: pairs need the same number")
    d = a - b
    estimate = bootstrap(_mean, [d], rng, level=level, resamples=resamples)
    p = sign_flip_test(d, rng, resamples=resamples, tail=tail)
    if len(d) < 2:
        return MeanDifference(estimate, p, True, len(d), np.nan, np.nan, np.nan)
    separate = a.var(ddof=1) + b.var(ddof=1)
    varies = a.min() < a.max() and b.min() < b.max()
    return MeanDifference(
        estimate,
        p,
        True,
        len(d),
        sd=float(d.std(ddof=1)),
        correlation=float(np.corrcoef(a, b)[0, 1]) if varies else np.nan,
        variance_ratio=float(d.var(ddof=1) / separate) if varies else np.nan,
    )


def _mean(x: np.ndarray) -> np.ndarray:
    return x.mean(axis=-1)


def _difference(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return x.mean(axis=-1) - y.mean(axis=-1)
