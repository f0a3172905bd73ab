import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from trl_explore.statistics.comparisons import (
    compare,
    compare_all,
    compare_pairs,
    holm,
    mean_difference,
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


def test_paired_by_hand(rng):
    d = mean_difference([10, 20, 30, 40], [11, 23, 29, 45], rng, paired=True)
    assert d.estimate.value == pytest.approx(-2.0)
    assert d.n == 4
    # Differences -1, -3, 1, -5: |±1 ±3 ±1 ±5| is 10 for 2 of 16 signs and 8 for 4.
    assert d.p_value == 6 / 16
    assert d.sd == pytest.approx(np.std([-1, -3, 1, -5], ddof=1))
    assert d.correlation == pytest.approx(np.corrcoef([10, 20, 30, 40], [11, 23, 29, 45])[0, 1])
    assert d.variance_ratio == pytest.approx(
        np.var([-1, -3, 1, -5], ddof=1)
        / (np.var([10, 20, 30, 40], ddof=1) + np.var([11, 23, 29, 45], ddof=1))
    )


def test_unpaired_by_hand(rng):
    d = mean_difference([1, 2, 3], [4, 6], rng, paired=False)
    assert d.estimate.value == -3.0
    assert d.n == 2
    # Of the 10 choices of 3 from {1, 2, 3, 4, 6} only {1, 2, 3} and none mirrored is as far.
    assert d.p_value == pytest.approx(1 / 10)
    assert d.sd == pytest.approx(np.sqrt(1.0 + 2.0))
    assert np.isnan([d.correlation, d.variance_ratio]).all()


def test_pairing_sharpens_when_trials_correlate(rng):
    common = rng.normal(500, 100, size=60)
    x, y = common + rng.normal(0, 10, 60), common + 10 + rng.normal(0, 10, 60)
    paired = mean_difference(x, y, rng, paired=True)
    loose = mean_difference(x, y, rng, paired=False)
    assert paired.sign() == -1
    assert loose.sign() == 0
    assert paired.correlation > 0.95
    assert paired.variance_ratio < 0.05
    assert paired.p_value == pytest.approx(stats.ttest_rel(x, y)[1], abs=0.01)


def test_sign_needs_interval_and_test(rng):
    # Five differences of one sign: the bootstrap excludes zero, the test (2/32) does not.
    few = mean_difference([1, 2, 3, 4, 5], np.zeros(5), rng, paired=True)
    assert few.estimate.above(0)
    assert few.p_value == 2 / 32
    assert few.sign() == 0
    six = mean_difference([1, 2, 3, 4, 5, 6], np.zeros(6), rng, paired=True)
    assert six.sign() == 1
    assert mean_difference(np.zeros(6), np.arange(1, 7), rng, paired=True).sign() == -1


def test_level_is_kept_under_the_null(rng):
    wrong = 0
    for _ in range(400):
        x, y = rng.exponential(size=(2, 20))
        wrong += mean_difference(x, y, rng, paired=True, resamples=199).sign() != 0
    assert wrong / 400 < 0.09


def test_degenerate(rng):
    one = mean_difference([1.0], [3.0], rng, paired=True)
    assert (one.estimate.value, one.p_value, one.sign()) == (-2.0, 1.0, 0)
    assert np.isnan([one.estimate.low, one.sd, one.correlation]).all()
    same = mean_difference([1000.0] * 9, [1000.0] * 9, rng, paired=True)
    assert (same.estimate.low, same.estimate.high, same.p_value, same.sign()) == (0, 0, 1.0, 0)
    assert np.isnan(same.correlation)
    assert np.isnan(mean_difference([1.0], [3.0, 4.0], rng, paired=False).sd)


@settings(deadline=None, max_examples=40)
@given(st.lists(st.tuples(st.integers(0, 99), st.integers(0, 99)), min_size=2, max_size=8))
def test_swapping_the_samples_swaps_the_sign(pairs):
    x, y = np.array(pairs).T
    a = mean_difference(x, y, np.random.default_rng(0), paired=True, resamples=300)
    b = mean_difference(y, x, np.random.default_rng(0), paired=True, resamples=300)
    assert a.estimate.value == -b.estimate.value
    assert a.p_value == b.p_value
    assert (a.estimate.low, a.estimate.high) == pytest.approx((-b.estimate.high, -b.estimate.low))


def test_refuses(rng):
    with pytest.raises(ValueError, match="3 and 2 values"):
        mean_difference([1, 2, 3], [1, 2], rng, paired=True)
    with pytest.raises(ValueError, match="0 and 2"):
        mean_difference([], [1, 2], rng, paired=False)
    with pytest.raises(ValueError, match="all finite"):
        mean_difference([np.nan], [1], rng, paired=True)


def test_only_planned_pairs_are_corrected_for(make, rng):
    base = np.arange(20) + 200
    jobs = [make(base + 9 * k, name=f"s{k}", strategy=f"s{k}") for k in range(3)]
    (alone,) = compare_pairs([(jobs[0], jobs[1])], rng, resamples=199)
    assert alone.p_holm == alone.p_value
    two = compare_pairs([(jobs[0], jobs[1]), (jobs[0], jobs[2])], rng, resamples=199)
    # Both p-values are the smallest possible one, so that Holm doubles each.
    assert [round(c.p_holm / c.p_value, 6) for c in two] == [2.0, 2.0]
