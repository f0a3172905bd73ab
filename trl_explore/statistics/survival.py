"""Right-censored times to convergence.

Kaplan-Meier curve and median, and the time per success, of one sample; log-rank test and
probability of being faster for two samples. Means of times are in ``means``.

A sample is ``durations`` [n], the times to convergence or censoring, positive and in any unit, and
``converged`` [n], whether each trial converged.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from math import hypot, inf, nan

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from trl_explore.statistics.estimates import (
    LEVEL,
    Estimate,
    check_level,
    normal_quantile,
    pass_rate,
    wilson,
)
from trl_explore.statistics.means import Moments
from trl_explore.statistics.samples import Sample


@dataclass(frozen=True, eq=False)
class SurvivalCurve:
    """Ŝ(t), the share of trials that have not converged by t: a right-continuous step function.

    All arrays have shape [k]: the time 0, every time at which a trial converged, and the
    horizon, in increasing order. Ŝ is constant from ``times[i]`` up to ``times[i + 1]``.

    Attributes:
        survival: Ŝ(times), in [0, 1]; ``low`` and ``high`` are its pointwise interval.
        at_risk: trials that have neither converged nor been censored before each time.
        events: trials that converged at each time.
        n: number of trials.
    """

    times: NDArray[np.float64]
    survival: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    at_risk: NDArray[np.int64]
    events: NDArray[np.int64]
    n: int
    level: float = LEVEL

    def at(self, times: ArrayLike) -> NDArray[np.float64]:
        """Ŝ at any times [m] ≥ 0; NaN beyond the horizon, where it is unknown."""
        t = np.asarray(times, dtype=np.float64)
        index = np.searchsorted(self.times, t, side="right") - 1
        return np.where(t > self.times[-1], np.nan, self.survival[index])


def kaplan_meier(
    durations: ArrayLike, converged: ArrayLike, *, level: float = LEVEL
) -> SurvivalCurve:
    """Kaplan-Meier estimator of P(T > t) with a pointwise log-log interval.

    Ŝ(t) = Π_{t_i ≤ t} (1 - d_i / n_i)
    interval = Ŝ^exp(±z σ),  σ² = Σ_{t_i ≤ t} d_i / (n_i (n_i - d_i)) / (log Ŝ)²

    with d_i trials converging at t_i and n_i at risk; at equal times, convergence comes before
    censoring. Where Ŝ is 1 or 0, Greenwood's variance is zero and the log-log interval is
    undefined. Wilson's interval with all n trials is used there, so that "none of 3 converged" is
    not shown as certainty.

    Raises:
        ValueError: no trials, unequal lengths, or a duration that is not positive and finite.

    Source: Kaplan & Meier, JASA 53 (1958); Kalbfleisch & Prentice, The Statistical Analysis of
    Failure Time Data (2002), §1.4.

    >>> kaplan_meier([1, 2, 3, 3], [True, True, True, False]).survival
    array([1.  , 0.75, 0.5 , 0.25])
    """
    check_level(level)
    t, e = _check(durations, converged)
    curve = stats.ecdf(_censored(t, e)).sf
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # the interval is NaN where Ŝ is 0 or 1
        band = curve.confidence_interval(level, method="log-log")
    # SciPy also lists times at which trials are only censored; of these, keep only the horizon.
    shown = np.isin(curve.quantiles, t[e]) | (curve.quantiles == t.max())
    times = np.concatenate([[0.0], curve.quantiles[shown]])
    survival, low, high = (
        np.concatenate([[start], f.probabilities[shown]])
        for start, f in ((1.0, curve), (np.nan, band.low), (np.nan, band.high))
    )
    certain = (survival < 1e-12) | (survival > 1.0 - 1e-12)
    wilson = len(t) / (len(t) + normal_quantile(level) ** 2)
    low = np.where(certain, np.where(survival > 0.5, wilson, 0.0), low)
    high = np.where(certain, np.where(survival > 0.5, 1.0, 1.0 - wilson), high)
    ends = np.sort(t[e])
    events = np.searchsorted(ends, times, "right") - np.searchsorted(ends, times, "left")
    at_risk = number_at_risk(t, times)
    return SurvivalCurve(times, survival, low, high, at_risk, events, len(t), level)


def number_at_risk(durations: ArrayLike, times: ArrayLike) -> NDArray[np.int64]:
    """n(t) = #{trials with duration ≥ t}, neither converged nor censored before the times t [m].

    >>> number_at_risk([5, 7, 7], [0, 5, 6, 8])
    array([3, 3, 2, 0])
    """
    t = np.sort(np.asarray(durations, dtype=np.float64))
    before = np.searchsorted(t, np.asarray(times, dtype=np.float64), side="left")
    return np.asarray(len(t) - before, dtype=np.int64)


def median_time(curve: SurvivalCurve) -> Estimate:
    """Median of T: the first t with Ŝ(t) ≤ ½; its interval holds the t whose interval contains ½.

    ``inf`` ("not reached") if the curve, or its bound, never falls to ½. The lower bound is 0 if
    even Ŝ = 1 is compatible with ½ (three trials or fewer).

    Source: Brookmeyer & Crowley, Biometrics 38 (1982).

    >>> median_time(kaplan_meier([1, 2, 3], [True, True, True])).value
    2.0
    """
    value, low, high = (
        float(curve.times[np.argmax(reached)]) if reached.any() else np.inf
        for reached in (band <= 0.5 + 1e-12 for band in (curve.survival, curve.low, curve.high))
    )
    return Estimate(value, low, high, curve.level)


def logrank_test(t_a: ArrayLike, e_a: ArrayLike, t_b: ArrayLike, e_b: ArrayLike) -> float:
    """Two-sided log-rank p-value of H0: both samples have the same survival curve.

    Treats the samples as independent; for positively correlated pairs it is conservative. If no
    trial converged in either sample, the curves are equal (constant) and p = 1.

    Source: Mantel, Cancer Chemotherapy Reports 50 (1966); ``scipy.stats.logrank``.
    """
    t = [np.asarray(x, dtype=np.float64) for x in (t_a, t_b)]
    e = [np.asarray(x, dtype=bool) for x in (e_a, e_b)]
    # There is also nothing to rank if all trials converge at the same time.
    informative = np.concatenate(t)[np.concatenate(e)]
    if len(informative) == 0 or not _varies(t[0], t[1], informative):
        return 1.0
    return float(stats.logrank(_censored(t[0], e[0]), _censored(t[1], e[1])).pvalue)


def time_per_success(times: Sample, *, level: float = LEVEL) -> Estimate:
    """ERT: expected time until the first success if failed trials are restarted.

    ERT = Σ_i time_i / #{converged} = m + f q / (1 - q), over all trials

    The interval is MOVER's for the sum of m (Student's t) and f times the odds of failing
    (Wilson). If no trial converges, the estimate is ``inf``, and m is anything from 0 to f.

    Source: Hansen et al., COCO: performance assessment (2016), §4.

    >>> time_per_success(Sample.of([100, 300], [False, True], least=300, most=300)).value
    400.0
    """
    check_level(level)
    n, passed = len(times), times.values[times.converged]
    if n == 0:
        raise ValueError(f"{times.label}: at least one trial is needed")
    failed = times.values[~times.converged]
    k = len(failed)
    f = float(failed.mean()) if k else times.kinds[0].most if times.kinds else 0.0
    least, most = (inf if q == 1.0 else q / (1.0 - q) for q in wilson(k, n, normal_quantile(level)))
    if k == n:
        return Estimate(inf, f * least if n > 1 else nan, inf, level)
    m, odds = float(passed.mean()), k / (n - k)
    value = m + f * odds
    if n == 1:
        return Estimate(value, nan, nan, level)
    half = Moments.of(passed).half(1.0 - level) if len(passed) > 1 else max(m, f - m)
    low, high = hypot(half, f * (odds - least)), hypot(half, f * (most - odds))
    return Estimate(value, max(value - low, 0.0), value + high, level)


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

    A trial that does not converge is later than every trial that does, even one that converges at
    the cap; two trials that do not converge are tied. Paired: the share over the pairs (same seed
    and trial). Unpaired: the share over all n_a · n_b combinations (Mann-Whitney). The interval is
    Wilson's with n = number of pairs, or min(n_a, n_b). The variance of either estimator is at
    most p(1 - p) / n, so the interval is conservative.

    Raises:
        ValueError: an empty sample, or unequal lengths if paired.

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


def _censored(t: NDArray[np.float64], converged: NDArray[np.bool_]) -> stats.CensoredData:
    return stats.CensoredData(uncensored=t[converged], right=t[~converged])


def _varies(t_a: np.ndarray, t_b: np.ndarray, events: np.ndarray) -> bool:
    """Whether, at some event time, both samples are at risk and not all trials converge."""
    common = events[(events <= t_a.max()) & (events <= t_b.max())]
    both = np.concatenate([t_a, t_b])
    return any((both >= s).sum() > (events == s).sum() for s in np.unique(common))


def _check(
    durations: ArrayLike, converged: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    t, e = np.asarray(durations, dtype=np.float64), np.asarray(converged, dtype=bool)
    if t.ndim != 1 or t.shape != e.shape or len(t) == 0:
        raise ValueError(f"durations {t.shape} and converged {e.shape}: both [n], with n ≥ 1")
    if not (np.isfinite(t).all() and (t > 0).all()):
        raise ValueError(f"durations from {t.min()} to {t.max()}: all must be positive and finite")
    return t, e
