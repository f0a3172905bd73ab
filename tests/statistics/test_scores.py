"""Scores are compared where no threshold is reached, in pairs, with Holm's correction."""

from __future__ import annotations

import numpy as np
import pytest

from trl_explore.statistics.scores import compare_scores


@pytest.fixture
def scored(make):
    """Capped trials with given scores."""

    def job(name, score):
        return make([1000] * len(score), strategy=name, score=score)

    return job


def test_scores_far_apart_are_told_apart_although_nobody_passes(scored):
    rng = np.random.default_rng(0)
    softmax = scored("softmax", rng.normal(-16.0, 0.5, 50))
    greedy = scored("epsilon_greedy", rng.normal(-38.7, 3.0, 50))
    (found,) = compare_scores([(softmax, greedy)], np.random.default_rng(1), resamples=999)
    assert found.winner == "softmax"
    assert found.design == "paired"
    assert found.n == 50
    assert found.difference.value == pytest.approx(22.7, abs=1.5)
    assert found.difference.above(20)
    assert found.mean_a == pytest.approx(-16, abs=0.3)


def test_equal_scores_are_not(scored):
    rng = np.random.default_rng(3)
    a, b = (scored(name, rng.normal(0, 1, 40)) for name in ("a", "b"))
    (found,) = compare_scores([(a, b)], np.random.default_rng(1), resamples=999)
    assert found.winner is None


def test_holm_and_trials_without_a_score(scored):
    x = np.arange(12.0)
    a, b, c = scored("a", x), scored("b", x + 1 + x / 50), scored("c", np.append(x[:-1], np.nan))
    pairs = [(a, b), (a, c)]
    first, second = compare_scores(pairs, np.random.default_rng(0), resamples=999)
    assert first.p_holm == pytest.approx(2 * first.p_value)
    assert first.winner == "b"
    assert second.n == 11
    assert second.difference.value == 0
    nothing = scored("d", [np.nan] * 12)
    with pytest.raises(ValueError, match="no finite scores"):
        compare_scores([(a, nothing)], np.random.default_rng(0), resamples=99)
