"""Rules that turn an interval or a test into a verdict.

Words of the thesis, and their meaning for the probability p that a trial passes:

    never, always, all        no exception among the trials, and the interval of p within 5 % of it
    consistently              p > 90 %
    almost consistently,
    almost every time         p > 80 %
    mostly, most of the time  p > 50 %

Each claim is decided separately at the given level. A claim of several parts holds if every part
holds at that level (an intersection-union test, which needs no correction), and fails if one of its
k parts fails at 1 - (1 - level)/k (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import Literal

import numpy as np

from trl_explore.statistics.bootstrap import RESAMPLES
from trl_explore.statistics.comparisons import mean_difference
from trl_explore.statistics.estimates import Estimate, normal_quantile, pass_rate
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.pairing import common
from trl_explore.statistics.power import trials_for_difference, trials_for_rate_bound
from trl_explore.thesis.study import NotMeasuredError, Sample, Study

NEVER, CONSISTENTLY, ALMOST_ALWAYS, MOSTLY = 0.05, 0.90, 0.80, 0.50

Verdict = Literal["holds", "does not hold", "open", "not measured"]
HOLDS: Verdict = "holds"
FAILS: Verdict = "does not hold"
OPEN: Verdict = "open"
NOT_MEASURED: Verdict = "not measured"
VERDICTS: tuple[Verdict, ...] = (HOLDS, FAILS, OPEN, NOT_MEASURED)


@dataclass(frozen=True)
class Finding:
    """The verdict on a claim.

    Attributes:
        verdict: ``holds``, ``does not hold``, ``open`` (these data decide neither), or
            ``not measured``.
        evidence: the numbers, intervals and tests that lead to the verdict.
        trials_needed: for an open claim, trials per configuration that would settle it with
            80 % power if the current estimates were exact; None if not computable. For claims
            about the trials that converge, only those are counted.

    """

    verdict: Verdict
    evidence: str
    trials_needed: int | None = None


Rule = Callable[[float], Finding]
"""Confidence level -> finding."""
Decision = Callable[[Study, np.random.Generator], Finding]
"""(Study, generator) -> finding; may raise :class:`NotMeasuredError`."""
UnitDecision = Callable[[Study, np.random.Generator, str], Finding]
"""The same with a unit as third argument: ``iterations``, ``frames`` or ``s``."""


def share(
    count: float, n: int, what: str, *, above: float | None = None, below: float | None = None
) -> Rule:
    """Share of trials p > ``above``, or p < ``below``, by Wilson's interval.

    ``what`` follows the count in the evidence: "28 of 30 *softmax trials pass*".
    """
    if above is None:
        assert below is not None
        return contrary(share(count, n, what, above=below))
    return _rate(count, n, what, above, lambda p: decided(p.above(above), p.below(above)))


def passing(o: Outcomes, what: str, **bound: float) -> Rule:
    """:func:`share` of the trials that pass."""
    return share(int(o.converged.sum()), len(o), what, **bound)


def never(count: int, n: int, what: str) -> Rule:
    """No trial does ``what``: fails with one; holds with none and Wilson's upper bound < 5 %."""
    return _rate(count, n, what, NEVER, lambda p: decided(count == 0 and p.below(NEVER), count > 0))


def some(count: int, n: int, what: str) -> Rule:
    """At least one trial does ``what``: the negation of :func:`never`."""
    return contrary(never(count, n, what))


def mean_less(
    a: Sample, b: Sample, rng: np.random.Generator, *, resamples: int = RESAMPLES
) -> Rule:
    """mean(a) < mean(b), by both bootstrap interval and permutation test; paired if possible."""

    def rule(level: float) -> Finding:
        if min(len(a), len(b)) == 0:
            empty = a if len(a) == 0 else b
            return Finding(OPEN, f"{empty.label}: no trial to average")
        x, y, paired = align(a, b)
        d = mean_difference(x, y, rng, paired=paired, level=level, resamples=resamples)
        verdict = decided(d.sign() < 0, d.sign() > 0)
        design = f"{d.n} pairs" if paired else f"{len(x)} and {len(y)} trials"
        text = (
            f"{a.label} minus {b.label} {interval(d.estimate, a.unit)},"
            f" p = {p_value(d.p_value)} ({design})"
        )
        needed = trials_for_difference(d.sd, d.estimate.value, level=level)
        return Finding(verdict, text, more(verdict, needed, d.n))

    return rule


def within(
    estimate: Callable[[float], Estimate], n: int, low: float, high: float, what: str
) -> Rule:
    """θ in [low, high]: holds if its interval lies inside, fails if it lies outside.

    One bound may be infinite. ``n`` is the number of trials of the estimate.
    """

    def rule(level: float) -> Finding:
        theta = estimate(level)
        verdict = decided(theta.inside(low, high), theta.outside(low, high))
        gap = min(abs(theta.value - low), abs(theta.value - high))
        sd = (theta.high - theta.low) / (2.0 * normal_quantile(level)) * sqrt(n)
        needed = trials_for_difference(sd, gap, level=level)
        return Finding(verdict, f"{what} {interval(theta)}", more(verdict, needed, n))

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


def in_iterations(decide: UnitDecision) -> Decision:
    """Decide in iterations, restricted to the cap."""
    return lambda study, rng: decide(study, rng, "iterations")


def in_seconds(decide: UnitDecision) -> Decision:
    """Decide in seconds; the evidence adds the verdict in frames, which is machine-independent.

    Without seconds the verdict is ``not measured``. Frames cannot replace seconds, because an
    iteration also has a fixed cost.
    """

    def both(study: Study, rng: np.random.Generator) -> Finding:
        rng_seconds, rng_frames = rng.spawn(2)
        frames = decide(study, rng_frames, "frames")
        beside = f"In frames: {frames.verdict} ({frames.evidence})."
        try:
            seconds = decide(study, rng_seconds, "s")
        except NotMeasuredError as missing:
            return Finding(NOT_MEASURED, f"{missing}. {beside}")
        return replace(seconds, evidence=f"{seconds.evidence}. {beside}")

    return both


def align(a: Sample, b: Sample) -> tuple[np.ndarray, np.ndarray, bool]:
    """Values of the common trials, as pairs; all values, unpaired, if there are none."""
    i, j = common(a.keys, b.keys)
    if len(i) == 0:
        return a.values, b.values, False
    return a.values[i], b.values[j], True


def decided(holds: bool, fails: bool) -> Verdict:
    """Verdict from two exclusive conditions; open if neither is true."""
    return HOLDS if holds else FAILS if fails else OPEN


def percent(rate: Estimate) -> str:
    """Write a proportion with its interval."""
    return (
        f"{100 * rate.value:.1f} %, {100 * rate.level:.3g} % interval"
        f" {100 * rate.low:.1f} to {100 * rate.high:.1f} %"
    )


def interval(e: Estimate, unit: str = "") -> str:
    """Write a quantity with its interval."""
    if np.isnan(e.low):
        return f"{_signed(f'{e.value:.3g}')} {unit}".strip() + " (no interval)"
    digits = _digits(max(abs(e.low), abs(e.high)))
    value, low, high = (_signed(f"{x:.{digits}f}") for x in (e.value, e.low, e.high))
    return f"{value} {unit}".strip() + f", {100 * e.level:.3g} % interval {low} to {high}"


def p_value(p: float) -> str:
    """Write a p-value."""
    return f"{p:.2g}" if p >= 0.001 else f"{p:.0e}"


def _signed(number: str) -> str:
    return f"−{number[1:]}" if number.startswith("-") else number


def _digits(size: float) -> int:
    return 3 if size < 1 else 2 if size < 10 else 1 if size < 1000 else 0


def contrary(rule: Rule) -> Rule:
    """Negation: swaps ``holds`` and ``does not hold``; other verdicts stay."""
    swapped: dict[Verdict, Verdict] = {HOLDS: FAILS, FAILS: HOLDS}

    def negated(level: float) -> Finding:
        finding = rule(level)
        return replace(finding, verdict=swapped.get(finding.verdict, finding.verdict))

    return negated


def _rate(
    count: float, n: int, what: str, bound: float, verdict_on: Callable[[Estimate], Verdict]
) -> Rule:
    def rule(level: float) -> Finding:
        p = pass_rate(count, n, level=level)
        verdict = verdict_on(p)
        needed = trials_for_rate_bound(p.value, bound, level=level)
        text = f"{count} of {n} {what}: {percent(p)}"
        return Finding(verdict, text, more(verdict, needed, n))

    return rule


def more(verdict: Verdict, needed: int | None, n: int) -> int | None:
    """Trials that an open claim needs: ``needed``, but at least n + 1."""
    if verdict != OPEN or needed is None:
        return None
    # The approximation may give fewer than n, but n trials did not settle the claim.
    return max(needed, n + 1)


def _join(texts: Sequence[str], most: int = 4) -> str:
    rest = len(texts) - most
    return "; ".join(texts[:most]) + (f"; and {rest} more" if rest > 0 else "")
