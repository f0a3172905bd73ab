import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trl_explore.statistics.comparisons import compare, compare_all, compare_pairs, holm
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


def test_paired_comparison(fast, slow, rng):
    c = compare(fast, slow, rng)
    assert (c.a, c.b, c.design) == ("softmax", "epsilon_greedy", "paired")
    assert (c.n_a, c.n_b, c.dropped, c.cap) == (30, 30, 0, 1000)
    assert c.mean_a == pytest.approx(fast.iterations.mean())
    assert c.difference.value == pytest.approx((fast.durations - slow.durations).mean())
    assert c.difference.below(0)
    assert c.p_value == c.p_holm <= 0.001
    assert c.p_logrank < 0.001
    assert c.faster.value == 1.0
    assert c.winner == "softmax"
    assert compare(slow, fast, rng).winner == "softmax"


def test_hundreds_of_pairs_can_still_be_told_apart(make, rng):
    # 600 / (1 + 9999) = 0.06: of the draws alone no difference survives Holm's correction.
    reference = make(rng.integers(100, 200, size=40), strategy="reference")
    slower = [make(rng.integers(300, 400, size=40), strategy=f"s{k}") for k in range(600)]
    table = compare_pairs([(reference, other) for other in slower], rng, resamples=9999)
    assert {c.winner for c in table} == {"reference"}


def test_only_common_trials_are_compared(make, rng):
    a = make([100, 200, 300, 400], strategy="a")
    b = make([250, 350, 1000], strategy="b", first_trial=1)
    c = compare(a, b, rng)
    assert (c.design, c.n_a, c.n_b, c.dropped) == ("paired", 3, 3, 1)
    assert (c.mean_a, c.mean_b) == (300.0, pytest.approx(1600 / 3))
    assert c.faster.value == 1.0


def test_without_common_trials_it_is_unpaired(make, rng):
    a, b = make([100, 200, 300]), make([400, 500], strategy="b", seed=1)
    c = compare(a, b, rng)
    assert (c.design, c.n_a, c.n_b, c.dropped) == ("unpaired", 3, 2, 0)
    assert c.difference.value == -250.0
    # Of 10 relabellings, this one and its mirror image.
    assert c.p_value == pytest.approx(2 / 10)
    assert np.isnan([c.correlation, c.variance_ratio]).all()


def test_all_censored_against_all_censored(failing, make, rng):
    c = compare(failing, make([1000] * 30, strategy="argmax"), rng)
    assert (c.difference.value, c.p_value, c.p_logrank, c.faster.value) == (0.0, 1.0, 1.0, 0.5)
    assert c.winner is None
    assert c.faster.low < 0.5 < c.faster.high


def test_all_censored_against_none(failing, fast, rng):
    c = compare(failing, fast, rng)
    assert c.winner == "softmax"
    assert c.faster.value == 0.0
    assert np.isnan(c.correlation)


def test_diverged_trials_count_at_the_cap(make, rng):
    a = make([100, 5], diverged=[1], converged=[1, 0])
    c = compare(a, make([300, 400], strategy="b"), rng)
    assert c.mean_a == 550.0


def test_one_trial_each(make, rng):
    c = compare(make([100]), make([200], strategy="b"), rng)
    assert c.difference.value == -100.0
    assert np.isnan(c.difference.low)
    assert (c.p_value, c.winner) == (1.0, None)


def test_other_caps_and_same_trials_are_refused(fast, make, rng):
    with pytest.raises(ValueError, match=r"cap 1000.*b.*5000"):
        compare(fast, make([100], strategy="b", cap=5000), rng)
    with pytest.raises(ValueError, match="30 trials"):
        compare(fast, fast, rng)


def test_all_pairs(fast, slow, failing):
    table = compare_all([fast, slow, failing], np.random.default_rng(0), resamples=999)
    assert [(c.a, c.b) for c in table] == [
        ("softmax", "epsilon_greedy"),
        ("softmax", "random"),
        ("epsilon_greedy", "random"),
    ]
    assert [c.p_holm for c in table] == holm([c.p_value for c in table])
    assert all(c.p_holm > c.p_value for c in table)
    again = compare_all([fast, slow, failing], np.random.default_rng(0), resamples=999)
    assert [c.row() for c in table[:1]] == [c.row() for c in again[:1]]


def test_a_pair_does_not_depend_on_the_others(fast, slow, failing):
    two = compare_all([fast, slow], np.random.default_rng(0), resamples=999)
    three = compare_all([fast, slow, failing], np.random.default_rng(0), resamples=999)
    assert two[0].difference == three[0].difference


def test_holm_decides_the_winner(make, rng):
    # p = 2/64 by itself; three pairs of the kind make it 6/64.
    a = make(np.arange(100, 106), strategy="a")
    others = [make(np.arange(100, 106) + k * np.arange(1, 7), strategy=f"s{k}") for k in (2, 5)]
    assert compare(a, others[0], rng).winner == "a"
    table = compare_all([a, *others], rng)
    assert [c.p_holm for c in table] == [pytest.approx(6 / 64)] * 3
    assert [c.winner for c in table] == [None] * 3


def test_all_pairs_of_nothing(fast, rng):
    assert compare_all([], rng) == []
    assert compare_all([fast], rng) == []


def test_all_pairs_refuse(fast, make, rng):
    with pytest.raises(ValueError, match="'softmax'"):
        compare_all([fast, make([1], parameters={"temperature": 2})], rng)
    grid = make([100], name="again", experiment="grid")
    with pytest.raises(ValueError, match=r"thesis/softmax.*grid/again.*1 trial"):
        compare_all([fast, grid], rng)


def test_row_is_flat(fast, slow, rng):
    row = compare(fast, slow, rng).row()
    assert row["difference"] < row["difference_high"] < 0
    assert row["faster_low"] > 0.8
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
