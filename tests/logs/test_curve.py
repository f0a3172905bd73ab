from __future__ import annotations

import numpy as np
import pytest

from trl_explore.logs.log import Curve, clean

NAN, INF = np.nan, np.inf


def cleaned(step, score, **more):
    curve = clean(np.array(step, dtype=float), np.array(score, dtype=float), **more)
    return curve.step.tolist(), curve.score.tolist(), curve.notes, curve.ended_nan


def test_a_plain_curve_is_unchanged():
    assert cleaned([1, 2, 5], [3, 4, 5]) == ([1, 2, 5], [3, 4, 5], (), False)


def test_duplicate_steps():
    note = "1 duplicate step, the last value counts"
    assert cleaned([1, 1, 2], [3, 4, 5]) == ([1, 2], [4, 5], (note,), False)
    assert cleaned([1, 1, 2], [3, 4, 5], episodes=True) == ([1, 1, 2], [3, 4, 5], (), False)


def test_values_that_are_not_finite():
    assert cleaned([1, 2, 3, 4], [NAN, 1, INF, 2])[:2] == ([2, 4], [1, 2])
    assert cleaned([1, 2, 3], [1, NAN, NAN]) == (
        [1], [1], ("2 values not finite, left out",), True,
    )  # fmt: skip
    assert cleaned([1, NAN, 3], [1, 2, 3])[:2] == ([1, 3], [1, 3])
    assert cleaned([1], [NAN])[:2] == ([], [])


def test_restarts():
    # Continued from step 20, then from step 10; both times later values replace earlier ones.
    steps, scores, notes, _ = cleaned([10, 20, 30, 20, 40, 15, 25], range(7))
    assert (steps, scores) == ([10, 15, 25], [0, 5, 6])
    assert notes == ("restarted 2 times, 4 points replaced",)
    # Repeated from the start, in the same file.
    assert cleaned([1, 2, 3, 1, 2], range(5))[1] == [3, 4]
    # Two episodes that ended at one step are no restart.
    assert cleaned([5, 5, 9, 7, 7], range(5), episodes=True)[1] == [0, 1, 3, 4]


def test_smoothing():
    curve = Curve(np.arange(1.0, 6.0), np.array([1.0, 2.0, 6.0, 4.0, 5.0]))
    smooth = curve.smoothed(3)
    assert smooth.step.tolist() == [3, 4, 5]
    assert smooth.score.tolist() == [3, 4, 5]
    assert len(curve.smoothed(6)) == 0
    assert curve.smoothed(1) is curve


def test_values_between_points():
    curve = Curve(np.array([10.0, 20.0, 20.0]), np.array([1.0, 3.0, 5.0]))
    assert curve.at(np.array([0.0, 10.0, 15.0, 30.0])) == pytest.approx([1, 1, 3, 5])
