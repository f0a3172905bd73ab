import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from trl_explore.statistics.differences import mean_difference


def test_paired_by_hand(rng):
    d = mean_difference([10, 20, 30, 40], [11, 23, 29, 45], rng, paired=True)
    assert d.estimate.value == pytest.approx(-2.0)
    assert (d.paired, d.n) == (True, 4)
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
    assert (d.paired, d.n) == (False, 2)
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
