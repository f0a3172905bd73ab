from __future__ import annotations

import numpy as np
import pytest

from trl_explore.training.trials import Trials


def enter(trials: Trials, scores: list[float], diverged=None, frames=None, seconds=0.0) -> None:
    """One iteration; the lists have one entry for each trial that is still active."""
    trials.record(
        np.array(scores, dtype=np.float64),
        np.array(scores if frames is None else frames, dtype=np.int64),
        np.zeros(len(scores), np.bool_) if diverged is None else np.array(diverged),
        seconds,
    )


def test_a_full_window_is_needed():
    trials = Trials(1, max_iterations=10, score_threshold=5, score_window=3)
    for _ in range(2):
        enter(trials, [100.0])
        assert trials.active.all()
    enter(trials, [100.0])
    assert trials.status.tolist() == ["converged"]
    assert trials.iterations.tolist() == [3]
    assert trials.iteration == 3


def test_the_mean_must_be_strictly_greater():
    trials = Trials(2, max_iterations=10, score_threshold=5.0, score_window=2)
    enter(trials, [4.0, 4.0])
    enter(trials, [6.0, 6.5])  # means 5 and 5.25
    assert trials.status.tolist() == ["active", "converged"]
    assert trials.active.tolist() == [True, False]


def test_the_window_holds_the_last_episodes_only():
    trials = Trials(1, max_iterations=10, score_threshold=20, score_window=3)
    for score, mean in zip([10, 40, 1, 1, 4, 25, 40], [10, 25, 17, 14, 2, 10, 23], strict=True):
        enter(trials, [score])
        assert trials.score[0] == mean
    assert trials.status.tolist() == ["converged"]
    assert trials.iterations.tolist() == [7]


def test_the_cap():
    trials = Trials(1, max_iterations=3, score_threshold=5, score_window=2)
    for i in range(3):
        assert trials.active.all(), i
        enter(trials, [1.0])
    assert trials.status.tolist() == ["capped"]
    assert trials.iterations.tolist() == [3]
    assert not trials.converged.any()


def test_a_trial_that_passes_at_the_cap_has_converged():
    trials = Trials(2, max_iterations=2, score_threshold=5, score_window=2)
    enter(trials, [6.0, 6.0])
    enter(trials, [6.0, 1.0])
    assert trials.status.tolist() == ["converged", "capped"]


def test_a_cap_below_the_window_never_converges():
    trials = Trials(1, max_iterations=2, score_threshold=5, score_window=3)
    enter(trials, [9.0])
    enter(trials, [7.0])
    assert trials.status.tolist() == ["capped"]
    assert trials.score.tolist() == [8.0]  # over what there is


def test_divergence_goes_before_convergence_and_the_cap():
    trials = Trials(3, max_iterations=1, score_threshold=5, score_window=1)
    enter(trials, [9.0, 9.0, 1.0], diverged=[True, False, True])
    assert trials.status.tolist() == ["diverged", "converged", "diverged"]
    assert trials.converged.tolist() == [False, True, False]
    assert trials.passed.tolist() == [False, True, False]
    assert trials.active.tolist() == [False, False, False]


def test_each_trial_has_its_own_books():
    trials = Trials(3, max_iterations=9, score_threshold=5, score_window=2)
    enter(trials, [1.0, 2.0, 3.0], frames=[10, 20, 30], seconds=0.5)
    enter(trials, [2.0, 9.0, 4.0], frames=[11, 21, 31], seconds=1.0)  # trial 1 passes: 5.5
    enter(trials, [3.0, 5.0], frames=[12, 32], seconds=1.5, diverged=[True, False])
    enter(trials, [8.0], frames=[33], seconds=2.0)  # trial 2 passes: 6.5
    assert trials.status.tolist() == ["diverged", "converged", "converged"]
    assert trials.iterations.tolist() == [3, 2, 4]
    assert trials.frames.tolist() == [33, 41, 126]
    assert trials.seconds.tolist() == [1.5, 1.0, 2.0]
    assert trials.score.tolist() == [2.5, 5.5, 6.5]
    assert trials.iteration == 4
    assert len(trials) == 3

    episodes = trials.episodes()
    assert episodes["trial"].tolist() == [0, 1, 2, 0, 1, 2, 0, 2, 2]
    assert episodes["iteration"].tolist() == [1, 1, 1, 2, 2, 2, 3, 3, 4]
    assert episodes["score"].tolist() == [1, 2, 3, 2, 9, 4, 3, 5, 8]
    assert episodes["frames"].tolist() == [10, 20, 30, 11, 21, 31, 12, 32, 33]

    curves = trials.curves()
    assert list(curves) == ["episode_score", "score", "active", "converged"]
    # A stopped trial stands in the averages with its final score.
    np.testing.assert_allclose(
        curves["episode_score"], [2, 5, (3 + 5.5 + 5) / 3, (2.5 + 5.5 + 8) / 3]
    )
    np.testing.assert_allclose(
        curves["score"], [2, (1.5 + 5.5 + 3.5) / 3, (2.5 + 5.5 + 4.5) / 3, (2.5 + 5.5 + 6.5) / 3]
    )
    assert curves["active"].tolist() == [3, 2, 1, 0]
    assert curves["converged"].tolist() == [0, 1, 1, 2]


@pytest.mark.parametrize(
    ("trials", "options"),
    [
        (0, {}),
        (-1, {}),
        (2.0, {}),
        (1, {"max_iterations": 0}),
        (1, {"score_window": 0}),
        (1, {"score_threshold": float("nan")}),
        (1, {"score_threshold": "195"}),
    ],
)
def test_wrong_arguments(trials, options):
    name = next(iter(options), "trials")
    with pytest.raises(ValueError, match=rf"^{name}\b"):
        Trials(trials, **options)


def test_rounding_errors_do_not_outlive_the_window():
    """1e16 + 1 − 1e16 is 0: without a new sum, the mean would stay wrong for ever."""
    trials = Trials(1, max_iterations=100, score_threshold=1e20, score_window=3)
    for score in [1e16, *[1.0] * 8]:
        trials.record(np.array([score]), np.array([1]), np.array([False]), 0.0)
    assert trials.score.tolist() == [1.0]
