"""Permutation tests of the difference of two means: sign flips (paired), labels (unpaired)."""

from __future__ import annotations

from itertools import combinations, product
from math import comb, exp

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

    Returns:
        p in (0, 1]; 1 when every difference is zero.

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
    hits = 0
    rows = max(1, BATCH // n)
    for start in range(0, resamples, rows):
        flips = rng.integers(2, size=(min(rows, resamples - start), n), dtype=np.int8)
        hits += int(np.count_nonzero(np.abs(d.sum() - 2.0 * (flips @ d)) >= least))
    if tail and not hits:
        return min(1 / (1 + resamples), _hoeffding(d.sum() ** 2 / (2.0 * (d @ d))))
    return (1 + hits) / (1 + resamples)


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
    max - min the range of all values, n the smaller of n_x and n_y.

    Args:
        x: first sample [n_x].
        y: second sample [n_y].
        rng: source of the relabellings (unused where the test is exact).
        resamples: number of random relabellings.
        tail: as in :func:`sign_flip_test`.

    Returns:
        p in (0, 1]; 1 when all values are equal.

    Raises:
        ValueError: an empty sample, or a value that is not finite.

    Source: Phipson & Smyth, Statistical Applications in Genetics 9 (2010); Hoeffding (1963),
    theorem 2 and §6, draws without replacement.

    >>> label_permutation_test([1.0, 2.0], [3.0, 4.0], np.random.default_rng(0)) * 6
    2.0

    """
    a, b = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if min(a.size, b.size) == 0 or not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ValueError(f"samples of {a.size} and {b.size}: each needs one value, all finite")
    pooled = np.concatenate([a, b])
    # With the total fixed, the difference of means is a linear function of the sum of x alone.
    expected = pooled.sum() * len(a) / len(pooled)
    least = _tolerated(abs(a.sum() - expected), pooled)
    n = len(pooled)
    if comb(n, len(a)) <= resamples:
        chosen = np.array(list(combinations(range(n), len(a))))
        return float(np.mean(np.abs(pooled[chosen].sum(axis=1) - expected) >= least))
    hits = 0
    rows = max(1, BATCH // n)
    for start in range(0, resamples, rows):
        order = np.tile(pooled, (min(rows, resamples - start), 1))
        rng.permuted(order, axis=1, out=order)
        hits += int(np.count_nonzero(np.abs(order[:, : len(a)].sum(1) - expected) >= least))
    if tail and not hits:
        spread = min(len(a), len(b)) * np.ptp(pooled) ** 2
        return min(1 / (1 + resamples), _hoeffding(2.0 * (a.sum() - expected) ** 2 / spread))
    return (1 + hits) / (1 + resamples)


def _hoeffding(exponent: float) -> float:
    # Never 0: e^-700 is a number yet, and small enough for every correction.
    return 2.0 * exp(-min(float(exponent), 700.0))


def _tolerated(observed: float, values: NDArray[np.float64]) -> float:
    # Equal sums differ in their last bits when added in another order; they are still ties.
    return observed - 1e-10 * float(np.abs(values).sum())
