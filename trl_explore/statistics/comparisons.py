"""Comparison of two configurations in one measure; many pairs with Holm's correction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, count
from math import inf
from typing import Any

import numpy as np

from trl_explore.statistics import samples
from trl_explore.statistics.estimates import LEVEL, Estimate, flat
from trl_explore.statistics.means import MeanDifference, mean_difference
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.pairing import check_comparable, refuse_shared
from trl_explore.statistics.power import least_p
from trl_explore.statistics.samples import Sample, common_trials
from trl_explore.statistics.survival import logrank_test, probability_faster


@dataclass(frozen=True)
class Measure:
    """A quantity in which configurations are compared, and whether its smaller mean is better."""

    name: str
    of: Callable[[Outcomes], Sample]
    less_is_better: bool = False


ITERATIONS = Measure("iterations", samples.iterations, less_is_better=True)
"""Iterations to convergence, restricted to the cap."""
SCORE = Measure("score", samples.scores)
"""The final score; of outcomes that were judged by ``learned``, the learned score."""


@dataclass(frozen=True)
class Comparison:
    """Comparison of configurations ``a`` and ``b`` in the mean of one measure.

    Attributes:
        design: ``paired`` (by seed and trial index, on the common trials), or ``unpaired`` if
            there are no common trials.
        n_a, n_b: number of compared trials.
        dropped: trials of both that were left out: without a partner, or without a value.
        cap: the common cap, iterations.
        mean_a, mean_b: means over the compared trials; of iterations, restricted to the cap.
        difference: mean_a - mean_b. In a table of several pairs, the level of its interval is that
            of the pair's step in Holm's procedure, so that it excludes zero if and only if the
            difference is significant.
        p_value: two-sided test of the difference, the dual of its interval.
        p_holm: ``p_value`` after Holm's correction for all pairs of the table.
        p_logrank: the log-rank test of iterations, which ignores pairing; otherwise NaN.
        better: probability that a trial of a does better than one of b; ties count half. Of
            iterations: that a converges first; two trials that do not converge are tied.
        correlation: Pearson's r of the pairs; NaN if undefined.
        variance_ratio: Var(a - b) / (Var a + Var b); below 1 pairing helps. NaN if undefined.
        sd: standard deviation of a paired difference, for the functions of ``power``.
    """

    a: str
    b: str
    measure: str
    less_is_better: bool
    design: str
    n_a: int
    n_b: int
    dropped: int
    cap: int
    mean_a: float
    mean_b: float
    difference: Estimate
    p_value: float
    p_holm: float
    p_logrank: float
    better: Estimate
    correlation: float
    variance_ratio: float
    sd: float

    @property
    def winner(self) -> str | None:
        """The better configuration if the interval excludes zero, or None."""
        first = self.difference.below(0.0) if self.less_is_better else self.difference.above(0.0)
        second = self.difference.above(0.0) if self.less_is_better else self.difference.below(0.0)
        return self.a if first else self.b if second else None

    @property
    def same(self) -> str:
        """``identical`` if all pairs are; of times at the cap, ``neither passes``; else empty."""
        if self.sd != 0 or self.difference.value != 0:
            return ""
        return "neither passes" if self.less_is_better and self.mean_a == self.cap else "identical"

    def row(self) -> dict[str, Any]:
        """Flat dictionary for a table; each estimate as ``x``, ``x_low``, ``x_high``."""
        return flat(vars(self)) | {"winner": self.winner, "same": self.same}


def too_few(comparisons: Sequence[Comparison], *, level: float = LEVEL) -> int | None:
    """The fewest trials of each configuration with which any pair of a table can be significant.

    None if some pair can be, or there is none. Holm's first step compares with (1 - level) / pairs.
    """
    if not comparisons:
        return None
    alpha = (1.0 - level) / len(comparisons)
    designs = {c.design == "paired" for c in comparisons}
    if any(least_p(c.n_a, c.n_b, paired=c.design == "paired") <= alpha for c in comparisons):
        return None
    return next(n for n in count(2) if any(least_p(n, n, paired=d) <= alpha for d in designs))


def compare(
    a: Outcomes, b: Outcomes, measure: Measure = ITERATIONS, *, level: float = LEVEL
) -> Comparison:
    """Compare two configurations on their common trials: Δ = E[measure of a] - E[measure of b].

    Raises:
        ValueError: for times, different cap, threshold or window, or unfinished jobs (see
            ``convergence_times``); the same trials of the same configuration on both sides.

    Source: Royston & Parmar (2013) for the restricted mean; Colas et al., A Hitchhiker's Guide
    to Statistical Comparisons of Reinforcement Learning Algorithms (2019) for the tests.
    """
    return _compared(a, b, measure, level)[0]


def compare_all(
    configurations: Sequence[Outcomes], measure: Measure = ITERATIONS, *, level: float = LEVEL
) -> list[Comparison]:
    """Compare all pairs of configurations, in order, with ``p_holm`` over all pairs.

    Fewer than two configurations give an empty list.

    Raises:
        ValueError: as :func:`compare`; or two configurations with the same name.
    """
    names = [c.name for c in configurations]
    if len(set(names)) < len(names):
        twice = next(name for i, name in enumerate(names) if name in names[:i])
        raise ValueError(f"two configurations are named {twice!r}: a table needs unique names")
    return compare_pairs(list(combinations(configurations, 2)), measure, level=level)


def compare_pairs(
    pairs: Sequence[tuple[Outcomes, Outcomes]],
    measure: Measure = ITERATIONS,
    *,
    level: float = LEVEL,
) -> list[Comparison]:
    """Compare planned pairs, with ``p_holm`` over these pairs only.

    Raises:
        ValueError: as :func:`compare`.
    """
    table = [_compared(a, b, measure, level) for a, b in pairs]
    p = [comparison.p_value for comparison, _ in table]
    return [
        replace(comparison, p_holm=corrected, difference=result.at(step))
        for (comparison, result), corrected, step in zip(
            table, holm(p), holm_levels(p, level), strict=True
        )
    ]


def _compared(
    a: Outcomes, b: Outcomes, measure: Measure, level: float
) -> tuple[Comparison, MeanDifference]:
    if measure.less_is_better:
        check_comparable(a, b)
    refuse_shared([a, b])
    first, second = measure.of(a), measure.of(b)
    x, y, paired = common_trials(first, second)
    if not len(x) or not len(y):
        raise ValueError(f"{a.name} and {b.name}: no {measure.name} to compare")
    result = mean_difference(x, y, level=level)
    if measure.less_is_better:
        times = [(s.values, s.converged) for s in (x, y)]
        p_logrank = logrank_test(*times[0], *times[1])
        better = probability_faster(*times[0], *times[1], paired=paired, level=level)
    else:
        p_logrank, always = np.nan, [np.ones(len(s), dtype=bool) for s in (x, y)]
        better = probability_faster(
            -x.values, always[0], -y.values, always[1], paired=paired, level=level
        )
    comparison = Comparison(
        a=a.name, b=b.name, measure=measure.name, less_is_better=measure.less_is_better,
        design="paired" if paired else "unpaired", n_a=len(x), n_b=len(y),
        dropped=len(a) + len(b) - len(x) - len(y), cap=a.cap,
        mean_a=float(x.values.mean()), mean_b=float(y.values.mean()),
        difference=result.estimate, p_value=result.p_value, p_holm=result.p_value,
        p_logrank=p_logrank, better=better, correlation=result.correlation,
        variance_ratio=result.variance_ratio, sd=result.sd,
    )  # fmt: skip
    return comparison, result


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm's step-down correction: p̃_(k) = max_{j ≤ k} min(1, (m - j + 1) p_(j)).

    Controls the probability of any false rejection under any dependence between the tests.

    Source: Holm, Scandinavian Journal of Statistics 6 (1979).

    >>> [round(p, 6) for p in holm([0.01, 0.04, 0.03])]
    [0.03, 0.06, 0.06]
    """
    p = np.asarray(p_values, dtype=np.float64)
    order = np.argsort(p)
    corrected = np.empty_like(p)
    corrected[order] = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    return np.minimum(corrected, 1.0).tolist()


def holm_levels(p_values: Sequence[float], level: float = LEVEL) -> list[float]:
    """The confidence level of each test's step in Holm's procedure.

    1 - α / (m - k + 1) for the k-th smallest of m p-values; after the first test that is not
    rejected, its level for all the rest. An interval of that level excludes zero if and only if
    Holm rejects.

    >>> [round(1 - x, 4) for x in holm_levels([0.01, 0.04, 0.03])]
    [0.0167, 0.025, 0.025]
    """
    p, alpha = np.asarray(p_values, dtype=np.float64), 1.0 - level
    levels, stopped = np.empty(len(p)), inf
    for step, i in enumerate(np.argsort(p, kind="stable")):
        size = min(alpha / (len(p) - step), stopped)
        if p[i] > size:
            stopped = size
        levels[i] = 1.0 - size
    return levels.tolist()
