"""The rule "learned": by hand, and its error rate by a small simulation."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest

from trl_explore.statistics.evaluations import (
    LEARNED,
    NOT_NOW,
    UNDECIDED,
    decide,
    evaluations_until,
    schedule,
    stages,
)

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def rule(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module("rule")


def verdict(scores, lowest, threshold=195.0, most=500) -> int:
    return int(decide(np.array([scores], float), np.array([lowest], float), threshold, most)[0])


def test_the_schedule_is_dense_early():
    found = schedule("auto", 1000)
    assert found is not None
    assert found[:13].tolist() == [*range(0, 51, 5), 55, 60]
    assert found[-1] == 1000
    late = found[found >= 50]
    steps = late[1:-1] / late[:-2]
    assert ((steps > 1.08) & (steps <= 1.1)).all()
    assert len(found) == 44
    assert (np.diff(found) > 0).all()
    assert schedule("auto", 3).tolist() == [0, 3]  # pyright: ignore[reportOptionalMemberAccess]


@pytest.mark.parametrize(
    ("last", "every", "cap", "expected"),
    [
        (12, "auto", 100, [0, 5, 10]),
        (12, "auto", 12, [0, 5, 10, 12]),
        (9, 4, 100, [0, 4, 8]),
        (9, 4, 9, [0, 4, 8, 9]),
        (8, 4, 8, [0, 4, 8]),
        (3, 10, 100, [0]),
    ],
)
def test_the_evaluations_of_a_trial(last, every, cap, expected):
    assert evaluations_until(last, every, cap).tolist() == expected


def test_the_stages():
    assert stages(500) == [20, 50, 100, 200, 500]
    assert stages(100) == [20, 50, 100]
    assert stages(20) == [20]
    assert stages(130) == [20, 50, 100, 130]


def test_the_rule_by_hand():
    """Ten episodes of 300 and ten of 500, and two imagined ones of 9, the trial's lowest score."""
    scores = [300.0, 500.0] * 10
    both = np.array([*scores, 9.0, 9.0])
    assert both.mean() - 4 * both.std(ddof=1) / np.sqrt(22) > 195
    assert verdict(scores, 9) == LEARNED
    both = np.array([*scores, -400.0, -400.0])
    assert both.mean() - 4 * both.std(ddof=1) / np.sqrt(22) < 195
    assert verdict(scores, -400) == UNDECIDED
    assert verdict(scores, -400, most=20) == NOT_NOW


def test_a_mean_at_or_below_the_threshold_ends_it():
    assert verdict([195.0] * 20, 9) == NOT_NOW
    assert verdict([9.0, 381.0] * 10, 9) == NOT_NOW
    assert verdict([9.0, 380.0] * 10, 9) == NOT_NOW


def test_it_is_given_up_where_all_episodes_would_not_suffice():
    """√500 · 10 < 4 · 60, and √500 · 10 > 4 · 50."""
    for sd, expected in ((60, NOT_NOW), (50, UNDECIDED)):
        scores = 205 + sd * np.sqrt(19 / 20) * np.tile([-1.0, 1.0], 10)
        assert np.std(scores, ddof=1) == pytest.approx(sd)
        assert verdict(scores, 9) == expected


def test_scores_that_do_not_differ():
    """Without a failure ever seen, n > 7.66 * 51 episodes are needed, however clear the margin."""
    for most in (500, 10**4):
        assert verdict([500.0] * 200, 500, most=most) == UNDECIDED
        assert verdict([500.0] * 400, 500, most=most) == LEARNED
    assert verdict([500.0] * 20, 9) == LEARNED
    # A rare disaster far below counts no more than 50 margins: Taxi, and its lowest score.
    assert verdict([8.0] * 500, -2000, threshold=7.0) == LEARNED


def test_trials_do_not_mix():
    scores = np.array([[500.0] * 20, [200.0] * 20, [9.0] * 20])
    assert decide(scores, np.full(3, 9.0), 195, 500).tolist() == [LEARNED, UNDECIDED, NOT_NOW]


@pytest.mark.parametrize(
    "shape",
    ["normal, sd 100", "9 or 500", "skewed to the left", "always the mean", "9 in 1 of 4",
     "9 in 1 of 20", "9 in 1 of 50"],
)  # fmt: skip
def test_trials_at_the_threshold_are_rarely_said_to_have_learned(rule, shape):
    """At most 5 %; 400 trials: more than 32 have a probability of 0.5 % at 5 %."""
    share, _ = rule.fooled(rule.SHAPES[shape](195.0), trials=400, most=500, seed=1)
    assert share <= 32 / 400
    share, _ = rule.fooled(rule.SHAPES[shape](0.9 * 195.0), trials=200, most=100, seed=2)
    assert share <= 0.01


def test_a_naive_rule_would_be_fooled(rule):
    """Without confirmation, two scores above the threshold are found in every trial."""
    rng = np.random.default_rng(0)
    scores = rule.SHAPES["normal, sd 100"](195.0)(rng, (100, 43, 20)).mean(2)
    assert (scores > 195).any(1).mean() > 0.99


def test_clear_trials_learn_at_once():
    """20 episodes suffice for a mean of 400 with a standard deviation of 100."""
    rng = np.random.default_rng(0)
    scores = np.minimum(rng.normal(420, 100, (200, 20)), 500)
    assert (decide(scores, np.full(200, 9.0), 195, 100) == LEARNED).mean() > 0.98
