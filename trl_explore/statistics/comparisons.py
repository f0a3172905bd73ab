"""Difference of two means; comparison of two configurations; many pairs with Holm's correction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trl_explore.statistics.bootstrap import RESAMPLES, bootstrap, mean, streams
from trl_explore.statistics.estimates import LEVEL, Estimate, flat
from trl_explore.statistics.outcomes import Outcomes, convergence_times
from trl_explore.statistics.pairing import check_comparable, pair_indices, refuse_shared
from trl_explore.statistics.permutation import (
    label_permutation_test,
    sign_flip_test,
    two_samples,
)
from trl_explore.statistics.survival import logrank_test, probability_faster


@dataclass(frozen=True)
class MeanDifference:
    """mean(x) - mean(y) with its uncertainty.

    Attributes:
        estimate: the difference with its bootstrap interval.
        p_value: two-sided; by sign flips if paired, otherwise by permuted labels.
        n: number of pairs; if unpaired, the smaller sample size.
        sd: standard deviation of a paired difference, or √(s_x² + s_y²) if unpaired; in both
            designs the standard error with n trials each is about sd / √n.
        correlation: Pearson's r of the pairs; NaN if unpaired or without variance.
        variance_ratio: Var(x - y) / (Var x + Var y); a value below 1 means that pairing increases
            precision like 1 / ratio times the trials. NaN as for the correlation.

    """

    estimate: Estimate
    p_value: float
    n: int
    sd: float
    correlation: float
    variance_ratio: float

    def sign(self) -> int:
        """-1 or +1 if interval and test both exclude zero at the estimate's level, otherwise 0.

        Both are required because, with few trials, the bootstrap interval is too short, and the
        permutation test does not give the size of the difference.
        """
        return _sign(self.estimate, self.p_value)


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

    Paired: pairs are resampled, and the signs of x_i - y_i flipped. Unpaired: each sample is
    resampled separately, and the labels permuted. For ``tail`` see :func:`sign_flip_test`.

    Raises:
        ValueError: an empty sample, values that are not finite, or unequal lengths if paired.

    Source: Efron & Tibshirani, An Introduction to the Bootstrap (1993), ch. 8, 13 and 15.

    >>> d = mean_difference([1, 2, 4], [2, 3, 5], np.random.default_rng(0), paired=True)
    >>> d.estimate.value, d.p_value, d.variance_ratio
    (-1.0, 0.25, 0.0)

    """
    a, b = two_samples(x, y)
    if not paired:
        estimate = bootstrap(
            lambda a, b: mean(a) - mean(b), [a, b], rng, level=level, resamples=resamples
        )
        p = label_permutation_test(a, b, rng, resamples=resamples, tail=tail)
        n = min(len(a), len(b))
        sd = float(np.sqrt(a.var(ddof=1) + b.var(ddof=1))) if n > 1 else np.nan
        return MeanDifference(estimate, p, n, sd, np.nan, np.nan)
    if len(a) != len(b):
        raise ValueError(f"{len(a)} and {len(b)} values: pairs need the same number")
    d, n = a - b, len(a)
    estimate = bootstrap(mean, [d], rng, level=level, resamples=resamples)
    p = sign_flip_test(d, rng, resamples=resamples, tail=tail)
    sd = float(d.std(ddof=1)) if n > 1 else np.nan
    if a.min() == a.max() or b.min() == b.max():
        return MeanDifference(estimate, p, n, sd, np.nan, np.nan)
    ratio = d.var(ddof=1) / (a.var(ddof=1) + b.var(ddof=1))
    return MeanDifference(estimate, p, n, sd, float(np.corrcoef(a, b)[0, 1]), float(ratio))


@dataclass(frozen=True)
class Comparison:
    """Comparison of configurations ``a`` and ``b`` in iterations, restricted to the cap.

    Attributes:
        a: name of the first configuration.
        b: name of the second.
        design: ``paired`` (by seed and trial index, on the common trials), or ``unpaired`` if
            there are no common trials.
        n_a: number of compared trials of a.
        n_b: number of compared trials of b.
        dropped: number of trials of a and b that were left out because they have no partner.
        cap: the common cap, iterations.
        mean_a: restricted mean of a over the compared trials, iterations.
        mean_b: the same for b.
        difference: mean_a - mean_b with bootstrap interval, iterations; negative: a is faster.
        p_value: permutation test of the difference (sign flips or labels), two-sided.
        p_holm: ``p_value`` after Holm's correction for all pairs of the table.
        p_logrank: log-rank test on the same trials, as an additional check; it ignores pairing.
        faster: probability that a converges before b; ties (also both censored) count half.
        correlation: Pearson's r of the paired times; NaN if undefined.
        variance_ratio: Var(a - b) / (Var a + Var b); below 1 pairing helps. NaN if undefined.
        sd: standard deviation of a paired difference, for the functions of ``power``.

    """

    a: str
    b: str
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
    faster: Estimate
    correlation: float
    variance_ratio: float
    sd: float

    @property
    def winner(self) -> str | None:
        """The faster configuration if interval and corrected test both exclude zero, or None."""
        return {-1: self.a, 1: self.b}.get(_sign(self.difference, self.p_holm))

    def row(self) -> dict[str, Any]:
        """Flat dictionary for a table; each estimate as ``x``, ``x_low``, ``x_high``."""
        return flat(vars(self)) | {"winner": self.winner}


def compare(
    a: Outcomes,
    b: Outcomes,
    rng: np.random.Generator,
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
    tail: bool = False,
) -> Comparison:
    """Compare the times to convergence of two configurations on their common trials.

    Δ = E[min(T_a, cap)] - E[min(T_b, cap)]   (difference of restricted means)

    Raises:
        ValueError: different cap, threshold or window; the same trials of the same
            configuration on both sides; unfinished jobs (see ``convergence_times``).

    Source: Royston & Parmar (2013) for the restricted mean; Colas et al., A Hitchhiker's Guide
    to Statistical Comparisons of Reinforcement Learning Algorithms (2019) for the tests.

    """
    check_comparable(a, b)
    refuse_shared([a, b])
    (t_a, e_a), (t_b, e_b) = convergence_times(a), convergence_times(b)
    i, j = pair_indices(a, b)
    paired = len(i) > 0
    if paired:
        t_a, e_a, t_b, e_b = t_a[i], e_a[i], t_b[j], e_b[j]
    result = mean_difference(
        t_a, t_b, rng, paired=paired, level=level, resamples=resamples, tail=tail
    )
    return Comparison(
        a=a.name,
        b=b.name,
        design="paired" if paired else "unpaired",
        n_a=len(t_a),
        n_b=len(t_b),
        dropped=len(a) + len(b) - len(t_a) - len(t_b),
        cap=a.cap,
        mean_a=float(t_a.mean()),
        mean_b=float(t_b.mean()),
        difference=result.estimate,
        p_value=result.p_value,
        p_holm=result.p_value,
        p_logrank=logrank_test(t_a, e_a, t_b, e_b),
        faster=probability_faster(t_a, e_a, t_b, e_b, paired=paired, level=level),
        correlation=result.correlation,
        variance_ratio=result.variance_ratio,
        sd=result.sd,
    )


def compare_all(
    configurations: Sequence[Outcomes],
    rng: np.random.Generator,
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
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
    return compare_pairs(
        list(combinations(configurations, 2)), rng, level=level, resamples=resamples
    )


def compare_pairs(
    pairs: Sequence[tuple[Outcomes, Outcomes]],
    rng: np.random.Generator,
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
) -> list[Comparison]:
    """Compare planned pairs, with ``p_holm`` over these pairs only.

    Raises:
        ValueError: as :func:`compare`.

    """
    rngs = streams(rng, [f"{a.name} | {b.name}" for a, b in pairs])
    # With too many pairs, even the smallest Monte Carlo p is not significant after correction.
    tail = len(pairs) > (1.0 - level) * (1 + resamples)
    table = [
        compare(a, b, rngs[f"{a.name} | {b.name}"], level=level, resamples=resamples, tail=tail)
        for a, b in pairs
    ]
    corrected = holm([c.p_value for c in table])
    return [replace(c, p_holm=float(p)) for c, p in zip(table, corrected, strict=True)]


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


def _sign(difference: Estimate, p_value: float) -> int:
    if not p_value <= 1.0 - difference.level + 1e-12:
        return 0
    return int(difference.above(0.0)) - int(difference.below(0.0))
