import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from statsmodels.stats.power import NormalIndPower, TTestPower

from trl_explore.statistics.estimates import Estimate, pass_rate
from trl_explore.statistics.means import mean_difference
from trl_explore.statistics.power import (
    detectable_difference,
    fewest_pairs,
    trials_for_difference,
    trials_for_rate_bound,
    trials_text,
    trials_to_settle,
)
from trl_explore.statistics.samples import Sample


def whole(n: float | None) -> int:
    assert n is not None
    return int(n)


def test_detectable_difference_by_hand():
    # (1.95996 + 0.84162) · 100 / √[25, 100]
    np.testing.assert_allclose(detectable_difference(100, [25, 100]), [56.03, 28.02], atol=0.01)
    assert detectable_difference(0.0, 5) == 0.0


def test_agrees_with_statsmodels():
    n = trials_for_difference(1.0, 0.3)
    exact = NormalIndPower(ddof=0).solve_power(effect_size=0.3, power=0.8, alpha=0.05, ratio=0)
    assert n == np.ceil(exact)
    assert n == pytest.approx(TTestPower().solve_power(0.3, power=0.8, alpha=0.05), abs=3)


def test_power_is_reached_in_simulation(rng):
    n = whole(trials_for_difference(100.0, 40.0))
    d = rng.normal(40.0, 100.0, size=(4000, n))
    z = d.mean(axis=1) / (100.0 / np.sqrt(n))
    assert np.mean(np.abs(z) > 1.96) == pytest.approx(0.8, abs=0.03)


@settings(deadline=None)
@given(st.floats(1, 1e3), st.floats(10, 1e3))
def test_the_two_directions_agree(sd, difference):
    n = whole(trials_for_difference(sd, difference))
    assert detectable_difference(sd, n) <= difference * (1 + 1e-6)
    if n > fewest_pairs():
        assert detectable_difference(sd, n - 1) > difference * (1 - 1e-6)
    assert trials_for_difference(sd, -difference) == n


@pytest.mark.parametrize("x", [0.0, np.nan, np.inf])
def test_no_number_of_trials_would_do(x):
    assert trials_for_difference(100.0, x) is None


def test_more_trials_than_can_be_run_are_not_a_number():
    assert trials_for_difference(100.0, 1e-9) == math.inf
    assert trials_text(math.inf) == "more than 100,000"
    assert trials_text(1684) == "1,700"


def test_nothing_is_said_of_a_difference_near_zero():
    # Half-width 98 = 1.96 · 50: the difference 49 is less than one standard error from 0.
    assert trials_to_settle(Estimate(49.0, -49.0, 147.0), 0.0, 100) is None
    assert trials_to_settle(Estimate(-49.0, -147.0, 49.0), 0.0, 100) is None
    assert trials_to_settle(Estimate(49.0, -np.inf, np.inf), 0.0, 3) is None
    # (1.95996 + 0.84162)² (50 / 70)² 100 = 400.4
    assert trials_to_settle(Estimate(70.0, -28.0, 168.0), 0.0, 100) == 401


def test_the_trials_to_settle_do(rng):
    pilot = Sample.of(rng.normal(30.0, 100.0, size=40)), Sample.of(np.zeros(40))
    n = whole(trials_to_settle(mean_difference(*pilot).estimate, 0.0, 40))
    shift = float(pilot[0].values.mean())
    spread = float(pilot[0].values.std(ddof=1))
    settled = [
        mean_difference(Sample.of(rng.normal(shift, spread, size=n)), Sample.of(np.zeros(n))).sign()
        for _ in range(200)
    ]
    assert np.mean(settled) == pytest.approx(0.8, abs=0.1)


def test_a_higher_level_needs_more():
    assert whole(trials_for_difference(100, 40, level=0.99)) > whole(trials_for_difference(100, 40))
    assert trials_for_difference(0.0, 40) == fewest_pairs()


@pytest.mark.parametrize("tests", [1, 10, 41])
def test_fewer_pairs_find_nothing_however_large_the_difference(tests, rng):
    level = 1 - 0.05 / tests
    n = fewest_pairs(level)
    assert n == {1: 6, 10: 9, 41: 11}[tests]  # 2 / 2^n ≤ 0.05 / tests
    pairs = [(Sample.of(846.0 + rng.random(k)), Sample.of(np.zeros(k))) for k in (n - 1, n)]
    p = [mean_difference(x, y).p_value for x, y in pairs]
    assert p[1] <= 0.05 / tests < p[0]
    assert trials_for_difference(1.0, 846.0, level=level) == n


@pytest.mark.parametrize("bound", [0.01, 0.05, 0.1, 0.5])
def test_unbroken_row_settles_exactly_then(bound):
    n = whole(trials_for_rate_bound(0.0, bound))
    assert pass_rate(0, n).below(bound)
    assert not pass_rate(0, n - 1).below(bound) or n == 2
    assert trials_for_rate_bound(1.0, 1 - bound) == n


def test_rate_bound_reaches_its_power(rng):
    n = whole(trials_for_rate_bound(0.446, 0.5))
    assert n == pytest.approx(670, abs=5)
    decided = [pass_rate(k, n).below(0.5) for k in rng.binomial(n, 0.446, size=1000)]
    assert np.mean(decided) == pytest.approx(0.8, abs=0.04)


def test_rates_without_difference():
    assert trials_for_rate_bound(0.5, 0.5) is None


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: detectable_difference(1.0, 0), "n=0"),
        (lambda: detectable_difference(-1.0, 5), "sd=-1.0"),
        (lambda: trials_for_difference(1.0, 5, level=2.0), "level=2.0"),
        (lambda: trials_for_rate_bound(-0.1, 0.5), "rate=-0.1"),
        (lambda: trials_for_rate_bound(0.1, 1.5), "rate=1.5"),
    ],
)
def test_refuses(call, message):
    with pytest.raises(ValueError, match=message):
        call()
