"""Permutation tests of the difference of two means: sign flips (paired), labels (unpaired).

``scipy.stats.permutation_test`` gives other p-values: it draws different permutations from the same
seed, doubles the smaller one-sided p, and has no tail bound.
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

    Exact by enumeration if 2^n ≤ ``resamples``. Otherwise Monte Carlo, p = (1 + hits) / (1 +
    resamples): counting the observed signs as one draw keeps the test valid. Without hits, p is
    1 / (1 + resamples) however large the difference, which is too coarse for a correction over
    hundreds of tests. Hoeffding's bound p ≤ 2 exp(-(Σ d_i)² / 2 Σ d_i²) is finer.

    Args:
        differences: d = x - y per pair, [n_pairs].
        rng: source of the signs (unused if the test is exact).
        resamples: number of random sign vectors.
        tail: return this bound if there are no hits and it is smaller. The test stays valid: the
            exact p is below the bound, and decisions at α ≥ 1 / (1 + resamples) do not change.

    Raises:
        ValueError: no pairs, or a difference that is not finite.

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
    """Two-sided p-value of H0: both samples come from the same distribution.

    p = P(|mean(x*) - mean(y*)| ≥ |mean(x) - mean(y)|) over random relabellings of all trials

    Exact by enumeration if the number of relabellings is at most ``resamples``; otherwise Monte
    Carlo as in :func:`sign_flip_test`. For independent samples only; for pairs use sign flips.
    ``tail`` has the same meaning with Hoeffding's bound p ≤ 2 exp(-2 (Σ x_i - n_x m)² / n
    (max - min)²), where m is the mean and max - min the range of all values, n = min(n_x, n_y).

    Raises:
        ValueError: an empty sample, or a value that is not finite.

    Source: Phipson & Smyth, Statistical Applications in Genetics 9 (2010); Hoeffding (1963),
    theorem 2 and §6, draws without replacement.

    >>> label_permutation_test([1.0, 2.0], [3.0, 4.0], np.random.default_rng(0)) * 6
    2.0

    """
    a, b = two_samples(x, y)
    pooled = np.concatenate([a, b])
    # The total is fixed, so the difference of means is a linear function of the sum of x.
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
    """(1 + #{|drawn| ≥ least}) / (1 + resamples); without hits 2 exp(-u / v) if smaller."""
    rows = max(1, BATCH // n)
    hits = sum(
        int(np.count_nonzero(np.abs(draw(min(rows, resamples - start))) >= least))
        for start in range(0, resamples, rows)
    )
    p = (1 + hits) / (1 + resamples)
    if hits or bound is None:
        return p
    # e^-700 is still positive, and small enough for every correction.
    return min(p, 2.0 * exp(-min(float(bound[0] / bound[1]), 700.0)))


def _tolerated(observed: float, values: NDArray[np.float64]) -> float:
    # Equal sums may differ in their last bits if added in another order; they count as ties.
    return observed - 1e-10 * float(np.abs(values).sum())
