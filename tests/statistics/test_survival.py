import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from statsmodels.duration.survfunc import SurvfuncRight, survdiff

from trl_explore.statistics.estimates import pass_rate
from trl_explore.statistics.survival import (
    kaplan_meier,
    logrank_test,
    median_time,
    number_at_risk,
    probability_faster,
)

# Freireich's remission times of leukaemia under 6-MP, the textbook example; 0 is censored.
WEEKS = [6, 6, 6, 6, 7, 9, 10, 10, 11, 13, 16, 17, 19, 20, 22, 23, 25, 32, 32, 34, 35]
EVENT = [1, 1, 1, 0, 1, 0, 1, 0, 0, 1, 1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0]

many = st.lists(st.tuples(st.integers(1, 30), st.booleans()), min_size=1, max_size=40)
few = st.lists(st.tuples(st.integers(1, 12), st.booleans()), min_size=1, max_size=12)


def test_curve_of_the_textbook():
    curve = kaplan_meier(WEEKS, EVENT)
    np.testing.assert_array_equal(curve.times, [0, 6, 7, 10, 13, 16, 22, 23, 35])
    np.testing.assert_allclose(
        curve.survival, [1, 0.857, 0.807, 0.753, 0.690, 0.627, 0.538, 0.448, 0.448], atol=5e-4
    )
    np.testing.assert_array_equal(curve.at_risk, [21, 21, 17, 15, 12, 11, 7, 6, 1])
    np.testing.assert_array_equal(curve.events, [0, 3, 1, 1, 1, 1, 1, 1, 0])
    # Log-log interval of R's survfit(conf.type = "log-log") at 6 and at 23 weeks.
    np.testing.assert_allclose([curve.low[1], curve.high[1]], [0.620, 0.952], atol=1e-3)
    np.testing.assert_allclose([curve.low[7], curve.high[7]], [0.188, 0.680], atol=1e-3)


def test_curve_agrees_with_statsmodels(rng):
    t = rng.integers(1, 60, size=80)
    e = rng.random(80) < 0.6
    curve = kaplan_meier(t, e, level=0.9)
    sm = SurvfuncRight(t, e)
    inner = curve.events > 0
    np.testing.assert_allclose(curve.survival[inner], sm.surv_prob, atol=1e-12)
    np.testing.assert_array_equal(curve.at_risk[inner], sm.n_risk)
    # Log-log by the delta method: Ŝ^exp(±z se / (Ŝ |log Ŝ|)), where 0 < Ŝ < 1.
    known = np.flatnonzero(np.asarray(sm.surv_prob) > 1e-9)
    s, se = np.asarray(sm.surv_prob)[known], np.asarray(sm.surv_prob_se)[known]
    width = np.exp(1.6448536 * se / (s * -np.log(s)))
    np.testing.assert_allclose(curve.low[inner][known], s**width, rtol=1e-6)
    np.testing.assert_allclose(curve.high[inner][known], s ** (1 / width), rtol=1e-6)
    assert curve.times[-1] == t.max()


def test_only_censored_at_the_cap_is_the_empirical_curve():
    curve = kaplan_meier([3, 5, 5, 9, 10, 10], [1, 1, 1, 1, 0, 0])
    np.testing.assert_array_equal(curve.times, [0, 3, 5, 9, 10])
    np.testing.assert_allclose(curve.survival, [1, 5 / 6, 3 / 6, 2 / 6, 2 / 6])
    np.testing.assert_array_equal(curve.at([0, 2.9, 3, 10]), curve.survival[[0, 0, 1, 4]])
    assert np.isnan(curve.at([10.1])).all()


def test_convergence_at_the_cap_comes_before_censoring():
    curve = kaplan_meier([10, 10], [True, False])
    np.testing.assert_allclose(curve.survival, [1.0, 0.5])


def test_all_censored_is_not_certainty():
    curve = kaplan_meier([10, 10, 10], [0, 0, 0])
    np.testing.assert_array_equal(curve.times, [0, 10])
    np.testing.assert_array_equal(curve.survival, [1, 1])
    # Wilson with 3 of 3: 3 / (3 + 1.96²)
    np.testing.assert_allclose(curve.low, 3 / (3 + 3.8415), atol=1e-4)
    np.testing.assert_array_equal(curve.high, [1, 1])


def test_none_censored_ends_at_zero():
    curve = kaplan_meier([1, 2, 3], [1, 1, 1])
    assert curve.survival[-1] == 0.0
    assert curve.low[-1] == 0.0
    assert 0.5 < curve.high[-1] < 0.6


def test_one_trial_and_ties():
    assert kaplan_meier([7], [True]).survival.tolist() == [1.0, 0.0]
    assert kaplan_meier([7], [False]).survival.tolist() == [1.0, 1.0]
    tied = kaplan_meier([7, 7, 7, 7], [1, 1, 1, 1])
    assert tied.times.tolist() == [0.0, 7.0]
    assert tied.survival.tolist() == [1.0, 0.0]


@settings(deadline=None)
@given(many)
def test_curve_is_a_survival_curve(data):
    t, e = np.array([d[0] for d in data]), np.array([d[1] for d in data])
    curve = kaplan_meier(t, e)
    assert (np.diff(curve.times) > 0).all()
    assert (np.diff(curve.survival) <= 1e-15).all()
    assert ((curve.low <= curve.survival + 1e-12) & (curve.survival <= curve.high + 1e-12)).all()
    assert ((curve.low >= 0) & (curve.high <= 1)).all()
    assert curve.events.sum() == e.sum()
    np.testing.assert_array_equal(curve.at_risk, number_at_risk(t, curve.times))


@pytest.mark.parametrize(
    ("t", "e", "message"),
    [
        ([], [], "n ≥ 1"),
        ([1, 2], [True], "both"),
        ([0, 1], [True, True], "from 0.0"),
        ([1, np.nan], [True, True], "positive and finite"),
        ([[1, 2]], [[True, True]], "both"),
    ],
)
def test_curve_refuses(t, e, message):
    with pytest.raises(ValueError, match=message):
        kaplan_meier(t, e)


def test_number_at_risk_by_hand():
    np.testing.assert_array_equal(
        number_at_risk([2, 4, 4, 9], [0, 2, 3, 4, 5, 9, 10]), [4, 4, 3, 3, 1, 1, 0]
    )


def test_median_and_its_interval():
    curve = kaplan_meier(WEEKS, EVENT)
    # R: survfit(..., conf.type = "log-log") gives median 23, 95 % interval 13 to NA.
    m = median_time(curve)
    assert (m.value, m.low, m.high) == (23.0, 13.0, np.inf)


def test_median_agrees_with_statsmodels(rng):
    t = np.minimum(rng.integers(1, 100, size=61), 80)
    sm = SurvfuncRight(t, t < 80)
    assert median_time(kaplan_meier(t, t < 80)).value == sm.quantile(0.5)


def test_median_not_reached():
    m = median_time(kaplan_meier([10, 10, 3], [0, 0, 1]))
    assert (m.value, m.high) == (np.inf, np.inf)
    m = median_time(kaplan_meier([10] * 8, [0] * 8))
    assert (m.low, m.value, m.high) == (np.inf, np.inf, np.inf)


def test_median_at_exactly_one_half():
    assert median_time(kaplan_meier([2, 5, 9, 9], [1, 1, 0, 0])).value == 5.0
    assert median_time(kaplan_meier([2], [1])).value == 2.0


def test_median_of_one_trial_is_open_to_both_sides():
    m = median_time(kaplan_meier([2], [1]))
    # Wilson with one trial is [0.21, 1] before the event and [0, 0.79] after it: both have ½.
    assert m.low == 0.0
    assert m.high == np.inf


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


def split(data):
    return np.array([d[0] for d in data]), np.array([d[1] for d in data])


@settings(deadline=None)
@given(few, few)
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
@given(few, few, st.booleans())
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
