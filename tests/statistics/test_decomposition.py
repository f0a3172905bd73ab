"""Shares and parts of a difference: numbers by hand, Fieller's published example, coverage."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from trl_explore.statistics.decomposition import (
    Cells,
    aligned,
    curve_means,
    mean_of,
    p_of_mean,
    same_weights,
    share_of,
)


def test_the_parts_by_hand():
    cells = Cells(
        reference=np.array([10.0, 20.0]), plain=np.array([110.0, 60.0]),
        assumed=np.array([90.0, 50.0]), corrected=np.array([30.0, 30.0]),
    )  # fmt: skip
    assert cells.gap.tolist() == [100, 40]
    assert [path.tolist() for path in cells.paths()] == [[80, 30], [80, 30]]
    assert cells.bias.tolist() == [80, 30]
    assert cells.data.tolist() == [20, 10]
    one = Cells(cells.reference, cells.plain, corrected=np.array([10.0, 20.0]))
    assert one.bias.tolist() == [100, 40]
    with pytest.raises(ValueError, match="assumed or the corrected"):
        _ = Cells(cells.reference, cells.plain).bias


def test_the_two_paths_share_the_interaction():
    """Data alone +2, bias alone +4, both together +10: the extra 4 is shared equally."""
    cells = Cells(*(np.full(2, x) for x in (0.0, 10.0, 4.0, 2.0)))
    assert cells.bias.tolist() == [6, 6]
    assert cells.data.tolist() == [4, 4]


def test_the_mean_is_that_of_the_t_interval():
    x = np.random.default_rng(0).normal(3, 2, 12)
    found = mean_of(x, level=0.9)
    low, high = stats.ttest_1samp(x, 0).confidence_interval(0.9)
    assert (found.low, found.high) == pytest.approx((low, high))
    assert np.isnan(mean_of([1.0]).low)


def test_shares_are_those_that_a_t_test_does_not_reject():
    rng = np.random.default_rng(1)
    y = rng.normal(10, 4, 30)
    x = 0.7 * y + rng.normal(0, 2, 30)
    found = share_of(x, y)
    assert found.value == pytest.approx(x.mean() / y.mean())
    for bound in (found.low, found.high):
        assert p_of_mean(x - bound * y) == pytest.approx(0.05)
    _, p = stats.ttest_1samp(x, 5)
    assert p_of_mean(x - 5) == pytest.approx(p)


def test_a_whole_that_may_be_nothing_has_no_shares():
    rng = np.random.default_rng(2)
    y = rng.normal(0.1, 1, 30)
    assert mean_of(y).low < 0 < mean_of(y).high
    assert np.isnan(share_of(0.5 * y, y).value)
    assert np.isnan(share_of([1.0], [1.0]).value)
    with pytest.raises(ValueError, match="2 and 1 values"):
        share_of([1.0, 2.0], [1.0])


def test_the_height_of_curves():
    trial = np.array([7, 7, 7, 3, 3, 5, 7])
    iteration = np.array([10, 0, 20, 0, 4, 2, 20])
    value = np.array([10.0, 0.0, 20.0, 1.0, 3.0, 8.0, 40.0])
    names, means = curve_means(trial, iteration, value)
    assert names.tolist() == [3, 5, 7]
    # Trial 7: 0, 10 and (20 + 40) / 2 at 0, 10, 20: areas 50 and 200 over 20 iterations.
    assert means.tolist() == [2.0, 8.0, 12.5]
    means = curve_means(trial, iteration, value, 40)[1]
    assert means.tolist() == [(8 + 36 * 3) / 40, 8.0, (250 + 20 * 30) / 40]


def test_the_training_score_with_the_weights_of_an_evaluation():
    trained = (np.array([0, 0, 0, 1]), np.array([1, 2, 2, 1]), np.array([5.0, 6.0, 8.0, 9.0]))
    evaluated = (np.array([0, 0, 0, 1, 2]), np.array([0, 1, 2, 0, 0]))
    found = same_weights(evaluated, trained)
    np.testing.assert_array_equal(found, [5, 7, np.nan, 9, np.nan])
    nothing = np.zeros(0, np.int64)
    assert np.isnan(same_weights(evaluated, (nothing, nothing, np.zeros(0)))).all()


def test_only_common_trials_are_compared():
    keys = [[(0, 1), (0, 2), (1, 0)], [(1, 0), (0, 1)], [(0, 1), (1, 0), (5, 5)]]
    values = [np.array([1.0, 2.0, 3.0]), np.array([30.0, 10.0]), np.array([100.0, 300.0, 0.0])]
    assert [x.tolist() for x in aligned(keys, values)] == [[1, 3], [10, 30], [100, 300]]


def learned(rng, n, median, spread, failing=0.0, cap=1000):
    """Invented iterations to learning, skewed, some of them capped."""
    times = np.minimum(median * np.exp(rng.normal(0, spread, n)), cap)
    return np.where(rng.random(n) < failing, cap, times)


def true_mean(median, spread, failing=0.0, cap=1000):
    """E[min(T, cap)] of ``learned``, in closed form."""
    z = (np.log(cap) - np.log(median)) / spread
    below = median * np.exp(spread**2 / 2) * stats.norm.cdf(z - spread)
    return failing * cap + (1 - failing) * (below + cap * stats.norm.sf(z))


@pytest.mark.parametrize("n", [30, 100, 1000])
def test_shares_cover_the_truth(n):
    """Times as on CartPole: reference 40, plain 335 with failures, corrected 70."""
    rng = np.random.default_rng(n)
    shapes = [(40, 0.4, 0.0), (290, 0.6, 0.05), (65, 0.4, 0.001)]
    reference, plain, corrected = (true_mean(*shape) for shape in shapes)
    truth = (plain - corrected) / (plain - reference)
    hit = 0
    for _ in range(600):
        a, d, c = (learned(rng, n, *shape) for shape in shapes)
        found = share_of(d - c, d - a)
        hit += found.low <= truth <= found.high
    assert 0.93 <= hit / 600 <= 0.975
