from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from trl_explore.statistics.estimates import Estimate, combination, exact_rate, pass_rate, quantile


def test_questions_about_an_interval():
    e = Estimate(2.0, 1.0, 3.0)
    assert e.above(0.9)
    assert not e.above(1.0)
    assert e.below(3.1)
    assert not e.below(3.0)
    assert e.inside(1.0, 3.0)
    assert not e.inside(1.1, 3.0)
    assert not e.inside(1.0, 2.9)
    assert e.outside(3.1, 9.0)
    assert e.outside(0.0, 0.9)
    assert not e.outside(3.0, 9.0)


def test_unknown_interval_answers_no():
    e = Estimate(2.0, math.nan, math.nan)
    assert [e.above(0), e.below(9), e.inside(-9, 9), e.outside(5, 6)] == [False] * 4


def test_wilson_by_hand():
    # p̂ = 1/2, n = 10, z² = 3.8415: centre 0.5, half width √(z²/40 + z⁴/400) / (1 + z²/10)
    e = pass_rate(5, 10)
    assert (e.value, e.level) == (0.5, 0.95)
    assert e.low == pytest.approx(0.2366, abs=1e-4)
    assert e.high == pytest.approx(0.7634, abs=1e-4)


@pytest.mark.parametrize(("k", "n"), [(0, 1), (1, 1), (0, 30), (30, 30), (13, 30), (446, 1000)])
@pytest.mark.parametrize("level", [0.8, 0.95, 0.99])
def test_agrees_with_scipy(k, n, level):
    e = pass_rate(k, n, level=level)
    ci = stats.binomtest(k, n).proportion_ci(level, method="wilson")
    assert (e.low, e.high) == pytest.approx((ci.low, ci.high), abs=1e-12)


def test_bounds_are_exact_at_the_ends():
    assert pass_rate(0, 7).low == 0.0
    assert pass_rate(7, 7).high == 1.0


@settings(deadline=None)
@given(st.integers(1, 500), st.data())
def test_interval_contains_the_estimate_and_mirrors(n, data):
    k = data.draw(st.integers(0, n))
    e, mirrored = pass_rate(k, n), pass_rate(n - k, n)
    assert 0.0 <= e.low <= e.value <= e.high <= 1.0
    assert e.low < e.high
    assert mirrored.low == pytest.approx(1 - e.high, abs=1e-12)


@pytest.mark.parametrize(
    ("k", "n", "level", "message"),
    [
        (0, 0, 0.95, "trials=0"),
        (-1, 3, 0.95, "successes=-1"),
        (4, 3, 0.95, "successes=4"),
        (1, 3, 1.0, "level=1.0"),
        (1, 3, 0.0, "level=0.0"),
    ],
)
def test_refuses(k, n, level, message):
    with pytest.raises(ValueError, match=message):
        pass_rate(k, n, level=level)


@pytest.mark.parametrize(("k", "n"), [(0, 30), (3, 100), (30, 30), (500, 1000)])
def test_the_exact_interval_agrees_with_scipy(k, n):
    e = exact_rate(k, n)
    ci = stats.binomtest(k, n).proportion_ci(0.95, "exact")
    assert (e.value, e.low, e.high) == pytest.approx((k / n, ci.low, ci.high))


@pytest.mark.parametrize("n", [30, 100, 1000])
@pytest.mark.parametrize("p", [0.01, 0.5, 0.99])
def test_each_exact_bound_errs_in_at_most_one_of_forty(n, p):
    k = np.arange(n + 1)
    chance = stats.binom.pmf(k, n, p)
    low, high = np.array([(exact_rate(int(i), n).low, exact_rate(int(i), n).high) for i in k]).T
    assert chance[low > p].sum() <= 0.025
    assert chance[high < p].sum() <= 0.025


def test_a_quantile_by_hand():
    # B(7; 16, ¾) = .0075 ≤ .025 < B(8) = .0271, and 1 - B(15) = .0100 ≤ .025 < 1 - B(14) = .0635.
    e = quantile(np.arange(1.0, 17.0), 0.75)
    assert (e.low, e.high) == (8.0, 16.0)


def test_too_few_trials_leave_an_end_open():
    e = quantile([1.0, 2.0, 3.0], 0.9)
    assert e.high == np.inf
    assert combination([1.0, 2.0, 3.0], [(0.9, 1.0), (0.5, -2.0), (0.1, 1.0)]).high == np.inf


@pytest.mark.parametrize("n", [30, 100, 1000])
def test_quantile_skewness_holds_its_level(n):
    # Symmetric, heavy-tailed: the bootstrap of the moment skewness is wrong in most samples here.
    rng, skew = np.random.default_rng(n), [(0.9, 1.0), (0.5, -2.0), (0.1, 1.0)]
    wrong = 0
    for _ in range(150):
        e = combination(rng.standard_t(2, size=n), skew)
        wrong += e.above(0.0) or e.below(0.0)
    assert wrong / 150 <= 0.05


def test_a_skewed_sample_is_found_skewed():
    x = np.random.default_rng(0).exponential(size=1000)
    assert combination(x, [(0.9, 1.0), (0.5, -2.0), (0.1, 1.0)]).above(0.0)
    assert combination(-x, [(0.9, 1.0), (0.5, -2.0), (0.1, 1.0)]).below(0.0)
