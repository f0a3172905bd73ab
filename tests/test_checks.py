import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trl_explore.checks import check_integer, check_number, first_line, interval, withdraw


@pytest.mark.parametrize("value", [0, 1, 0.5, np.float32(0.25), np.int64(1), Fraction(1, 3)])
def test_number_within_closed_bounds_is_returned_as_float(value):
    number = check_number("epsilon", value, 0, 1)
    assert type(number) is float
    assert number == float(value)


@pytest.mark.parametrize("value", [-1e-9, 1.0000001, math.nan, math.inf, -math.inf])
def test_number_out_of_bounds(value):
    with pytest.raises(ValueError, match=r"^epsilon.*\[0, 1\]") as error:
        check_number("epsilon", value, 0, 1)
    assert repr(value) in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("value", [True, False, "0.5", None, [0.5], 1j])
def test_what_is_not_a_number(value):
    with pytest.raises(ValueError, match=r"^epsilon.*\[0, 1\]"):
        check_number("epsilon", value, 0, 1)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_number_without_bounds_is_finite(value):
    assert check_number("baseline", -1e300) == -1e300
    with pytest.raises(ValueError, match=r"^baseline.*finite"):
        check_number("baseline", value)


def test_open_bounds_exclude_their_ends():
    assert check_number("x", 1, 0, 1, low_open=True) == 1
    with pytest.raises(ValueError, match=r"^x.*\(0, 1\].*0$"):
        check_number("x", 0, 0, 1, low_open=True)


@given(st.floats(), st.floats(0, 1))
def test_number_is_accepted_exactly_within_its_bounds(value, low):
    allowed = low <= value <= low + 1
    try:
        assert check_number("x", value, low, low + 1) == value
        assert allowed
    except ValueError:
        assert not allowed


@pytest.mark.parametrize("value", [1, 2, 10**30, np.int64(7)])
def test_integer(value):
    number = check_integer("trials", value, 1)
    assert type(number) is int
    assert number == value


@pytest.mark.parametrize("value", [0, -1, 1.0, 1.5, "1", True, None, math.nan])
def test_what_is_not_an_integer_of_at_least_one(value):
    with pytest.raises(ValueError, match=r"^trials.*>= 1") as error:
        check_integer("trials", value, 1)
    assert repr(value) in str(error.value)


def test_integer_zero_where_zero_is_allowed():
    assert check_integer("seed", 0, 0) == 0


@pytest.mark.parametrize(
    ("bounds", "words"),
    [
        ((0, 1, False), "in [0, 1]"),
        ((0, 0.5, True), "in (0, 0.5]"),
        ((0, math.inf, False), ">= 0"),
        ((0, math.inf, True), "> 0"),
        ((-math.inf, 2, False), "<= 2"),
        ((-math.inf, math.inf, True), "that is finite"),
    ],
)
def test_words_of_a_range(bounds, words):
    low, high, low_open = bounds
    assert interval(low, high, low_open=low_open) == words


def test_a_declaration_does_not_outlive_an_overridden_method():
    class Base:
        fast = True

        def __init_subclass__(cls):
            withdraw(cls, "fast", False, ["run", "walk"])

        def run(self): ...

    class Mixin:
        def walk(self): ...

    class Same(Base):
        def other(self): ...

    class Mixed(Mixin, Same): ...

    class Stated(Mixed):
        fast = True

    class Below(Stated):
        def run(self): ...

    assert (Base.fast, Same.fast, Stated.fast) == (True, True, True)
    assert (Mixed.fast, Below.fast) == (False, False)


def test_first_line():
    assert first_line(ValueError("\none\ntwo")) == "one"
    assert first_line(KeyError()) == "KeyError"
