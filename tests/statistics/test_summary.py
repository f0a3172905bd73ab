import numpy as np
import pytest

from trl_explore.statistics.estimates import Estimate
from trl_explore.statistics.proportions import pass_rate
from trl_explore.statistics.summary import summarise, summarise_all


def test_one_configuration_by_hand(make, rng):
    o = make(
        [100, 200, 300, 1000, 50, 60],
        converged=[1, 1, 1, 0, 0, 0],
        diverged=[4, 5],
        score=[196, 196, 200, 120, np.nan, np.nan],
        frames=[9000, 18000, 27000, 60000, 600, 700],
    )
    s = summarise(o, rng)
    assert (s.n, s.converged, s.diverged, s.cap) == (6, 3, 2, 1000)
    assert s.pass_rate == pass_rate(3, 6)
    assert s.median.value == 300
    assert s.restricted_mean == pytest.approx(3600 / 6)
    assert s.restricted_mean_se == pytest.approx(
        np.std([100, 200, 300, 1000, 1000, 1000], ddof=1) / np.sqrt(6)
    )
    assert s.expected_running_time.value == pytest.approx(3600 / 3)
    assert s.score.mean.value == pytest.approx((196 + 196 + 200 + 120) / 4)
    assert s.score.missing == 2
    assert s.frames_median.value == 27000
    assert s.frames_total == 115300
    assert s.frames_mean.value == pytest.approx(115300 / 6)


@pytest.mark.parametrize("durations", [[1000], [1000] * 5, [10], [10] * 5, [10, 1000]])
def test_degenerate_configurations_have_rows(make, rng, durations):
    row = summarise(make(durations), rng).row()
    assert row["n"] == len(durations)
    assert not any(isinstance(v, Estimate | np.ndarray) for v in row.values())
    if all(d == 1000 for d in durations):
        assert row["median"] == row["expected_running_time"] == np.inf
        assert row["restricted_mean"] == 1000


def test_columns_of_a_row(make, rng):
    row = summarise(make([10, 20, 1000]), rng).row()
    for key in ("pass_rate", "median", "expected_running_time", "score_mean", "score_iqm"):
        assert {key, f"{key}_low", f"{key}_high"} <= row.keys()
    assert {"restricted_mean", "restricted_mean_se", "score_q05", "score_q50"} <= row.keys()
    assert {"frames_median", "frames_mean", "frames_total"} <= row.keys()


def test_rows_are_the_same_twice_and_alone(make):
    a, b = make(np.arange(100, 140)), make(np.arange(200, 240), strategy="argmax")
    both = summarise_all([a, b], np.random.default_rng(5), resamples=500)
    alone = summarise_all([b], np.random.default_rng(5), resamples=500)
    assert both[1].row() == alone[0].row()
    assert both[0].row() != both[1].row()
    assert summarise_all([], np.random.default_rng(5)) == []
