"""Intervals and tests of means in which rare failures count, with their error rates."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from trl_explore.statistics import samples
from trl_explore.statistics.estimates import pass_rate
from trl_explore.statistics.means import mean_difference, mean_interval
from trl_explore.statistics.samples import Kind, Sample
from trl_explore.statistics.summary import summarise_scores
from trl_explore.statistics.survival import time_per_success

CAP = 1000.0


def times(values, failed=None):
    x = np.asarray(values, dtype=float)
    return Sample.of(x, x >= CAP if failed is None else failed, least=CAP, most=CAP)


def unpaired(sample):
    return Sample(
        sample.label, sample.unit, sample.values, sample.converged,
        tuple((1, i) for i in range(len(sample))), sample.kinds,
    )  # fmt: skip


def test_without_failures_it_is_students_interval(rng):
    x, y = rng.normal(50, 9, 12), rng.normal(45, 5, 12)
    e = mean_interval(Sample.of(x))
    expected = stats.ttest_1samp(x, 0).confidence_interval()
    assert (e.low, e.high) == pytest.approx((expected.low, expected.high))
    d = mean_difference(Sample.of(x), Sample.of(y))
    paired = stats.ttest_rel(x, y)
    ends = paired.confidence_interval()
    assert (d.estimate.low, d.estimate.high) == pytest.approx((ends.low, ends.high))
    assert d.p_value == pytest.approx(max(paired.pvalue, 2 / 2**12), rel=1e-4)
    assert d.sd == pytest.approx(np.std(x - y, ddof=1))
    assert d.correlation == pytest.approx(np.corrcoef(x, y)[0, 1])
    ratio = np.var(x - y, ddof=1) / (x.var(ddof=1) + y.var(ddof=1))
    assert d.variance_ratio == pytest.approx(ratio)


def test_a_restricted_mean_by_hand():
    # 28 pass with mean 100 and sd 10, 2 reach the cap.
    x = np.concatenate([[90.0, 110.0] * 14, [CAP] * 2])
    half = 28 / 30 * stats.t.isf(0.025, 27) * np.std(x[:28], ddof=1) / np.sqrt(28)
    rate = pass_rate(2, 30)
    e = mean_interval(times(x))
    assert e.value == pytest.approx(160.0)
    assert e.low == pytest.approx(160 - np.hypot(half, 900 * (2 / 30 - rate.low)))
    assert e.high == pytest.approx(160 + np.hypot(half, 900 * (rate.high - 2 / 30)))


def test_what_was_not_seen_is_in_the_interval():
    same = times([100.0] * 30)
    assert mean_interval(same).low == 100.0
    assert mean_interval(same).high == pytest.approx(100 + 900 * pass_rate(0, 30).high)
    never = mean_interval(times([CAP] * 30))
    assert (never.value, never.high) == (CAP, CAP)
    assert never.low == pytest.approx(CAP * pass_rate(30, 30).low)


def test_the_score_of_an_unseen_failure_is_any_possible_one():
    scores = [196.0] * 30
    known = mean_interval(Sample.of(scores, [False] * 30, least=0.0, most=195.0))
    assert known.low == pytest.approx(196 * (1 - pass_rate(0, 30).high))
    assert known.high == 196.0
    unknown = mean_interval(Sample.of(scores, [False] * 30, most=195.0))
    assert unknown.low == -np.inf
    seen = mean_interval(Sample.of([*scores, 50.0, 60.0], [False] * 30 + [True] * 2, most=195.0))
    assert np.isfinite([seen.low, seen.high]).all()
    # With too few ordinary trials there are no kinds to tell apart.
    mixed = Sample.of([1.0, 2.0, 3.0, 9.0], [True, True, True, False])
    expected = stats.ttest_1samp(mixed.values, 0).confidence_interval()
    assert mean_interval(mixed).low == pytest.approx(expected.low)


def test_time_per_success():
    e = time_per_success(times([100, 200, 1000, 1000]))
    assert e.value == pytest.approx(2300 / 2)
    x = np.arange(100.0, 150.0)
    none_failed = time_per_success(times(x))
    half = stats.t.isf(0.025, 49) * x.std(ddof=1) / np.sqrt(50)
    rate = pass_rate(0, 50).high
    assert none_failed.low == pytest.approx(x.mean() - half)
    assert none_failed.high == pytest.approx(x.mean() + np.hypot(half, CAP * rate / (1 - rate)))
    never = time_per_success(times([CAP] * 30))
    assert (never.value, never.high) == (np.inf, np.inf)
    low = pass_rate(30, 30).low
    assert never.low == pytest.approx(CAP * low / (1 - low))
    assert np.isnan(time_per_success(times([CAP])).low)


def test_a_difference_of_times_by_hand():
    x, y = times([100.0, 120.0] * 15), unpaired(times([300.0, 310.0] * 15))
    d = mean_difference(x, y)
    assert (d.estimate.value, d.paired, d.n) == (-195.0, False, 30)
    t = stats.t.isf(0.025, 29) / np.sqrt(30)
    spread = np.hypot(t * np.std(x.values, ddof=1), t * np.std(y.values, ddof=1))
    q = pass_rate(0, 30).high
    assert d.estimate.low == pytest.approx(-195 - np.hypot(spread, q * (1000 - 305)))
    assert d.estimate.high == pytest.approx(-195 + np.hypot(spread, q * (1000 - 110)))


def test_p_is_the_level_at_which_the_interval_touches_zero(rng):
    x = times(rng.integers(100, 200, 100))
    y = times(np.append(rng.integers(120, 300, 98), [CAP, CAP]))
    d = mean_difference(x, y)
    assert 1e-6 < d.p_value < 0.05
    assert d.at(1 - d.p_value).high == pytest.approx(0.0, abs=1e-3)
    assert d.sign() == -1


def test_few_pairs_are_never_significant():
    five = mean_difference(Sample.of([1, 2, 3, 4, 5.5]), Sample.of(np.zeros(5)))
    assert (five.p_value, five.sign()) == (2 / 32, 0)
    assert np.isinf([five.estimate.low, five.estimate.high]).all()
    six = mean_difference(Sample.of(np.arange(10.0, 16.0)), Sample.of(np.zeros(6)))
    assert (six.p_value, six.sign()) == (2 / 64, 1)
    loose = mean_difference(Sample.of([1.0, 1.1, 1.2]), unpaired(Sample.of([9.0, 9.1])))
    assert loose.p_value == pytest.approx(2 / 10)


def test_pairing_sharpens_when_trials_correlate(rng):
    common = rng.normal(500, 100, size=60)
    x, y = common + rng.normal(0, 10, 60), common + 10 + rng.normal(0, 10, 60)
    paired = mean_difference(Sample.of(x), Sample.of(y))
    assert paired.sign() == -1
    assert mean_difference(Sample.of(x), unpaired(Sample.of(y))).sign() == 0
    assert paired.variance_ratio < 0.05


def test_degenerate():
    one = mean_difference(Sample.of([1.0]), Sample.of([3.0]))
    assert (one.estimate.value, one.p_value, one.sign()) == (-2.0, 1.0, 0)
    assert np.isnan([one.estimate.low, one.sd, one.correlation]).all()
    same = mean_difference(Sample.of([7.0] * 9), Sample.of([7.0] * 9))
    assert (same.estimate.low, same.estimate.high, same.p_value) == (0.0, 0.0, 1.0)
    assert np.isnan(same.correlation)
    assert np.isnan(mean_interval(Sample.of([5.0])).low)


@settings(deadline=None, max_examples=60)
@given(st.lists(st.tuples(st.integers(1, 11), st.integers(1, 11)), min_size=2, max_size=30))
def test_swapping_the_samples_swaps_the_sign(pairs):
    x, y = (times(100.0 * np.minimum(v, 10)) for v in np.array(pairs).T)
    a, b = mean_difference(x, y), mean_difference(y, x)
    assert a.estimate.value == -b.estimate.value
    assert a.p_value == pytest.approx(b.p_value)
    assert (a.estimate.low, a.estimate.high) == pytest.approx((-b.estimate.high, -b.estimate.low))
    assert a.estimate.low <= a.estimate.value <= a.estimate.high
    assert (a.p_value < 0.05) == (a.sign() != 0) or a.p_value == pytest.approx(0.05, abs=1e-4)


@pytest.mark.parametrize("values", [[], [np.nan], [np.inf, 1.0]])
def test_refuses(values):
    with pytest.raises(ValueError, match=r"finite|at least one"):
        mean_interval(Sample.of(values))


# The distributions of the review: 158 to pass on average, one trial in 60 at the cap.


def rare(rng, n, failing=1 / 60):
    t = 100.0 + rng.gamma(2.0, 30.0, size=n).round()
    score = 195.0 + 4.0 * rng.random(n)
    failed = rng.random(n) < failing
    early = rng.random(n) < 0.04
    score = np.where(failed, rng.uniform(10, 60, n), np.where(early, score + 25, score))
    kinds = (Kind(failed, 0.0, 195.0), Kind(early & ~failed, 195.0, 500.0))
    keys = tuple((0, i) for i in range(n))
    scores = Sample("", "", score, ~failed, keys, kinds)
    return times(np.where(failed, CAP, t)), scores


@pytest.fixture(scope="module")
def truth():
    t, score = rare(np.random.default_rng(1), 1_000_000)
    return t.values.mean(), t.values.sum() / t.converged.sum(), score.values.mean()


@pytest.mark.parametrize("n", [10, 30, 100, 1000])
def test_coverage_with_a_rare_failure(n, truth):
    rng, hits = np.random.default_rng(n), np.zeros(5)
    mean_t, ert, mean_score = truth
    repetitions = 400
    for _ in range(repetitions):
        (t, score), (other, other_score) = rare(rng, n), rare(rng, n, failing=0.0)
        cells = [
            (mean_interval(t), mean_t),
            (time_per_success(t), ert),
            (mean_interval(score), mean_score),
            (mean_difference(t, other).estimate, (CAP - 160.0) / 60),
            (mean_difference(score, unpaired(other_score)).estimate, mean_score - 198.0),
        ]
        hits += [e.low <= true <= e.high for e, true in cells]
    assert (hits / repetitions >= 0.925).all(), hits / repetitions


@pytest.mark.parametrize("n", [10, 30, 100])
def test_level_where_means_are_equal_and_shapes_differ(n):
    # Mean 160 both: one always in 160 ± 20, the other passes early but fails in one of 60.
    rng, wrong, repetitions = np.random.default_rng(n), np.zeros(2), 400
    for _ in range(repetitions):
        early = (160.0 - CAP / 60) / (1 - 1 / 60)
        failed = rng.random(n) < 1 / 60
        x = times(np.where(failed, CAP, early + rng.normal(0, 10, n)))
        y = times(160.0 + rng.uniform(-20, 20, n))
        wrong += [mean_difference(x, y).sign() != 0, mean_difference(x, unpaired(y)).sign() != 0]
    assert (wrong / repetitions <= 0.07).all(), wrong / repetitions


def test_the_interval_of_a_mean_time_has_no_negative_times():
    """Student's interval of 10 and 100 is 55 ± 12.7 · 45."""
    assert mean_interval(Sample.of([10.0, 100.0], unit="frames")).low == 0.0
    assert mean_interval(Sample.of([10.0, 100.0])).low == pytest.approx(55 - 12.706 * 45, abs=0.1)


def test_the_interval_of_a_mean_score_keeps_to_the_range_of_the_environment(make):
    """Student's interval of 480 and 490 is 485 ± 12.7 · 5; CartPole's scores end at 500."""

    def config(name):
        return {"env": {"id": name, "max_steps": 500}}

    two = make([1000, 1000], score=[480.0, 490.0], threshold=600, config=config("CartPole-v1"))
    e = mean_interval(samples.scores(two))
    assert (e.low, e.high) == (pytest.approx(485 - 12.706 * 5, abs=0.1), 500)
    one = make([1000] * 3, score=[0.9, 1.0, 1.0], threshold=2, config=config("FrozenLake8x8-v1"))
    assert summarise_scores(samples.scores(one)).mean.high == 1.0
    # sutton_barto_reward=True: the scores are between -1 and 0, and their range is not known.
    other = make([1000, 1000], score=[-0.5, -0.6], threshold=600, config=config("CartPole-v1"))
    e = mean_interval(samples.scores(other))
    assert e.low == pytest.approx(-0.55 - 12.706 * 0.05, abs=0.01)
    assert e.high == pytest.approx(-0.55 + 12.706 * 0.05, abs=0.01)
    unknown = make([1000, 1000], score=[480.0, 490.0], threshold=600, config=config("My-v0"))
    assert mean_interval(samples.scores(unknown)).high > 500
