"""Comparisons that are settled while trials are added, with the error held over all looks.

The trials of every configuration grow over planned looks, n_1 < ... < n_K. Look k may spend α_k of
the error α, where Σ α_k = α. At look k, the undecided pairs are tested with all trials so far, by
Holm's procedure at α_k, in which pairs that were decided earlier count as rejected. A pair that is
decided stays decided, and a configuration of which no pair is open gets no further trials.

The probability that any difference is found where there is none, at any look, is at most α, if each
test is valid with a fixed number of trials. Proof: take the first such error, and let it be at look
k. Every pair decided before really differs, so at least as many pairs are open as there are pairs
without a difference, m₀; Holm's bound for the pair was therefore at most α_k / m₀. An undecided
pair always has the planned number of trials, n_k. The probability that one of m₀ tests with n_k
trials is below α_k / m₀ is at most α_k, and the sum over the looks is α.

Nothing is gained from the correlation of the looks, as the group-sequential tests of Lan & DeMets,
Biometrika 70 (1983), or AdaStop (Mathieu et al., TMLR 2024) would; in return, any test can be used,
also one that allows for rare failures.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import nan

from trl_explore.statistics.estimates import LEVEL, Estimate, check_level
from trl_explore.statistics.means import MeanDifference, mean_difference
from trl_explore.statistics.samples import Sample

GROWTH = 1.5
"""Factor between the trials of two looks."""

NOTHING = Estimate(nan, nan, nan)
"""The difference before the first look."""

More = Callable[[Sequence[str], int], Mapping[str, Sample]]
"""Names of configurations, a number of trials -> the sample of each with that many trials."""


@dataclass(frozen=True)
class Verdict:
    """What is known of one pair of configurations.

    Attributes:
        result: ``a`` or ``b``: which mean is greater; ``equal``: within the margin; ``open``.
        difference: mean(a) - mean(b), with the interval of the look that decided, or the last one.
        trials: trials of each of the two at that look.
        look: the number of that look, from 1; 0 before the first.
    """

    a: str
    b: str
    result: str = "open"
    difference: Estimate = NOTHING
    trials: int = 0
    look: int = 0


def planned_looks(first: int, most: int) -> list[int]:
    """The number of trials of each look, from ``first`` to ``most``; each is ``GROWTH`` × the last.

    Raises:
        ValueError: not 2 ≤ first ≤ most.

    >>> planned_looks(20, 100)
    [20, 30, 45, 67, 100]
    """
    if not 2 <= first <= most:
        raise ValueError(f"first={first}, most={most}: 2 ≤ first ≤ most is needed")
    looks = [first]
    while looks[-1] * GROWTH < most:
        looks.append(max(int(looks[-1] * GROWTH), looks[-1] + 1))
    return looks if looks[-1] == most else [*looks, most]


def spending(looks: Sequence[int], *, level: float = LEVEL) -> list[float]:
    """The error α_k of each look, in proportion to the trials that it adds.

    α_k = α (n_k - n_{k-1}) / n_K,  α = 1 - level

    >>> [round(a, 3) for a in spending([20, 50, 100])]
    [0.01, 0.015, 0.025]
    """
    check_level(level)
    before = [0, *looks[:-1]]
    return [(1.0 - level) * (n - m) / looks[-1] for n, m in zip(looks, before, strict=True)]


def settle(
    pairs: Sequence[tuple[str, str]],
    more: More,
    looks: Sequence[int],
    *,
    level: float = LEVEL,
    margin: float | None = None,
    on_look: Callable[[Sequence[Verdict]], None] = lambda verdicts: None,
) -> list[Verdict]:
    """Add trials until every pair is decided, or the last look is over.

    Args:
        pairs: the pairs to compare.
        more: runs the configurations that are still needed; common keys of samples are pairs.
        looks: trials of each configuration at each look, from :func:`planned_looks`.
        level: 1 - α, over all pairs and looks.
        margin: differences smaller than this count as ``equal``. A pair is then decided as soon as
            its interval excludes 0 or lies within ±margin; the intervals of all pairs and looks
            contain the true differences with probability ``level`` (Bonferroni, not Holm).
        on_look: called with all verdicts after each look.

    Returns:
        A verdict for each pair, in order.
    """
    verdicts = [Verdict(a, b) for a, b in pairs]
    for k, (n, alpha) in enumerate(zip(looks, spending(looks, level=level), strict=True)):
        waiting = [i for i, v in enumerate(verdicts) if v.result == "open"]
        if not waiting:
            break
        samples = more(_names(verdicts[i] for i in waiting), n)
        tests = {
            i: mean_difference(samples[verdicts[i].a], samples[verdicts[i].b]) for i in waiting
        }
        steps = _look(tests, alpha, len(pairs), margin)
        for i, (estimate, result) in steps.items():
            verdicts[i] = replace(
                verdicts[i], difference=estimate, trials=n, look=k + 1,
                result={1: verdicts[i].a, -1: verdicts[i].b}.get(result, "equal")
                if result is not None else "open",
            )  # fmt: skip
        on_look(verdicts)
    return verdicts


def _look(
    tests: Mapping[int, MeanDifference], alpha: float, pairs: int, margin: float | None
) -> dict[int, tuple[Estimate, int | None]]:
    """The estimate of each test at the level of its step, and its decision: -1, 1, 0: equal, None.

    Holm's procedure: whenever a test rejects, the rest are tested at α over the number of the rest.
    """
    steps: dict[int, tuple[Estimate, int | None]] = {}
    waiting = dict(tests)
    while waiting:
        size = alpha / (len(waiting) if margin is None else pairs)
        found = {i: test.at(1.0 - size) for i, test in waiting.items()}
        signs = {i: int(e.above(0.0)) - int(e.below(0.0)) for i, e in found.items()}
        decided = {i for i, sign in signs.items() if sign}
        steps |= {i: (e, signs[i] or _equal(e, margin)) for i, e in found.items()}
        if not decided or margin is not None:
            break
        waiting = {i: test for i, test in waiting.items() if i not in decided}
    return steps


def _equal(e: Estimate, margin: float | None) -> int | None:
    return 0 if margin is not None and e.inside(-margin, margin) else None


def _names(verdicts: Iterable[Verdict]) -> list[str]:
    return list(dict.fromkeys(name for v in verdicts for name in (v.a, v.b)))
