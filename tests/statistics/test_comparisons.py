import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from trl_explore.statistics.comparisons import (
    SCORE,
    compare,
    compare_all,
    compare_pairs,
    holm,
    holm_levels,
    too_few,
)
from trl_explore.statistics.estimates import Estimate


@pytest.fixture
def fast(make, rng):
    return make(rng.integers(100, 200, size=30), strategy="softmax")


@pytest.fixture
def slow(make, rng):
    return make(rng.integers(300, 1300, size=30).clip(max=1000), strategy="epsilon_greedy")


@pytest.fixture
def failing(make):
    return make([1000] * 30, strategy="random")


def test_paired_comparison(fast, slow):
    c = compare(fast, slow)
    assert (c.a, c.b, c.design) == ("softmax", "epsilon_greedy", "paired")
    assert (c.n_a, c.n_b, c.dropped, c.cap) == (30, 30, 0, 1000)
    assert c.mean_a == pytest.approx(fast.iterations.mean())
    assert c.difference.value == pytest.approx((fast.durations - slow.durations).mean())
    assert c.difference.below(0)
    assert c.p_value == c.p_holm <= 0.001
    assert c.p_logrank < 0.001
    assert c.better.value == 1.0
    assert c.winner == "softmax"
    assert compare(slow, fast).winner == "softmax"


def test_hundreds_of_pairs_can_still_be_told_apart(make, rng):
    reference = make(rng.integers(100, 200, size=100), strategy="reference")
    slower = [make(rng.integers(300, 400, size=100), strategy=f"s{k}") for k in range(300)]
    table = compare_pairs([(reference, other) for other in slower])
    assert {c.winner for c in table} == {"reference"}


def test_only_common_trials_are_compared(make):
    a = make([100, 200, 300, 400], strategy="a")
    b = make([250, 350, 1000], strategy="b", first_trial=1)
    c = compare(a, b)
    assert (c.design, c.n_a, c.n_b, c.dropped) == ("paired", 3, 3, 1)
    assert (c.mean_a, c.mean_b) == (300.0, pytest.approx(1600 / 3))
    assert c.better.value == 1.0


def test_without_common_trials_it_is_unpaired(make):
    a, b = make([100, 200, 300]), make([400, 500], strategy="b", seed=1)
    c = compare(a, b)
    assert (c.design, c.n_a, c.n_b, c.dropped) == ("unpaired", 3, 2, 0)
    assert c.difference.value == -250.0
    # No test can do better than 2 of 10 relabellings, this one and its mirror image.
    assert c.p_value >= 2 / 10
    assert np.isnan([c.correlation, c.variance_ratio]).all()


def test_all_censored_against_all_censored(failing, make):
    c = compare(failing, make([1000] * 30, strategy="argmax"))
    assert (c.difference.value, c.p_value, c.p_logrank, c.better.value) == (0.0, 1.0, 1.0, 0.5)
    assert c.winner is None
    assert c.better.low < 0.5 < c.better.high


def test_all_censored_against_none(failing, fast):
    c = compare(failing, fast)
    assert c.winner == "softmax"
    assert c.better.value == 0.0
    assert np.isnan(c.correlation)


def test_diverged_trials_count_at_the_cap(make):
    a = make([100, 5], diverged=[1], converged=[1, 0])
    c = compare(a, make([300, 400], strategy="b"))
    assert c.mean_a == 550.0


def test_one_trial_each(make):
    c = compare(make([100]), make([200], strategy="b"))
    assert c.difference.value == -100.0
    assert np.isnan(c.difference.low)
    assert (c.p_value, c.winner) == (1.0, None)


def test_other_caps_and_same_trials_are_refused(fast, make):
    with pytest.raises(ValueError, match=r"cap 1000.*b.*5000"):
        compare(fast, make([100], strategy="b", cap=5000))
    with pytest.raises(ValueError, match="30 trials"):
        compare(fast, fast)


def test_all_pairs(fast, slow, failing):
    table = compare_all([fast, slow, failing])
    assert [(c.a, c.b) for c in table] == [
        ("softmax", "epsilon_greedy"),
        ("softmax", "random"),
        ("epsilon_greedy", "random"),
    ]
    assert [c.p_holm for c in table] == holm([c.p_value for c in table])
    assert all(c.p_holm >= c.p_value for c in table)
    again = compare_all([fast, slow, failing])
    assert [c.row() for c in table[:1]] == [c.row() for c in again[:1]]


def test_holm_decides_the_winner(make):
    # p = 0.031 alone; among three pairs, at 98.3 %, the interval is longer.
    base, step = np.arange(400) + 100, np.random.default_rng(5).normal(18, 100, 400).astype(int)
    a, b = make(base, strategy="a"), make((base + step).clip(1, 999), strategy="b")
    assert compare(a, b).winner == "a"
    table = compare_all([a, b, make(base[::-1].copy(), strategy="c")])
    assert [c.winner for c in table] == [None] * 3
    # Significance and the interval that is shown never contradict each other.
    assert [c.difference.level > 0.95 for c in table] == [True] * 3
    assert all(c.difference.low < 0 < c.difference.high for c in table)


def test_interval_and_corrected_test_agree_in_every_table(make, rng):
    for _ in range(20):
        jobs = [
            make((rng.integers(100, 500, 60) + rng.integers(0, 150)), strategy=f"s{k}")
            for k in range(5)
        ]
        for c in compare_all(jobs):
            outside = not c.difference.low <= 0.0 <= c.difference.high
            assert outside == (c.p_holm <= 0.05) == (c.winner is not None)


def test_all_pairs_of_nothing(fast):
    assert compare_all([]) == []
    assert compare_all([fast]) == []


def test_all_pairs_refuse(fast, make):
    with pytest.raises(ValueError, match="'softmax'"):
        compare_all([fast, make([1], parameters={"temperature": 2})])
    grid = make([100], name="again", experiment="grid")
    with pytest.raises(ValueError, match=r"thesis/softmax.*grid/again.*1 trial"):
        compare_all([fast, grid])


def test_row_is_flat(fast, slow):
    row = compare(fast, slow).row()
    assert row["difference"] < row["difference_high"] < 0
    assert row["better_low"] > 0.8
    assert row["winner"] == "softmax"
    assert not any(isinstance(v, Estimate | dict) for v in row.values())


def test_holm_by_hand():
    assert holm([]) == []
    assert holm([0.2]) == [0.2]
    # Sorted .01 .02 .03 .5, times 4 3 2 1: .04 .06 .06 .5
    assert holm([0.5, 0.01, 0.03, 0.02]) == pytest.approx([0.5, 0.04, 0.06, 0.06])


@settings(deadline=None, max_examples=25)
@given(st.lists(st.floats(0, 1), min_size=1, max_size=12))
def test_holm_laws(p):
    corrected = holm(p)
    assert all(a <= b <= 1.0 for a, b in zip(p, corrected, strict=True))
    order = np.argsort(p, kind="stable")
    assert (np.diff(np.array(corrected)[order]) >= 0).all()
    assert min(corrected) == pytest.approx(min(1.0, len(p) * min(p)))


def test_levels_by_hand():
    assert holm_levels([]) == []
    # Sorted .01 .02 .03 .5 against .05/4 .05/3 .05/2 .05/1: .02 stops, and its level stays.
    levels = [1 - x for x in holm_levels([0.5, 0.01, 0.03, 0.02])]
    assert levels == pytest.approx([0.05 / 3, 0.05 / 4, 0.05 / 3, 0.05 / 3])


def test_only_planned_pairs_are_corrected_for(make, rng):
    base = rng.integers(100, 500, size=200)
    jobs = [
        make((base + 40 * k + rng.integers(0, 50, 200)), name=f"s{k}", strategy=f"s{k}")
        for k in range(3)
    ]
    (alone,) = compare_pairs([(jobs[0], jobs[1])])
    assert alone.p_holm == alone.p_value
    first, second = compare_pairs([(jobs[0], jobs[1]), (jobs[0], jobs[2])])
    assert first.p_value > second.p_value
    assert (first.p_holm, second.p_holm) == (first.p_value, 2 * second.p_value)


def test_scores_are_compared_where_no_trial_passes(make, rng):
    # From the review: −16.0 [−16.3, −15.8] against −38.7 [−39.6, −37.8], 50 trials each.
    a = make([1000] * 50, strategy="softmax", score=rng.normal(-16.0, 0.9, 50), threshold=-10.0)
    b = make([1000] * 50, strategy="greedy", score=rng.normal(-38.7, 3.2, 50), threshold=-10.0)
    assert compare(a, b).winner is None
    (c,) = compare_pairs([(a, b)], SCORE)
    assert (c.measure, c.winner, c.better.value) == ("score", "softmax", 1.0)
    expected = stats.ttest_rel(a.score, b.score).confidence_interval()
    assert (c.difference.low, c.difference.high) == pytest.approx((expected.low, expected.high))
    assert np.isnan(c.p_logrank)
    assert compare(b, a, SCORE).winner == "softmax"


def test_scores_need_no_common_cap(make, rng):
    a = make([1000] * 20, score=rng.normal(20, 1, 20))
    b = make([500] * 20, strategy="b", cap=500, score=rng.normal(30, 1, 20))
    assert compare(a, b, SCORE).winner == "b"
    with pytest.raises(ValueError, match="cap"):
        compare(a, b)


@pytest.mark.parametrize(
    ("n", "jobs", "paired", "fewest"),
    [
        (5, 2, True, 6),  # 2 / 2^5 = 0.0625, 2 / 2^6 = 0.031
        (6, 2, True, None),
        (6, 3, True, 7),  # three pairs: 0.05 / 3 = 0.0167, 2 / 2^7 = 0.0156
        (3, 2, False, 4),  # 2 / C(6, 3) = 0.1, 2 / C(8, 4) = 0.029
        (4, 2, False, None),
        (4, 4, False, 5),  # six pairs: 0.0083, 2 / C(10, 5) = 0.0079
    ],
)
def test_the_fewest_trials_with_which_a_pair_can_be_significant(make, n, jobs, paired, fewest):
    made = [
        make(np.arange(n) + 10 * k, strategy=f"s{k}", seed=0 if paired else k) for k in range(jobs)
    ]
    found = compare_all(made, SCORE)
    assert {c.design == "paired" for c in found} == {paired}
    assert too_few(found) == fewest
    assert too_few([]) is None
