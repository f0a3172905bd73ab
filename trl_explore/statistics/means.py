"""Means in which rare kinds of trials count: intervals and tests that allow for unseen failures.

If one trial in 60 fails, 30 trials often contain no failure. The mean then depends on trials that
were not seen, and neither the bootstrap nor Student's t allows for them. These intervals combine
the mean of the ordinary trials (Student's t), the rate of each rare kind (Wilson) and the mean of
its trials (Student's t, within the range that is possible; the whole range if fewer than two were
seen) by the method of variance estimates recovery (MOVER):

    θ = m + Σ_k q_k (f_k - m),   m mean of ordinary trials, q_k rate and f_k mean of kind k
    lower = θ̂ - √(l₀² + Σ_k l_k²),   upper = θ̂ + √(u₀² + Σ_k u_k²)

where l and u are the distances by which θ falls and rises if m, or q_k and f_k, move to the ends
of their own intervals. The difference of two means has

    lower = δ̂ - √(Σ_k (l_1k² + u_2k² - 2 r_k l_1k u_2k)),   upper with l and u exchanged

where r is Pearson's correlation of the pairs of ordinary trials, or φ of the paired failures with
Newcombe's correction; 0 without pairs. If there is only one kind, all this is Student's t.

Source: Zou & Donner, Statistics in Medicine 27 (2008); Donner & Zou, Statistical Methods in
Medical Research 21 (2012); Newcombe, Statistics in Medicine 17 (1998), 2635-2650, method 10.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations
from math import exp, hypot, inf, isinf, log, nan, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special

from trl_explore.statistics.estimates import LEVEL, Estimate, check_level, wilson
from trl_explore.statistics.power import least_p
from trl_explore.statistics.samples import Kind, Sample, common_trials

# The smallest p-value that is searched for.
LEAST_P = 1e-100


@dataclass(frozen=True)
class Distances:
    """From a mean to the ends of its interval: by ordinary trials, and by the rare kinds."""

    spread: float
    down: float = 0.0
    up: float = 0.0


@dataclass(frozen=True)
class MeanDifference:
    """mean(a) - mean(b) with its uncertainty.

    Attributes:
        p_value: two-sided: the smallest α at which the interval of level 1 - α excludes zero. At
            least 2 / 2ⁿ for n pairs, or 2 over the number of relabellings: no test without an
            assumption on the distribution can give less.
        n: number of pairs; if unpaired, the smaller sample size.
        sd: standard deviation of a paired difference, or √(s_a² + s_b²) if unpaired; in both
            designs the standard error with n trials each is about sd / √n.
        correlation: Pearson's r of the pairs; NaN if unpaired or without variance.
        variance_ratio: Var(a - b) / (Var a + Var b); a value below 1 means that pairing increases
            precision like 1 / ratio times the trials. NaN as for the correlation.
        at: level -> the estimate with its interval at that level.
    """

    estimate: Estimate
    p_value: float
    n: int
    paired: bool
    sd: float
    correlation: float
    variance_ratio: float
    at: Callable[[float], Estimate] = field(repr=False, compare=False)

    def to(self, level: float) -> MeanDifference:
        """The same at another level; only the estimate's interval depends on it."""
        return replace(self, estimate=self.at(level))

    def sign(self) -> int:
        """-1 or +1 if the interval, and so the test, excludes zero, otherwise 0."""
        return int(self.estimate.above(0.0)) - int(self.estimate.below(0.0))


def mean_interval(sample: Sample, *, level: float = LEVEL) -> Estimate:
    """Mean of a sample with its interval, which allows for failures that were not seen.

    The interval keeps to what is possible: no negative times, no scores beyond the sample's bounds.

    NaN bounds for a single trial.

    >>> e = mean_interval(Sample.of([100.0] * 30, [False] * 30, least=1000.0, most=1000.0))
    >>> e.value, e.low, round(e.high)
    (100.0, 100.0, 202)
    """
    check_level(level)
    if len(sample) == 0:
        raise ValueError(f"{sample.label}: a mean needs at least one trial")
    value = float(sample.values.mean())
    if len(sample) < 2:
        return Estimate(value, nan, nan, level)
    d = distances(sample.simplified())(1.0 - level)
    low, high = value - hypot(d.spread, d.down), value + hypot(d.spread, d.up)
    if sample.unit or sample.cap is not None:  # a time
        low = max(low, 0.0)
    if sample.cap is not None:
        high = min(high, sample.cap)
    return Estimate(value, low, high, level).within(*sample.bounds)


@dataclass(frozen=True)
class Moments:
    """The trials of one kind: how many, mean and standard deviation (n - 1) of their values."""

    n: int
    mean: float
    sd: float

    @classmethod
    def of(cls, x: NDArray[np.float64]) -> Moments:
        """The moments of values [n]; NaN for what is unknown."""
        sd = float(x.std(ddof=1)) if len(x) > 1 else nan
        return cls(len(x), float(x.mean()) if len(x) else nan, sd)

    def half(self, alpha: float) -> float:
        """Half-width of Student's interval of the mean; NaN for a single value."""
        if self.n < 2:
            return nan
        return float(-special.stdtrit(self.n - 1, alpha / 2.0)) * self.sd / sqrt(self.n)


def distances(sample: Sample) -> Callable[[float], Distances]:
    """α -> the distances from the mean to the ends of its interval at level 1 - α."""
    x, n, ordinary = sample.values, len(sample), Moments.of(sample.values[sample.ordinary])
    if not sample.kinds:
        return lambda alpha: Distances(ordinary.half(alpha))
    cap, value, m = sample.cap, float(x.mean()), ordinary.mean
    if ordinary.n < 2 and cap is not None:
        # The mean of passing trials is anything from 0 to the cap.
        def bounded(alpha: float) -> Distances:
            least = wilson(n - ordinary.n, n, _z(alpha))[0] * cap
            return Distances(0.0, value - least, cap - value)

        return bounded
    kinds = [(kind, Moments.of(x[kind.members])) for kind in sample.kinds]

    def combined(alpha: float) -> Distances:
        ends = [_ends(kind, seen, n, m, alpha) for kind, seen in kinds]
        down, up = sum(d * d for d, _ in ends), sum(u * u for _, u in ends)
        for (i, (_, first)), (j, (_, second)) in combinations(enumerate(kinds), 2):
            # A trial of one kind is not of the other: corr(q_i, q_j) = -√(odds_i odds_j). If one
            # kind lowers θ and the other raises it, their terms are positively correlated.
            if (first.mean - m) * (second.mean - m) < 0:
                r = sqrt(first.n * second.n / ((n - first.n) * (n - second.n)))
                down += 2 * r * ends[i][0] * ends[j][0]
                up += 2 * r * ends[i][1] * ends[j][1]
        return Distances(ordinary.n / n * ordinary.half(alpha), sqrt(down), sqrt(up))

    return combined


def _ends(kind: Kind, seen: Moments, n: int, m: float, alpha: float) -> tuple[float, float]:
    """How far q (f - m) can fall and rise, for the rate q and the mean f of a rare kind."""
    q, (q_low, q_high) = seen.n / n, wilson(seen.n, n, _z(alpha))
    known = kind.least == kind.most
    if seen.n < 2 and not known:
        value = q * (seen.mean - m) if seen.n else 0.0
        ends = [
            rate * (f - m) if rate > 0 else 0.0
            for rate in (q_low, q_high)
            for f in (kind.least, kind.most)
        ]
        return value - min(value, *ends), max(value, *ends) - value
    f, half = (kind.most, 0.0) if known else (seen.mean, seen.half(alpha))
    f_down, f_up = min(half, max(f - kind.least, 0.0)), min(half, max(kind.most - f, 0.0))
    fewer, more = (q - q_low) * (f - m), (q_high - q) * (f - m)
    return (hypot(max(fewer, -more), q_high * f_down), hypot(max(more, -fewer), q_high * f_up))


def mean_difference(a: Sample, b: Sample, *, level: float = LEVEL) -> MeanDifference:
    """δ̂ = mean(a) - mean(b) on the common trials, as pairs; on all trials if none are common.

    The bounds are NaN, and p is 1, for single trials. With so few trials that p cannot reach
    1 - ``level`` (five pairs at 95 %), the interval is infinite.

    >>> a, b = Sample.of([1, 2, 4, 5, 7, 8, 9]), Sample.of([2, 3, 5, 7, 9, 9, 11])
    >>> d = mean_difference(a, b)
    >>> round(d.estimate.value, 2), d.sign(), d.n
    (-1.43, -1, 7)
    """
    check_level(level)
    a, b, paired = common_trials(a, b)
    a, b = a.simplified(), b.simplified()
    x, y = a.values, b.values
    value, n = float(x.mean() - y.mean()), min(len(x), len(y))
    if n < 2:
        nothing = partial(Estimate, value, nan, nan)
        return MeanDifference(nothing(level), 1.0, n, paired, nan, nan, nan, nothing)
    first, second = distances(a), distances(b)
    r, phi = (_correlation(a, b), _phi(a, b)) if paired else (0.0, 0.0)
    floor = least_p(len(x), len(y), paired=paired)

    def bounds(alpha: float) -> tuple[float, float]:
        if alpha < floor:
            return -inf, inf
        p, q = first(alpha), second(alpha)
        spread = _combined(p.spread, q.spread, r)
        down, up = _combined(p.down, q.up, phi), _combined(p.up, q.down, phi)
        return value - sqrt(spread + down), value + sqrt(spread + up)

    def at(level: float) -> Estimate:
        return Estimate(value, *bounds(1.0 - level), level)

    differences = x - y if paired else None
    sd = float(
        np.sqrt(x.var(ddof=1) + y.var(ddof=1)) if differences is None else differences.std(ddof=1)
    )
    correlation = ratio = nan
    if differences is not None and np.ptp(x) > 0 and np.ptp(y) > 0:
        correlation = float(np.corrcoef(x, y)[0, 1])
        ratio = float(differences.var(ddof=1) / (x.var(ddof=1) + y.var(ddof=1)))
    p = _p_value(value, bounds, floor)
    return MeanDifference(at(level), p, n, paired, sd, correlation, ratio, at)


def _p_value(value: float, bounds: Callable[[float], tuple[float, float]], least: float) -> float:
    """The α at which the bound nearer to zero is zero."""
    if value == 0.0:
        return 1.0

    def excess(log_alpha: float) -> float:
        low, high = bounds(exp(log_alpha))
        return low if value > 0 else -high

    start, end = log(max(least, LEAST_P)), log(1.0 - 1e-9)
    if excess(end) <= 0.0:
        return 1.0
    if excess(start) >= 0.0:
        return exp(start)
    return exp(optimize.root_scalar(excess, bracket=(start, end), xtol=1e-6).root)


def _combined(x: float, y: float, r: float) -> float:
    """x² + y² - 2 r x y, at least 0; infinite if either is."""
    return inf if isinf(x) or isinf(y) else max(x * x + y * y - 2.0 * r * x * y, 0.0)


def _z(alpha: float) -> float:
    return float(-special.ndtri(alpha / 2.0))


def _correlation(a: Sample, b: Sample) -> float:
    """Pearson's r of the pairs of ordinary trials; 0 with fewer than three or without variance."""
    both = a.ordinary & b.ordinary
    x, y = a.values[both], b.values[both]
    if len(x) < 3 or np.ptp(x) == 0 or np.ptp(y) == 0:
        return 0.0
    return float(np.corrcoef(x, y)[0, 1])


def _phi(x: Sample, y: Sample) -> float:
    """φ of paired failures, smaller if positive (Newcombe); at most 0 with other rare kinds."""
    a, b = ~x.converged, ~y.converged
    n, both = len(a), float((a & b).sum())
    size = sqrt(a.sum() * (n - a.sum()) * b.sum() * (n - b.sum()))
    if size == 0:
        return 0.0
    product = both * (n - a.sum() - b.sum() + both) - (a.sum() - both) * (b.sum() - both)
    if product <= 0:
        return float(product) / size
    several = max(len(x.kinds), len(y.kinds)) > 1
    return 0.0 if several else max(float(product) - n / 2.0, 0.0) / size
