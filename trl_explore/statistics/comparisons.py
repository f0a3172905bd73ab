"""Two configurations side by side, and all pairs of a list with Holm's correction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from statsmodels.stats.multitest import multipletests

from trl_explore.statistics.bootstrap import RESAMPLES, streams
from trl_explore.statistics.differences import mean_difference
from trl_explore.statistics.estimates import LEVEL, Estimate
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.pairing import check_comparable, pair_indices, refuse_shared
from trl_explore.statistics.rank_tests import logrank_test, probability_faster
from trl_explore.statistics.survival import convergence_times


@dataclass(frozen=True)
class Comparison:
    """Configuration ``a`` against configuration ``b``, in iterations restricted to the cap.

    Attributes:
        a: name of the first configuration.
        b: name of the second.
        design: ``paired`` (by seed and trial index, on the trials both have), or ``unpaired``
            where they have none in common.
        n_a: trials of a that were compared.
        n_b: trials of b that were compared.
        dropped: trials of either that have no partner and were left out.
        cap: the common cap, iterations.
        mean_a: restricted mean of a over the compared trials, iterations.
        mean_b: the same for b.
        difference: mean_a - mean_b with bootstrap interval, iterations; negative: a is faster.
        p_value: permutation test of the difference (sign flips or labels), two-sided.
        p_holm: the same, corrected for all pairs of the table; equal to it for a single pair.
        p_logrank: log-rank test on the same trials, as a second opinion; it ignores the pairs.
        faster: probability that a converges before b, ties (both censored too) counting half.
        correlation: Pearson's r of the paired times; NaN where undefined.
        variance_ratio: Var(a - b) / (Var a + Var b); below 1 pairing helps. NaN where undefined.
        sd: standard deviation of a pair's difference, for the functions of ``power``.

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
        """The faster one, where interval and corrected test both exclude zero; else None."""
        if not self.p_holm <= 1.0 - self.difference.level + 1e-12:
            return None
        if self.difference.below(0.0):
            return self.a
        return self.b if self.difference.above(0.0) else None

    def row(self) -> dict[str, Any]:
        """Flat dictionary for a table; each estimate as ``x``, ``x_low``, ``x_high``."""
        return flat(self) | {"winner": self.winner}


def compare(
    a: Outcomes,
    b: Outcomes,
    rng: np.random.Generator,
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
    tail: bool = False,
) -> Comparison:
    """Compare the times to convergence of two configurations on the trials both have.

    Δ = E[min(T_a, cap)] - E[min(T_b, cap)]   (difference of restricted means)

    Args:
        a: first configuration [n_a].
        b: second configuration [n_b].
        rng: source of bootstrap and permutations.
        level: confidence level.
        resamples: of the bootstrap and of the test, each.
        tail: of the test, see :func:`sign_flip_test`.

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
    """Every pair of a list, in the list's order, with ``p_holm`` over all of them.

    Fewer than two configurations give an empty table.

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
    """Those pairs that were planned, with ``p_holm`` over them and no others.

    Raises:
        ValueError: as :func:`compare`.

    """
    rngs = streams(rng, [f"{a.name} | {b.name}" for a, b in pairs])
    # So many pairs that the smallest p of so many resamples, times their number, is no finding.
    tail = len(pairs) > (1.0 - level) * (1 + resamples)
    table = [
        compare(a, b, rngs[f"{a.name} | {b.name}"], level=level, resamples=resamples, tail=tail)
        for a, b in pairs
    ]
    corrected = holm([c.p_value for c in table])
    return [replace(c, p_holm=float(p)) for c, p in zip(table, corrected, strict=True)]


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm's step-down correction: p̃_(k) = max_{j ≤ k} min(1, (m - j + 1) p_(j)).

    Controls the probability of any false rejection under every dependence of the tests.

    Source: Holm, Scandinavian Journal of Statistics 6 (1979).

    >>> [round(p, 6) for p in holm([0.01, 0.04, 0.03])]
    [0.03, 0.06, 0.06]
    """
    if len(p_values) == 0:
        return []
    corrected: Any = multipletests(p_values, method="holm")[1]
    return [float(p) for p in corrected]


def flat(record: Any) -> dict[str, Any]:
    """Flatten a dataclass: an :class:`Estimate` becomes ``x``, ``x_low``, ``x_high``."""
    row: dict[str, Any] = {}
    for key, value in asdict(record).items():
        if isinstance(getattr(record, key), Estimate):
            row |= {key: value["value"], f"{key}_low": value["low"], f"{key}_high": value["high"]}
        else:
            row[key] = value
    return row
