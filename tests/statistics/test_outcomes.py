import pytest

from trl_explore.statistics.outcomes import convergence_times
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
