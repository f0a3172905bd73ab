"""Rules that turn an interval or a test into a verdict.

Words of the thesis, and their meaning for the probability p that a trial passes:

    never                     p < 1 %
    always, all               p > 99 %
    some fail                 p < 99 %
    consistently              p > 90 %
    almost consistently,
    almost every time         p > 80 %
    mostly, most of the time  p > 50 %

Every statement is true or false of p, whatever the number of trials: more trials can settle it, but
not turn it into its opposite.

Each claim is decided separately at the given level. A claim of several parts holds if every part
holds at that level (an intersection-union test, which needs no correction), and fails if one of its
k parts fails at 1 - (1 - level)/k (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import groupby
from math import sqrt
from typing import Literal

import numpy as np

from trl_explore.statistics.estimates import Estimate, combination, decimals, exact_rate
from trl_explore.statistics.means import mean_difference, mean_interval
from trl_explore.statistics.power import trials_for_rate_bound, trials_to_settle
from trl_explore.statistics.samples import Sample
from trl_explore.thesis.study import NotMeasuredError, Study, Unit

RARELY = 0.01
"""The margin of "never" and "some"."""
THESIS_COSTS = (1.0, 10.0)
"""What an iteration costs in the thesis's program, in addition to its frames, in frames."""
COSTS = (0.0, *THESIS_COSTS, 30.0, 100.0, 1000.0)

Verdict = Literal["holds", "does not hold", "open", "not measured"]
HOLDS: Verdict = "holds"
FAILS: Verdict = "does not hold"
OPEN: Verdict = "open"
NOT_MEASURED: Verdict = "not measured"
VERDICTS: tuple[Verdict, ...] = (HOLDS, FAILS, OPEN, NOT_MEASURED)


@dataclass(frozen=True)
class Finding:
    """The verdict on a claim, and the numbers, intervals and tests that lead to it.

    ``trials_needed``: for an open claim, trials per configuration that would settle it with 80 %
    power if the current estimates were exact; ``inf``: more than can be run; None if the estimates
    are too uncertain to say. For claims about the trials that converge, only those are counted.
    """

    verdict: Verdict
    evidence: str
    trials_needed: float | None = None


Rule = Callable[[float], Finding]
"""Confidence level -> finding."""
Decision = Callable[[Study], Finding]
"""Study -> finding; may raise :class:`NotMeasuredError`."""
UnitDecision = Callable[[Study, Unit], Finding]
"""The same with a unit as second argument: ``iterations``, ``s``, or a cost of iterations."""


def share(
    count: float, n: int, what: str, *, above: float | None = None, below: float | None = None
) -> Rule:
    """Share of trials p > ``above``, or p < ``below``, by the exact interval.

    ``what`` follows the count in the evidence: "28 of 30 *softmax trials pass*".
    """
    if above is None:
        assert below is not None
        return contrary(share(count, n, what, above=below))

    def rule(level: float) -> Finding:
        p = exact_rate(count, n, level=level)
        verdict = decided(p.above(above), p.below(above))
        needed = trials_for_rate_bound(p.value, above, level=level)
        if 0 < count < n and abs(p.value - above) < sqrt(above * (1 - above) / n):
            needed = None
        text = f"{count:,.10g} of {n:,} {what}: {percent(p)}"
        return Finding(verdict, text, more(verdict, needed, n))

    return rule


def never(count: int, n: int, what: str) -> Rule:
    """Fewer than 1 % of trials do ``what``."""
    return share(count, n, what, below=RARELY)


def some(count: int, n: int, what: str) -> Rule:
    """More than 1 % of trials do ``what``: the negation of :func:`never`."""
    return share(count, n, what, above=RARELY)


def mean_less(a: Sample, b: Sample) -> Rule:
    """mean(a) < mean(b), by the interval of the difference; paired if possible."""
    difference = cache(lambda: mean_difference(a, b))

    def rule(level: float) -> Finding:
        if min(len(a), len(b)) == 0:
            empty = a if len(a) == 0 else b
            return Finding(OPEN, f"{empty.label}: no trial to average")
        d = difference().to(level)
        verdict = decided(d.sign() < 0, d.sign() > 0)
        design = f"{d.n:,} pairs" if d.paired else f"{len(a):,} and {len(b):,} trials"
        first, second = (f"({x})" if " = " in x else x for x in (a.label, b.label))
        text = (
            f"{first} minus {second} {interval(d.estimate, a.unit)},"
            f" p {p_value(d.p_value)} ({design})"
        )
        needed = trials_to_settle(d.estimate, 0.0, d.n)
        return Finding(verdict, text, more(verdict, needed, d.n))

    return rule


def mean_ratio(a: Sample, b: Sample, low: float, high: float, what: str) -> Rule:
    """``low`` ≤ mean(a) / mean(b) ≤ ``high``, for positive means.

    Decided without a ratio: the interval of mean(a) - high · mean(b) lies below 0, and that of
    mean(a) - low · mean(b) above 0. It fails if one of them lies on the other side.
    """
    differences = cache(lambda: [mean_difference(a, b.scaled(r)) for r in (low, high) if r > 0])

    def rule(level: float) -> Finding:
        if min(len(a), len(b)) == 0:
            return Finding(OPEN, f"{what}: no trial to average")
        tests = [d.to(level) for d in differences()]
        signs = [t.sign() for t in tests]
        wanted = [1] * (low > 0) + [-1]
        verdict = decided(signs == wanted, any(s == -w for s, w in zip(signs, wanted, strict=True)))
        ratio = a.values.mean() / b.values.mean()
        bounds = f"at most {high:g}" if low == 0 else f"{low:g} to {high:g}"
        return Finding(verdict, f"{what} {ratio:.3g} (asked: {bounds}; {tests[0].n:,} trials)")

    return rule


def mean_within(sample: Sample, low: float, high: float, what: str) -> Rule:
    """The mean lies in [low, high]: holds if its interval lies inside, fails if outside."""

    def rule(level: float) -> Finding:
        e = mean_interval(sample, level=level)
        verdict = decided(e.inside(low, high), e.outside(low, high))
        nearest = low if abs(e.value - low) < abs(e.value - high) else high
        needed = trials_to_settle(e, nearest, len(sample))
        return Finding(verdict, f"{what} {interval(e)}", more(verdict, needed, len(sample)))

    return rule


def quantiles_above_zero(sample: Sample, weights: Sequence[tuple[float, float]], what: str) -> Rule:
    """Σ w · quantile(p) > 0 for pairs (p, w), from exact intervals of the quantiles."""

    def rule(level: float) -> Finding:
        e = combination(sample.values, weights, level=level)
        text = f"{what} {interval(e, sample.unit)} ({len(sample):,} trials)"
        return Finding(decided(e.above(0.0), e.below(0.0)), text)

    return rule


def all_of(rules: Sequence[Rule], level: float) -> Finding:
    """Conjunction, as described in the module; the evidence is that of the deciding parts."""
    findings = [rule(level) for rule in rules]
    if len(rules) == 1:
        return findings[0]
    strict = [rule(1.0 - (1.0 - level) / len(rules)) for rule in rules]
    if any(f.verdict == FAILS for f in strict):
        return Finding(FAILS, _join([f.evidence for f in strict if f.verdict == FAILS]))
    if all(f.verdict == HOLDS for f in findings):
        return Finding(HOLDS, _join([f.evidence for f in findings]))
    # A part that fails only without the correction is open.
    undecided = [
        f if f.verdict == OPEN else s
        for f, s in zip(findings, strict, strict=True)
        if f.verdict != HOLDS
    ]
    numbers = [f.trials_needed for f in undecided]
    known = [n for n in numbers if n is not None]
    needed = max(known) if len(known) == len(numbers) else None
    return Finding(OPEN, "undecided: " + _join([f.evidence for f in undecided]), needed)


def any_of(rules: Sequence[Rule]) -> Rule:
    """Disjunction: holds if one part holds after Bonferroni, fails if every part fails."""
    return contrary(lambda level: all_of([contrary(rule) for rule in rules], level))


def in_time(decide: UnitDecision) -> Decision:
    """Decide on the time that a trial takes, for every cost of an iteration.

    time = frames + κ · iterations, in the time of a frame

    κ is what an iteration costs in addition to its frames: between 1 and 10 in the thesis's
    program, more where a frame is fast. The verdict is that for the thesis's κ; the evidence states
    for which κ of ``COSTS`` each verdict holds, and what the seconds of trials timed alone say.
    """

    def over_costs(study: Study) -> Finding:
        found = [(cost, decide(study, cost)) for cost in COSTS]
        thesis = [finding for cost, finding in found if cost in THESIS_COSTS]
        agreed = {finding.verdict for finding in thesis}
        ranges = []
        for verdict, group in groupby(found, key=lambda pair: pair[1].verdict):
            costs = [f"{cost:,g}" for cost, _ in group]
            ends = costs[0] if len(costs) == 1 else f"{costs[0]} to {costs[-1]}"
            ranges.append(f"{ends} frames: {verdict}")
        text = f"{thesis[-1].evidence}, if an iteration costs {THESIS_COSTS[-1]:g} frames."
        text += f" By the cost of an iteration, {'; '.join(ranges)}."
        try:
            seconds = decide(study, "s")
            text += f" Timed alone on this computer: {seconds.verdict} ({seconds.evidence})."
        except NotMeasuredError:
            pass
        verdict = thesis[-1].verdict if len(agreed) == 1 else OPEN
        needed = thesis[-1].trials_needed if verdict == OPEN else None
        return Finding(verdict, text, needed)

    return over_costs


def decided(holds: bool, fails: bool) -> Verdict:
    """Verdict from two exclusive conditions; open if neither is true."""
    return HOLDS if holds else FAILS if fails else OPEN


def percent(rate: Estimate) -> str:
    """Write a proportion with its interval."""
    value, low, high = 100 * rate.value, 100 * rate.low, 100 * rate.high
    digits = max(decimals(Estimate(value, low, high)), 1)
    return (
        f"{value:.{digits}f} %, {100 * rate.level:.3g} % interval"
        f" {low:.{digits}f} to {high:.{digits}f} %"
    )


def interval(e: Estimate, unit: str = "") -> str:
    """Write a quantity with its interval."""
    if not np.isfinite([e.low, e.high]).all():
        value = _signed(f"{e.value:.3g}")
        known = [
            f"{word} {_signed(f'{bound:.3g}')}"
            for word, bound in (("at least", e.low), ("at most", e.high))
            if np.isfinite(bound)
        ]
        return f"{value} {unit}".strip() + f" ({known[0] if known else 'no interval'})"
    digits = decimals(e)
    value, low, high = (_signed(f"{x:,.{digits}f}") for x in (e.value, e.low, e.high))
    return f"{value} {unit}".strip() + f", {100 * e.level:.3g} % interval {low} to {high}"


def p_value(p: float) -> str:
    """Write a p-value after its name.

    >>> p_value(0.0321), p_value(1e-30)
    ('= 0.032', '< 1e-10')
    """
    return "< 1e-10" if p < 1e-10 else f"= {p:.2g}" if p >= 0.001 else f"= {p:.0e}"


def _signed(number: str) -> str:
    return f"−{number[1:]}" if number.startswith("-") else number


def contrary(rule: Rule) -> Rule:
    """Negation: swaps ``holds`` and ``does not hold``; other verdicts stay."""
    swapped: dict[Verdict, Verdict] = {HOLDS: FAILS, FAILS: HOLDS}

    def negated(level: float) -> Finding:
        finding = rule(level)
        return replace(finding, verdict=swapped.get(finding.verdict, finding.verdict))

    return negated


def more(verdict: Verdict, needed: float | None, n: int) -> float | None:
    """Trials that an open claim needs: ``needed``, but at least n + 1."""
    if verdict != OPEN or needed is None:
        return None
    # The approximation may give fewer than n, but n trials did not settle the claim.
    return max(needed, n + 1)


def _join(texts: Sequence[str]) -> str:
    rest = len(texts) - 4
    return "; ".join(texts[:4]) + (f"; and {rest} more" if rest > 0 else "")
