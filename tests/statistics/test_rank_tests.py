import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from statsmodels.duration.survfunc import survdiff

from trl_explore.statistics.proportions import pass_rate
from trl_explore.statistics.rank_tests import logrank_test, probability_faster

trials = st.lists(st.tuples(st.integers(1, 12), st.booleans()), min_size=1, max_size=12)


def split(data):
    return np.array([d[0] for d in data]), np.array([d[1] for d in data])


def test_logrank_agrees_with_statsmodels(rng):
    t_a, t_b = rng.integers(1, 40, size=35), rng.integers(5, 60, size=50)
    e_a, e_b = rng.random(35) < 0.7, rng.random(50) < 0.9
    group = np.repeat([0, 1], [35, 50])
    _, expected = survdiff(np.concatenate([t_a, t_b]), np.concatenate([e_a, e_b]), group)
    assert logrank_test(t_a, e_a, t_b, e_b) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("t_a", "e_a", "t_b", "e_b"),
    [
        ([10, 10], [0, 0], [10, 10], [0, 0]),
        ([5, 5], [1, 1], [5, 5], [1, 1]),
        ([10], [0], [10], [0]),
    ],
)
def test_logrank_without_information_is_one(t_a, e_a, t_b, e_b):
    assert logrank_test(t_a, e_a, t_b, e_b) == 1.0


@settings(deadline=None)
@given(trials, trials)
def test_logrank_is_always_a_p_value(a, b):
    p = logrank_test(*split(a), *split(b))
    assert 0.0 <= p <= 1.0
    assert p == pytest.approx(logrank_test(*split(b), *split(a)))


def test_faster_by_hand():
    # Faster, tie, slower, tie (both censored), faster (the other is censored).
    e = probability_faster(
        [1, 5, 9, 10, 10], [1, 1, 1, 0, 1], [2, 5, 3, 10, 10], [1, 1, 1, 0, 0], paired=True
    )
    assert e.value == pytest.approx((1 + 0.5 + 0 + 0.5 + 1) / 5)
    expected = pass_rate(3, 5)
    assert (e.low, e.high) == (expected.low, expected.high)


def test_converging_at_the_cap_beats_not_converging():
    assert probability_faster([10], [1], [10], [0], paired=True).value == 1.0
    assert probability_faster([10], [1], [10], [0], paired=False).value == 1.0


def test_unpaired_is_mann_whitney(rng):
    a, b = rng.integers(1, 30, size=20), rng.integers(5, 40, size=33)
    e = probability_faster(a, np.ones(20), b, np.ones(33), paired=False)
    u = stats.mannwhitneyu(b, a).statistic
    assert e.value == pytest.approx(u / (20 * 33))
    # Wilson's width shrinks with the smaller of both samples.
    expected = pass_rate(e.value * 20, 20)
    assert (e.low, e.high) == (expected.low, expected.high)


@settings(deadline=None)
@given(trials, trials, st.booleans())
def test_both_probabilities_sum_to_one(a, b, paired):
    n = min(len(a), len(b)) if paired else None
    x, y = split(a[:n]), split(b[:n])
    p, q = probability_faster(*x, *y, paired=paired), probability_faster(*y, *x, paired=paired)
    assert p.value + q.value == pytest.approx(1.0)
    assert p.low == pytest.approx(1.0 - q.high, abs=1e-9)
    assert 0.0 <= p.low <= p.value <= p.high <= 1.0


def test_refuses():
    with pytest.raises(ValueError, match="1 and 2 trials"):
        probability_faster([1], [1], [1, 2], [1, 1], paired=True)
    with pytest.raises(ValueError, match="0 and 1 trials"):
        probability_faster([], [], [1], [1], paired=False)
