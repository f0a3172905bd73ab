import numpy as np
import pytest
from scipy import stats

from trl_explore.statistics.scores import interquartile_mean, summarise_scores


def test_interquartile_mean_by_hand():
    # n = 9: ⌊9 / 4⌋ = 2 are cut from each end.
    assert interquartile_mean([9, 1, 2, 3, 4, 5, 6, 7, 1000]) == pytest.approx(5.0)
    assert interquartile_mean([3.0]) == 3.0
    np.testing.assert_allclose(interquartile_mean([[0, 1, 3, 9], [4, 4, 4, 4]]), [2.0, 4.0])


def test_summary_agrees_with_numpy_and_scipy(rng):
    x = rng.normal(150, 40, size=80)
    s = summarise_scores(x, rng)
    assert (s.n, s.missing) == (80, 0)
    assert s.mean.value == pytest.approx(x.mean())
    assert s.sd == pytest.approx(x.std(ddof=1))
    np.testing.assert_allclose(s.quantiles, np.percentile(x, [5, 25, 50, 75, 95]))
    for estimate, f in ((s.mean, np.mean), (s.iqm, lambda a, axis: stats.trim_mean(a, 0.25, axis))):
        ci = stats.bootstrap((x,), f, method="percentile", rng=rng).confidence_interval
        assert estimate.low == pytest.approx(ci.low, abs=0.8)
        assert estimate.high == pytest.approx(ci.high, abs=0.8)


def test_trials_without_score_are_counted_apart(rng):
    s = summarise_scores([1.0, np.nan, 3.0, np.inf], rng)
    assert (s.n, s.missing, s.mean.value) == (2, 2, 2.0)


def test_degenerate(rng):
    nothing = summarise_scores([np.nan], rng)
    assert nothing.n == 0
    assert np.isnan(nothing.mean.value)
    assert np.isnan(nothing.quantiles).all()
    one = summarise_scores([7.0], rng)
    assert one.mean.value == 7.0
    assert np.isnan([one.mean.low, one.sd]).all()
    same = summarise_scores([7.0] * 5, rng)
    assert (same.mean.low, same.mean.high, same.sd) == (7.0, 7.0, 0.0)
