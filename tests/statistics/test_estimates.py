import math

from trl_explore.statistics.estimates import Estimate


def test_questions_about_an_interval():
    e = Estimate(2.0, 1.0, 3.0)
    assert e.above(0.9)
    assert not e.above(1.0)
    assert e.below(3.1)
    assert not e.below(3.0)
    assert e.inside(1.0, 3.0)
    assert not e.inside(1.1, 3.0)
    assert not e.inside(1.0, 2.9)
    assert e.outside(3.1, 9.0)
    assert e.outside(0.0, 0.9)
    assert not e.outside(3.0, 9.0)


def test_unknown_interval_answers_no():
    e = Estimate(2.0, math.nan, math.nan)
    assert [e.above(0), e.below(9), e.inside(-9, 9), e.outside(5, 6)] == [False] * 4
