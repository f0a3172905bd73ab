"""Which of two samples of times to convergence is earlier: log-rank test, P(faster)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from trl_explore.statistics.estimates import LEVEL, Estimate
from trl_explore.statistics.proportions import pass_rate


def logrank_test(t_a: ArrayLike, e_a: ArrayLike, t_b: ArrayLike, e_b: ArrayLike) -> float:
    """Two-sided log-rank p-value of H0: both samples have the same survival curve.

    Treats the samples as independent; on positively correlated pairs it is conservative. Two
    samples without any converged trial have the same (constant) curve: p = 1.

    Args:
        t_a: durations of a [n_a].
        e_a: converged [n_a].
        t_b: durations of b [n_b].
        e_b: converged [n_b].

    Source: Mantel, Cancer Chemotherapy Reports 50 (1966); ``scipy.stats.logrank``.

    """
    t = [np.asarray(x, dtype=np.float64) for x in (t_a, t_b)]
    e = [np.asarray(x, dtype=bool) for x in (e_a, e_b)]
    # Nothing to rank either where all trials converge at one and the same time.
    informative = np.concatenate(t)[np.concatenate(e)]
    if len(informative) == 0 or not _varies(t[0], t[1], informative):
        return 1.0
    x, y = (stats.CensoredData(uncensored=d[c], right=d[~c]) for d, c in zip(t, e, strict=True))
    return float(stats.logrank(x, y).pvalue)


def probability_faster(
    t_a: ArrayLike,
    e_a: ArrayLike,
    t_b: ArrayLike,
    e_b: ArrayLike,
    *,
    paired: bool,
    level: float = LEVEL,
) -> Estimate:
    """P(T_a < T_b) + ½ P(T_a = T_b): the chance that a converges first.

    A trial that does not converge is later than every one that does, also than one that
    converges at the very cap; two that do not converge are tied. Paired: the share over the
    pairs (same seed and trial). Unpaired: the share over all n_a · n_b combinations
    (Mann-Whitney). The interval is Wilson's with n = number of pairs, or min(n_a, n_b): the
    variance of either estimator is at most p(1 - p) / n, so that the interval is conservative.

    Args:
        t_a: durations of a [n_a].
        e_a: converged [n_a].
        t_b: durations of b [n_b].
        e_b: converged [n_b].
        paired: the design; needs n_a = n_b.
        level: confidence level.

    Returns:
        Probability in [0, 1].

    Raises:
        ValueError: an empty sample, or unequal numbers where paired.

    Source: Birnbaum & Klose, Annals of Mathematical Statistics 28 (1957) for the bound.

    >>> probability_faster([1, 9], [1, 0], [2, 9], [1, 0], paired=True).value
    0.75

    """
    a = np.where(np.asarray(e_a, dtype=bool), t_a, np.inf)
    b = np.where(np.asarray(e_b, dtype=bool), t_b, np.inf)
    if min(len(a), len(b)) == 0 or (paired and len(a) != len(b)):
        raise ValueError(f"samples of {len(a)} and {len(b)} trials: none may be empty, pairs equal")
    if paired:
        value = float(np.mean((a < b) + 0.5 * (a == b)))
    else:
        ordered = np.sort(b)
        later = len(b) - np.searchsorted(ordered, a, side="right")
        tied = np.searchsorted(ordered, a, "right") - np.searchsorted(ordered, a, "left")
        value = float(np.mean(later + 0.5 * tied) / len(b))
    n = min(len(a), len(b))
    return pass_rate(value * n, n, level=level)


def _varies(t_a: np.ndarray, t_b: np.ndarray, events: np.ndarray) -> bool:
    """Whether at some event time both samples are at risk and not all of them converge."""
    common = events[(events <= t_a.max()) & (events <= t_b.max())]
    both = np.concatenate([t_a, t_b])
    return any((both >= s).sum() > (events == s).sum() for s in np.unique(common))
