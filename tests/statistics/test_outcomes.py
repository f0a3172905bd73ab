from dataclasses import replace

import numpy as np
import pytest

from trl_explore.statistics.outcomes import convergence_times, judged
from trl_explore.statistics.pairing import pool, select
from trl_explore.statistics.survival import kaplan_meier


def test_times_of_a_diverged_trial(make):
    o = make([100, 1000, 37], converged=[1, 0, 0], diverged=[2])
    t, e = convergence_times(o)
    assert t.tolist() == [100, 1000, 1000]
    assert e.tolist() == [True, False, False]


def test_frames_keep_failed_trials_at_risk(make):
    # The second trial fails after few frames: censored there, the curve would reach 0.
    o = make([100, 1000, 200], frames=[9000, 8000, 18000])
    t, e = convergence_times(o, "frames")
    assert t.tolist() == [9000, 18000, 18000]
    assert kaplan_meier(t, e).survival[-1] == pytest.approx(1 / 3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"durations": [100, 500], "converged": [1, 0]}, "trial 1 stopped unconverged after 500"),
        ({"durations": [100, 1001], "converged": [1, 1]}, "trial 1 converged after 1001"),
        ({"durations": []}, "without trials"),
    ],
)
def test_unfinished_jobs_are_refused(make, options, message):
    with pytest.raises(ValueError, match=message):
        convergence_times(make(**options))


def test_unit_is_checked(make):
    with pytest.raises(ValueError, match="'seconds'"):
        convergence_times(make([1]), "seconds")


def learned(make, until, which, **options):
    """Four trials of cap 1000 that passed, passed, reached the cap, and diverged."""
    which = np.array(which, dtype=bool)
    return replace(
        make([150, 300, 1000, 37], converged=[1, 1, 0, 0], diverged=[3], **options),
        learned=which,
        iterations_to_learn=np.array(until),
        frames_to_learn=np.array(until) * 10,
        learned_score=np.array([500.0, 300.0, 20.0, 9.0]),
    )


def test_the_two_measures_of_a_trial(make):
    o = learned(make, [45, 0, 1000, 37], [1, 1, 0, 0])
    passed, by_learning = judged(o, "passed"), judged(o, "learned")
    assert passed.durations.tolist() == [150, 300, 1000, 1000]
    assert passed.score.tolist() == o.score.tolist()
    # A trial that had learned before its first update counts 1 iteration and 1 frame.
    assert by_learning.durations.tolist() == [45, 1, 1000, 1000]
    assert by_learning.converged.tolist() == [True, True, False, False]
    assert by_learning.status.tolist() == ["converged", "converged", "capped", "diverged"]
    assert by_learning.frames.tolist() == [450, 1, 50000, 1850]
    assert by_learning.score.tolist() == [500, 300, 20, 9]
    assert (passed.measure, by_learning.measure) == ("passed", "learned")
    times, _ = convergence_times(by_learning)
    assert times.tolist() == [45, 1, 1000, 1000]


def test_what_happened_before_a_trial_diverged_counts(make):
    o = judged(learned(make, [45, 60, 1000, 20], [1, 1, 0, 1]), "learned")
    assert o.durations.tolist() == [45, 60, 1000, 20]
    assert o.status.tolist() == ["converged", "converged", "capped", "converged"]


def test_a_trial_stopped_by_the_other_rule_is_censored_where_it_stopped(make):
    o = learned(make, [45, 300, 1000, 37], [1, 0, 0, 0])
    with pytest.raises(ValueError, match=r"1 of 4 trials.*stop_on=both or never"):
        judged(o, "learned")
    many = pool([replace(o, trial=o.trial + 4 * k) for k in range(5)])
    many = replace(many, learned=np.arange(20) != 1, iterations_to_learn=np.full(20, 50))
    censored = judged(many, "learned")
    times, events = convergence_times(censored)
    assert (times[1], events[1], censored.status[1]) == (300, False, "stopped")


def test_a_job_without_evaluations_has_one_measure(make):
    o = make([150, 1000])
    assert judged(o, "passed").converged.tolist() == [True, False]
    with pytest.raises(ValueError, match="has no evaluations"):
        judged(o, "learned")
    with pytest.raises(ValueError, match="passed or learned is possible"):
        judged(o, "scored")
    with pytest.raises(ValueError, match="unknown"):
        judged(make([150], config={"stop_on": "evaluation"}), "passed")


def test_selected_and_pooled_trials_keep_both_measures(make):
    o = learned(make, [45, 60, 1000, 37], [1, 1, 0, 0])
    part = select(o, np.array([0, 2]))
    assert judged(part, "learned").durations.tolist() == [45, 1000]
    assert judged(part, "passed").converged.tolist() == [True, False]
    both = pool([part, replace(o, trial=o.trial + 10)])
    assert judged(both, "learned").converged.tolist() == [True, False, True, True, False, False]
    without = make([150], first_trial=50)
    assert pool([o, without]).learned is None
