import numpy as np
import pytest
from scipy import stats

from trl_explore.statistics.estimates import Estimate, pass_rate
from trl_explore.statistics.samples import Sample
from trl_explore.statistics.summary import (
    interquartile_mean,
    summarise,
    summarise_scores,
)


def test_one_configuration_by_hand(make):
    o = make(
        [100, 200, 300, 1000, 50, 60],
        converged=[1, 1, 1, 0, 0, 0],
        diverged=[4, 5],
        score=[196, 196, 200, 120, np.nan, np.nan],
        frames=[9000, 18000, 27000, 60000, 600, 700],
    )
    s = summarise(o)
    assert (s.n, s.converged, s.diverged, s.cap) == (6, 3, 2, 1000)
    assert s.pass_rate == pass_rate(3, 6)
    assert s.median.value == 300
    assert s.restricted_mean.value == pytest.approx(3600 / 6)
    assert s.expected_running_time.value == pytest.approx(3600 / 3)
    assert s.score.mean.value == pytest.approx((196 + 196 + 200 + 120) / 4)
    assert s.score.missing == 2
    assert s.frames_median.value == 27000
    assert s.frames_total == 115300
    assert s.frames_mean.value == pytest.approx(115300 / 6)


@pytest.mark.parametrize("durations", [[1000], [1000] * 5, [10], [10] * 5, [10, 1000]])
def test_degenerate_configurations_have_rows(make, durations):
    row = summarise(make(durations)).row()
    assert row["n"] == len(durations)
    assert not any(isinstance(v, Estimate | np.ndarray) for v in row.values())
    if all(d == 1000 for d in durations):
        assert row["median"] == row["expected_running_time"] == np.inf
        assert row["restricted_mean"] == 1000


def test_columns_of_a_row(make):
    row = summarise(make([10, 20, 1000])).row()
    for key in ("pass_rate", "median", "expected_running_time", "score_mean", "score_iqm"):
        assert {key, f"{key}_low", f"{key}_high"} <= row.keys()
    assert {"restricted_mean", "restricted_mean_low", "score_q05", "score_q50"} <= row.keys()
    assert {"frames_median", "frames_mean", "frames_total"} <= row.keys()


def test_interquartile_mean_by_hand():
    # n = 9: ⌊9 / 4⌋ = 2 are cut from each end, and winsorised to 2 and 7.
    e = interquartile_mean([9, 1, 2, 3, 4, 5, 6, 7, 1000])
    assert e.value == pytest.approx(5.0)
    winsorised = [3, 3, 3, 4, 5, 6, 7, 7, 7]
    half = stats.t.isf(0.025, 4) * np.std(winsorised, ddof=1) / (0.5 * np.sqrt(9))
    assert (e.low, e.high) == pytest.approx((5 - half, 5 + half))
    assert interquartile_mean([3.0]).value == 3.0


def test_summary_agrees_with_numpy_and_scipy(rng):
    x = rng.normal(150, 40, size=80)
    s = summarise_scores(Sample.of(x))
    assert (s.n, s.missing) == (80, 0)
    assert s.mean.value == pytest.approx(x.mean())
    assert s.sd == pytest.approx(x.std(ddof=1))
    np.testing.assert_allclose(s.quantiles, np.percentile(x, [5, 25, 50, 75, 95]))
    ci = stats.ttest_1samp(x, 0).confidence_interval()
    assert (s.mean.low, s.mean.high) == pytest.approx((ci.low, ci.high))
    boot = stats.bootstrap(
        (x,), lambda a, axis: stats.trim_mean(a, 0.25, axis), method="percentile", rng=rng
    ).confidence_interval
    assert (s.iqm.low, s.iqm.high) == pytest.approx((boot.low, boot.high), abs=1.5)


def test_trials_without_score_are_counted_apart(make):
    o = make([300] * 4, score=[1.0, np.nan, 3.0, np.inf], converged=[0] * 4, cap=300)
    assert (summarise(o).score.n, summarise(o).score.missing) == (2, 2)
    assert summarise(o).score.mean.value == 2.0


def test_degenerate(make):
    nothing = summarise(make([1000], score=[np.nan])).score
    assert nothing.n == 0
    assert np.isnan(nothing.mean.value)
    assert np.isnan(nothing.quantiles).all()
    one = summarise_scores(Sample.of([7.0]))
    assert one.mean.value == 7.0
    assert np.isnan([one.mean.low, one.sd]).all()
    same = summarise_scores(Sample.of([7.0] * 5))
    assert (same.mean.low, same.mean.high, same.sd) == (7.0, 7.0, 0.0)
