import numpy as np
import pytest

from trl_explore.statistics.quantiles import combination, quantile


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
