"""Permutation tests of the difference of two means: sign flips (paired), labels (unpaired).

``scipy.stats.permutation_test`` differs in what is reported: it draws other permutations from the
same seed, doubles the smaller one-sided p, and knows no bound for the tail.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations, product
from math import comb, exp
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trl_explore.statistics.bootstrap import BATCH, RESAMPLES


def sign_flip_test(
    differences: ArrayLike,
    rng: np.random.Generator,
    *,
    resamples: int = RESAMPLES,
    tail: bool = False,
) -> float:
    """Two-sided p-value of H0: within each pair the two values are exchangeable.

    p = P(|Σ s_i d_i| ≥ |Σ d_i|),  s_i = ±1 with equal probability

    Exact by enumeration where 2^n ≤ ``resamples``; otherwise Monte Carlo, with the observed
    signs counted as one draw, (1 + hits) / (1 + resamples), which keeps the test valid.
    Where no draw hits, that is 1 / (1 + resamples) however large the difference, too coarse for
    a correction over hundreds of tests; Hoeffding's bound p ≤ 2 exp(-(Σ d_i)² / 2 Σ d_i²) is not.

    Args:
        differences: d = x - y per pair, [n_pairs].
        rng: source of the signs (unused where the test is exact).
        resamples: number of random sign vectors.
        tail: return that bound where no draw hits and it is smaller. The test stays valid: the
            exact p is below the bound, and nothing changes at levels from 1 / (1 + resamples) up.

    Raises:
        ValueError: no pair, or a difference that is not finite.

    Source: Fisher, The Design of Experiments (1935), §21; Phipson & Smyth (2010) for the +1;
    Hoeffding, Journal of the American Statistical Association 58 (1963), theorem 2.

    >>> sign_flip_test([1.0, 2.0, 3.0], np.random.default_rng(0))
    0.25

    """
    d = np.asarray(differences, dtype=np.float64)
    if d.size == 0 or not np.isfinite(d).all():
        raise ValueError(f"{d.size} differences: at least one is needed, all finite")
    n = len(d)
    least = _tolerated(abs(d.sum()), d)
    if 2**n <= resamples:
        signs = np.array(list(product((-1.0, 1.0), repeat=n)))
        return float(np.mean(np.abs(signs @ d) >= least))

    def draw(rows: int) -> NDArray[np.float64]:
        flips = rng.integers(2, size=(rows, n), dtype=np.int8)
        return d.sum() - 2.0 * (flips @ d)

    bound = (d.sum() ** 2, 2.0 * (d @ d)) if tail else None
    return _monte_carlo(draw, n, least, resamples, bound)


def label_permutation_test(
    x: ArrayLike,
    y: ArrayLike,
    rng: np.random.Generator,
    *,
    resamples: int = RESAMPLES,
    tail: bool = False,
) -> float:
    """Two-sided p-value of H0: both samples come from one distribution.

    p = P(|mean(x*) - mean(y*)| ≥ |mean(x) - mean(y)|) over random relabellings of all trials

    Exact by enumeration where the number of relabellings is at most ``resamples``; otherwise
    Monte Carlo as in :func:`sign_flip_test`. For independent trials; pairs need the sign flips.
    Hoeffding's bound is here p ≤ 2 exp(-2 (Σ x_i - n_x m)² / n (max - min)²), m the mean and
    max - min the range of all values, n the smaller of n_x and n_y. ``tail`` is as there.

    Raises:
        ValueError: an empty sample, or a value that is not finite.

    Source: Phipson & Smyth, Statistical Applications in Genetics 9 (2010); Hoeffding (1963),
    theorem 2 and §6, draws without replacement.

    >>> label_permutation_test([1.0, 2.0], [3.0, 4.0], np.random.default_rng(0)) * 6
    2.0

    """
    a, b = two_samples(x, y)
    pooled = np.concatenate([a, b])
    # With the total fixed, the difference of means is a linear function of the sum of x alone.
    expected = pooled.sum() * len(a) / len(pooled)
    least = _tolerated(abs(a.sum() - expected), pooled)
    n = len(pooled)
    if comb(n, len(a)) <= resamples:
        chosen = np.array(list(combinations(range(n), len(a))))
        return float(np.mean(np.abs(pooled[chosen].sum(axis=1) - expected) >= least))

    def draw(rows: int) -> NDArray[np.float64]:
        order = np.tile(pooled, (rows, 1))
        rng.permuted(order, axis=1, out=order)
        return order[:, : len(a)].sum(1) - expected

    spread = min(len(a), len(b)) * np.ptp(pooled) ** 2
    bound = (2.0 * (a.sum() - expected) ** 2, spread) if tail else None
    return _monte_carlo(draw, n, least, resamples, bound)


def two_samples(x: ArrayLike, y: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Two samples [n_x], [n_y] as arrays; ValueError if one is empty or not finite."""
    a, b = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if min(a.size, b.size) == 0 or not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ValueError(f"samples of {a.size} and {b.size}: each needs one value, all finite")
    return a, b


def _monte_carlo(
    draw: Callable[[int], NDArray[np.float64]],
    n: int,
    least: float,
    resamples: int,
    bound: tuple[Any, Any] | None,
) -> float:
    """(1 + #{|drawn| ≥ least}) / (1 + resamples); without a hit 2 exp(-u / v), where smaller."""
    rows = max(1, BATCH // n)
    hits = sum(
        int(np.count_nonzero(np.abs(draw(min(rows, resamples - start))) >= least))
        for start in range(0, resamples, rows)
    )
    p = (1 + hits) / (1 + resamples)
    if hits or bound is None:
        return p
    # Never 0: e^-700 is still a number, and small enough for every correction.
    return min(p, 2.0 * exp(-min(float(bound[0] / bound[1]), 700.0)))


def _tolerated(observed: float, values: NDArray[np.float64]) -> float:
    # Equal sums differ in their last bits when added in another order; they are still ties.
    return observed - 1e-10 * float(np.abs(values).sum())
