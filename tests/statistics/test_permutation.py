import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from trl_explore.statistics.permutation import label_permutation_test, sign_flip_test

values = st.lists(st.integers(-50, 50), min_size=1, max_size=8)


def test_sign_flips_by_hand(rng):
    # Sums of ±1 ±2 ±3: |sum| ≥ 6 for 2 of 8; of ±1 ±2 -3 with |sum| 0: always.
    assert sign_flip_test([1, 2, 3], rng) == 2 / 8
    assert sign_flip_test([1, 2, -3], rng) == 1.0
    assert sign_flip_test([5.0], rng) == 1.0
    assert sign_flip_test([1.0] * 6, rng) == 2 / 64


def test_sign_flips_exact_agree_with_scipy(rng):
    d = rng.normal(0.5, 1.0, size=9)
    expected = stats.permutation_test(
        (d,), np.sum, permutation_type="samples", n_resamples=10**9, alternative="two-sided"
    ).pvalue
    assert sign_flip_test(d, rng) == pytest.approx(expected, abs=1e-12)


def test_sign_flips_sampled_agree_with_t_test(rng):
    d = rng.normal(0.3, 1.0, size=50)
    p = sign_flip_test(d, rng)
    assert p == pytest.approx(stats.ttest_1samp(d, 0.0)[1], abs=0.01)
    assert sign_flip_test(-d, rng) == pytest.approx(p, abs=0.01)


def test_sampled_p_is_never_zero(rng):
    assert sign_flip_test(np.full(40, 7.0), rng, resamples=999) == 1 / 1000
    assert label_permutation_test([0.0] * 30, [1.0] * 30, rng, resamples=999) == 1 / 1000


def test_beyond_the_draws_the_bound_tells_sizes_apart(rng):
    # 40 pairs that differ by 7: 280² / (2 · 40 · 49) = 20; the exact p is 2 / 2^40.
    assert sign_flip_test(np.full(40, 7.0), rng, resamples=999, tail=True) == pytest.approx(
        2 * math.exp(-20)
    )
    # 30 zeros and 30 ones: 2 · 15² / (30 · 1) = 15; the exact p is 2 / C(60, 30).
    p = label_permutation_test([0.0] * 30, [1.0] * 30, rng, resamples=999, tail=True)
    assert p == pytest.approx(2 * math.exp(-15))
    assert sign_flip_test(np.full(9000, 7.0), rng, resamples=9, tail=True) > 0


def test_the_bound_changes_nothing_where_draws_decide(rng):
    # 14 pairs: 2 e^-7 = 0.0018 is more than the 1 / 1000 of the draws.
    assert sign_flip_test(np.full(14, 7.0), rng, resamples=999, tail=True) == 1 / 1000
    d = rng.normal(0.3, 1.0, size=50)
    p = [sign_flip_test(d, np.random.default_rng(0), tail=tail) for tail in (False, True)]
    assert p[0] == p[1] > 1 / 1000


def test_no_difference_gives_one(rng):
    assert sign_flip_test(np.zeros(3), rng) == 1.0
    assert sign_flip_test(np.zeros(50), rng) == 1.0
    assert label_permutation_test([4.0] * 30, [4.0] * 20, rng) == 1.0


def test_rounding_does_not_break_ties(rng):
    # 0.1 + 0.2 + 0.3 differs from 0.3 + 0.2 + 0.1 in the last bit.
    assert sign_flip_test([0.1, 0.2, 0.3], rng) == 2 / 8


def test_labels_by_hand_and_scipy(rng):
    assert label_permutation_test([1, 2], [3, 4], rng) == pytest.approx(2 / 6)
    assert label_permutation_test([1], [3], rng) == 1.0
    x, y = rng.normal(size=5), rng.normal(1.0, 1.0, size=4)
    expected = stats.permutation_test(
        (x, y), lambda a, b: a.mean() - b.mean(), n_resamples=10**9
    ).pvalue
    assert label_permutation_test(x, y, rng) == pytest.approx(expected)


def test_labels_sampled_agree_with_t_test(rng):
    x, y = rng.normal(size=40), rng.normal(0.4, 1.0, size=60)
    p = label_permutation_test(x, y, rng)
    assert p == pytest.approx(stats.ttest_ind(x, y)[1], abs=0.01)


def test_level_is_kept_under_the_null(rng):
    rejected = sum(
        sign_flip_test(rng.normal(size=20), rng, resamples=199) <= 0.05 for _ in range(400)
    )
    assert rejected / 400 == pytest.approx(0.05, abs=0.03)


@settings(deadline=None, max_examples=50)
@given(values)
def test_sign_flips_symmetric_and_scale_free(d):
    rng = np.random.default_rng(0)
    p = sign_flip_test(d, rng)
    assert 2 / 2 ** len(d) <= p <= 1.0
    assert sign_flip_test([-3.0 * x for x in d], rng) == p


@settings(deadline=None, max_examples=50)
@given(values, values)
def test_labels_symmetric(x, y):
    rng = np.random.default_rng(0)
    if len(x) + len(y) <= 10:
        assert label_permutation_test(x, y, rng) == label_permutation_test(y, x, rng)


@pytest.mark.parametrize("bad", [[], [1.0, np.nan], [np.inf]])
def test_refuses(bad, rng):
    with pytest.raises(ValueError, match="all finite"):
        sign_flip_test(bad, rng)
    with pytest.raises(ValueError, match="all finite"):
        label_permutation_test(bad, [1.0], rng)
