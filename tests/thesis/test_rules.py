"""Verdicts from intervals and tests, and how they combine."""

from __future__ import annotations

import numpy as np
import pytest

from trl_explore.statistics.samples import Sample
from trl_explore.thesis import Finding, Verdict, rules


def constant(verdict: Verdict, needed: int | None = None) -> rules.Rule:
    return lambda level: Finding(verdict, f"{verdict} {level:g}", needed)


def test_conjunction():
    holds, fails = constant("holds"), constant("does not hold")
    assert rules.all_of([holds, holds], 0.95).verdict == "holds"
    assert rules.all_of([holds, fails], 0.95).evidence == "does not hold 0.975"
    waiting = rules.all_of([holds, constant("open", 40), constant("open", 90)], 0.95)
    assert (waiting.verdict, waiting.trials_needed) == ("open", 90)
    assert rules.all_of([constant("open", 40), constant("open")], 0.95).trials_needed is None


def test_conjunction_corrects_what_refutes_it():
    def weak(level: float) -> Finding:
        return Finding("does not hold", "") if level < 0.96 else Finding("open", "", 9)

    assert rules.all_of([weak], 0.95).verdict == "does not hold"
    both = rules.all_of([weak, constant("holds")], 0.95)
    assert (both.verdict, both.trials_needed) == ("open", 9)


def test_five_pairs_settle_nothing():
    a, b = Sample.of(np.arange(5.0)), Sample.of(100 + 2 * np.arange(5.0))
    found = rules.mean_less(a, b)(0.95)
    assert (found.verdict, found.trials_needed) == ("open", None)
    six = [Sample.of([*s.values, last]) for s, last in ((a, 5.0), (b, 110.0))]
    assert rules.mean_less(*six)(0.95).verdict == "holds"


def test_never_and_some_are_contrary():
    assert [rules.never(k, n, "x")(0.95).verdict for k, n in ((0, 30), (0, 400), (5, 100))] == [
        "open", "holds", "does not hold",
    ]  # fmt: skip
    for count, n in ((0, 30), (0, 400), (5, 100)):
        a, b = rules.never(count, n, "x")(0.95), rules.some(count, n, "x")(0.95)
        swap = {"holds": "does not hold", "does not hold": "holds", "open": "open"}
        assert b.verdict == swap[a.verdict]
        assert a.evidence == b.evidence


def test_one_truth_for_every_number_of_trials(rng):
    # 1.7 % fail. "Some fail" is never decided wrongly, nor is "none fails", at any n.
    for n in (30, 100, 1000):
        wrong = sum(
            rules.some(k, n, "x")(0.95).verdict == "does not hold"
            for k in rng.binomial(n, 0.017, 500)
        )
        assert wrong / 500 <= 0.05


def test_within():
    e = Sample.of([0.9, 1.0, 1.1] * 20)
    assert rules.mean_within(e, 0.8, 1.25, "x")(0.95).verdict == "holds"
    assert rules.mean_within(e, 1.2, 1.5, "x")(0.95).verdict == "does not hold"
    found = rules.mean_within(e, 1.015, 1.5, "x")(0.95)
    # Half-width 2.001 · 0.0823 / √60 = 0.0213, gap 0.015.
    assert (found.verdict, found.trials_needed) == ("open", pytest.approx(247, abs=5))


def test_a_ratio_of_means_is_decided_by_differences():
    a, b = Sample.of([90.0, 100.0, 110.0] * 20), Sample.of([95.0, 100.0, 105.0] * 20)
    for low, high, verdict in (
        (0.8, 1.25, "holds"), (0.0, 0.5, "does not hold"), (1.2, 2.0, "does not hold"),
        (1.0, 2.0, "open"), (0.0, 1.5, "holds"),
    ):  # fmt: skip
        assert rules.mean_ratio(a, b, low, high, "x")(0.95).verdict == verdict


def test_mean_of_nothing_is_open():
    empty, some = Sample.of([], label="none"), Sample.of(np.ones(3))
    found = rules.mean_less(some, empty)(0.95)
    assert (found.verdict, found.evidence) == ("open", "none: no trial to average")


def test_false_verdicts_are_rare(rng):
    """Two equal configurations of 20 trials: a verdict is an error, at most about 5 %."""
    wrong = 0
    for _ in range(200):
        a, b = (Sample.of(rng.integers(100, 400, size=20).astype(float)) for _ in range(2))
        wrong += rules.mean_less(a, b)(0.95).verdict != "open"
    assert wrong / 200 < 0.1
