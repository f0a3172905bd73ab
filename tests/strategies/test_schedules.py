import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from torch.nn import Parameter
from torch.optim import SGD
from torch.optim.lr_scheduler import CosineAnnealingLR

from trl_explore.strategies import EpsilonGreedy
from trl_explore.strategies.schedules import (
    Constant,
    Cosine,
    Exponential,
    Inverse,
    Linear,
    Piecewise,
    Schedule,
    as_schedule,
)

INFINITY = math.inf
unit = st.floats(0, 1)
iterations = st.integers(0, 10_000)


def test_constant():
    schedule = Constant(0.3)
    assert [schedule(i) for i in (0, 1, 10**6)] == [0.3] * 3
    assert schedule.bounds == (0.3, 0.3)


def test_constant_per_trial():
    schedule = Constant([0.1, 0.4, 0.2])
    for i in (0, 7):
        np.testing.assert_array_equal(schedule(i), [0.1, 0.4, 0.2])
    assert schedule(0).dtype == np.float64
    assert schedule.bounds == (0.1, 0.4)
    np.testing.assert_array_equal(Constant(np.array([1, 2]))(0), [1.0, 2.0])


@pytest.mark.parametrize("value", [math.nan, math.inf, "0.3", None, [0.1, math.nan], []])
def test_constant_refuses(value):
    with pytest.raises(ValueError, match=r"^value.*number"):
        Constant(value)


def test_linear_by_hand():
    down = Linear(1.0, 0.0, iterations=4)
    assert [down(i) for i in range(7)] == [1.0, 0.75, 0.5, 0.25, 0.0, 0.0, 0.0]
    up = Linear(0.5, 2.5, iterations=2)
    assert [up(i) for i in range(4)] == [0.5, 1.5, 2.5, 2.5]
    assert up.bounds == (0.5, 2.5)
    assert down.bounds == (0.0, 1.0)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ((math.nan, 0.0, 4), "initial"),
        ((1.0, math.inf, 4), "final"),
        ((1.0, 0.0, 0), "iterations"),
        ((1.0, 0.0, 2.5), "iterations"),
    ],
)
def test_linear_refuses(arguments, name):
    with pytest.raises(ValueError, match=rf"^{name}\b"):
        Linear(*arguments)


def test_exponential_by_hand_from_iteration_zero():
    schedule = Exponential(1.0, 0.5)
    assert [schedule(i) for i in range(5)] == [1.0, 0.5, 0.25, 0.125, 0.0625]
    assert Exponential(8.0, 0.5)(2) == 2.0


def test_exponential_of_the_thesis():
    schedule = Exponential(1.0, 0.99)
    assert schedule(0) == 1.0
    assert schedule(1) == 0.99
    assert schedule(100) == pytest.approx(0.3660323412732292, rel=1e-12)
    assert 0 <= schedule(10**6) < 1e-300


def test_exponential_at_the_ends_of_decay():
    assert [Exponential(0.7, 1)(i) for i in (0, 5)] == [0.7, 0.7]
    assert [Exponential(0.7, 0)(i) for i in (0, 1, 5)] == [0.7, 0.0, 0.0]
    assert Exponential(0.7, 1).bounds == (0.7, 0.7)
    assert Exponential(0.7, 0.9).bounds == (0.0, 0.7)
    assert Exponential(-2.0, 0.9).bounds == (-2.0, 0.0)


@pytest.mark.parametrize("decay", [-0.1, 1.01, math.nan])
def test_exponential_refuses(decay):
    with pytest.raises(ValueError, match=r"decay.*\[0, 1\]"):
        Exponential(1.0, decay)


def test_cosine_by_hand():
    # cos 60° = 1/2 and cos 120° = -1/2
    schedule = Cosine(5.0, 1.0, iterations=3)
    np.testing.assert_allclose([schedule(i) for i in range(5)], [5, 4, 2, 1, 1], rtol=1e-15)
    assert schedule.bounds == (1.0, 5.0)


def test_cosine_is_that_of_torch():
    optimizer = SGD([Parameter()], lr=0.7)
    other = CosineAnnealingLR(optimizer, T_max=17, eta_min=0.1)
    for i in range(18):
        assert Cosine(0.7, 0.1, 17)(i) == pytest.approx(other.get_last_lr()[0], rel=1e-12)
        optimizer.step()
        other.step()


def test_inverse_by_hand():
    assert [Inverse(1.0, 0.5)(i) for i in (0, 2, 6)] == [1.0, 0.5, 0.25]
    assert [Inverse(6.0, 1.0, power=2)(i) for i in (0, 1, 2)] == [6.0, 1.5, 6 / 9]
    assert [Inverse(2.0, 0.0)(i) for i in (0, 5)] == [2.0, 2.0]
    assert Inverse(2.0, 0.0).bounds == (2.0, 2.0)
    assert Inverse(2.0, 0.1).bounds == (0.0, 2.0)
    assert 0 <= Inverse(1.0, 1e300, power=50)(10**6) < 1e-300


def test_piecewise_by_hand():
    schedule = Piecewise([[2, 1.0], [4, 0.0], [5, 3.0]])
    assert [schedule(i) for i in range(8)] == [1.0, 1.0, 1.0, 0.5, 0.0, 3.0, 3.0, 3.0]
    assert schedule.bounds == (0.0, 3.0)
    assert [Piecewise([(3, 0.2)])(i) for i in (0, 3, 9)] == [0.2] * 3


@pytest.mark.parametrize(
    ("knots", "message"),
    [
        ([], r"knots.*\[\]"),
        (3, "knots.*3"),
        ("ab", "knots.*ab"),
        ([1, 2], "knot.*pair.*1"),
        ([[1, 2, 3]], r"knot.*pair.*\[1, 2, 3\]"),
        (["ab"], "knot.*pair.*ab"),
        ([[-1, 0.5]], "iteration.*knot.*-1"),
        ([[0.5, 0.5]], "iteration.*knot.*0.5"),
        ([[0, math.nan]], "value.*nan"),
        ([[0, 1.0], [5, 0.5], [5, 0.1]], "ascend.*5.*5"),
    ],
)
def test_piecewise_refuses(knots, message):
    with pytest.raises(ValueError, match=message):
        Piecewise(knots)


@pytest.mark.parametrize(
    ("kind", "arguments", "name"),
    [
        (Cosine, (math.nan, 0.0, 4), "initial"),
        (Cosine, (0.0, 1.0, 0), "iterations"),
        (Inverse, (math.inf, 1.0), "initial"),
        (Inverse, (1.0, -0.1), "rate"),
        (Inverse, (1.0, 0.1, 0), "power"),
    ],
)
def test_cosine_and_inverse_refuse(kind, arguments, name):
    with pytest.raises(ValueError, match=rf"^{name}\b"):
        kind(*arguments)


@given(unit, unit, st.integers(1, 100), iterations)
def test_no_schedule_leaves_its_bounds(a, b, length, i):
    knots = [(0, a), (length, b), (2 * length, a)]
    for schedule in (
        *(Constant(a), Linear(a, b, length), Exponential(a, b)),
        *(Cosine(a, b, length), Inverse(a, b), Inverse(a, b, 0.5), Piecewise(knots)),
    ):
        low, high = schedule.bounds
        assert low <= schedule(i) <= high


def test_schedules_show_what_they_are():
    assert repr(Linear(1.0, 0.5, 10)) == "Linear(initial=1.0, final=0.5, iterations=10)"


def test_as_schedule_of_a_number_and_of_a_list():
    assert as_schedule("epsilon", 0.3, 0, 1)(5) == 0.3
    assert as_schedule("epsilon", 1, 0, 1)(5) == 1.0
    np.testing.assert_array_equal(as_schedule("epsilon", [0.0, 1.0], 0, 1)(5), [0.0, 1.0])
    np.testing.assert_array_equal(as_schedule("epsilon", np.array([0.5]), 0, 1)(5), [0.5])


def test_as_schedule_keeps_a_schedule():
    schedule = Exponential(1.0, 0.9)
    assert as_schedule("epsilon", schedule, 0, 1) is schedule


def test_as_schedule_takes_schedules_of_others():
    class Steps(Schedule):
        bounds = (0.1, 0.9)

        def __call__(self, iteration):
            return 0.9 if iteration < 3 else 0.1

    assert as_schedule("epsilon", Steps(), 0, 1)(3) == 0.1
    with pytest.raises(ValueError, match=r"epsilon.*\[0, 0.5\].*0.9"):
        as_schedule("epsilon", Steps(), 0, 0.5)


@pytest.mark.parametrize(
    "value",
    [
        *(1.5, -0.1, math.nan, "0.3", None, [0.2, 1.2], ["0.2"], True),
        *(Constant(1.5), Constant([0.2, -0.2]), Linear(0.0, 1.5, 3), Exponential(2.0, 0.5)),
    ],
)
def test_as_schedule_refuses_with_the_name_of_the_argument(value):
    with pytest.raises(ValueError, match=r"^epsilon.*\[0, 1\]"):
        as_schedule("epsilon", value, 0, 1)


@pytest.mark.parametrize("value", [0, 0.0, [1.0, 0.0], Constant(0.0)])
def test_as_schedule_at_an_open_bound(value):
    with pytest.raises(ValueError, match=r"temperature.*> 0"):
        as_schedule("temperature", value, 0, INFINITY, low_open=True)


@pytest.mark.parametrize("value", [1e-30, [0.5, 2.0], Constant([0.5, 2.0]), Exponential(1.0, 0.5)])
def test_as_schedule_above_an_open_bound(value):
    schedule = as_schedule("temperature", value, 0, INFINITY, low_open=True)
    assert np.all(schedule(10) > 0)


@pytest.mark.parametrize(
    "schedule", [Linear(0.0, 2.0, 10), Constant([0.0, 1.0])], ids=["linear", "list"]
)
def test_an_open_bound_may_not_be_the_first_value_of_any_trial(schedule):
    with pytest.raises(ValueError, match="scale"):
        as_schedule("scale", schedule, 0, 5, low_open=True)


def test_a_strategy_that_keeps_pace_counts_for_itself():
    one, other = (EpsilonGreedy(Linear(1.0, 0.0, frames=10)) for _ in range(2))
    one.step(4)
    other.keep_pace(one)
    assert (other.epsilon.item(), other.iteration.item()) == (pytest.approx(0.6), 1)
    other.step(3)
    assert [s.frames.item() for s in (one, other)] == [4, 7]
    assert one.epsilon.item() == pytest.approx(0.6)
