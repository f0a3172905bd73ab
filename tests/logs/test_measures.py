from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from trl_explore.jobs.files import ResultsError
from trl_explore.logs.log import Curve, clean
from trl_explore.logs.measures import profile, seeds_text, tasks
from trl_explore.logs.readers import Run
from trl_explore.statistics.comparisons import compare_pairs
from trl_explore.statistics.survival import kaplan_meier


def run(configuration, seed, step, score, *, environment="E", episodes=False, used=True):
    curve = clean(np.array(step, dtype=float), np.array(score, dtype=float))
    return Run(f"{configuration}/{seed}", configuration, environment, seed, curve, "return",
               "step", episodes, (), used)  # fmt: skip


def ramp(configuration, seed, end, slope, every=10):
    steps = np.arange(every, end + 1, every)
    return run(configuration, seed, steps, slope * steps)


def test_runs_are_judged_over_the_same_steps_whatever_their_interval():
    (task,) = tasks([ramp("a", 0, 1000, 0.1), ramp("a", 1, 2000, 0.1, every=50)], threshold=49.99)
    assert task.horizon == 1000
    (a,) = task.configurations
    assert a.time.tolist() == [500, 500]
    assert a.passed.all()
    np.testing.assert_allclose(a.final, 95)  # the mean of 90 to 100
    # The mean of 0.1 t is 50; before its first point, at 10 or 50, a curve is constant.
    np.testing.assert_allclose(a.area, [50 + 0.1 * 10 / 2 * 0.01, 50 + 0.1 * 50 / 2 * 0.05],
                               rtol=1e-4)  # fmt: skip


def test_a_run_that_passes_at_the_last_step_has_passed():
    (task,) = tasks([ramp("a", 0, 1000, 0.1), ramp("b", 0, 1000, 0.09)], threshold=99)
    assert [(c.passed.tolist(), c.time.tolist()) for c in task.configurations] == [
        ([True], [1000]), ([False], [1000]),
    ]  # fmt: skip


def test_a_run_that_was_cut_off_is_censored_and_one_that_diverged_never_passes():
    runs = [
        *(ramp("a", seed, 1000, 0.1) for seed in range(4)),
        run("a", 4, [10, 300], [1, 2]),
        run("a", 5, [10, 300, 310, 320], [1, 2, np.nan, np.nan]),
        run("a", 6, [10, 100, 200], [1, 99, 2]),
    ]
    (task,) = tasks(runs, threshold=50)
    (a,) = task.configurations
    assert task.horizon == 1000
    assert a.time.tolist() == [510] * 4 + [300, 1000, 100]
    assert a.passed.tolist() == [True] * 4 + [False, False, True]
    assert a.cut.tolist() == [False] * 4 + [True, False, False]
    assert a.diverged.tolist() == [False] * 5 + [True, False]
    assert np.isnan(a.final).tolist() == [False] * 4 + [True] * 3
    assert a.times().values.tolist() == [510] * 4 + [1000, 100]
    assert "no final score and no area (a: 3)" in task.notes[0]
    # Of 7 runs, 1 passed at 100; 1 of the other 6 was censored at 300; 4 of 5 passed at 510.
    np.testing.assert_allclose(kaplan_meier(a.time, a.passed).at([100, 510]), [6 / 7, 6 / 7 / 5])


def test_comparisons_are_paired_by_seed():
    rng = np.random.default_rng(0)
    shared = rng.normal(0, 0.05, 8)
    runs = [ramp("a", s, 1000, 0.10 + shared[s] / 10) for s in range(8)]
    runs += [ramp("b", s, 1000, 0.13 + shared[s] / 10 + rng.normal(0, 0.002)) for s in range(8)]
    (task,) = tasks(runs)
    score, area = task.measures()
    a, b = task.configurations
    for measure, values in ((score, (a.final, b.final)), (area, (a.area, b.area))):
        (c,) = compare_pairs([(a.outcomes(), b.outcomes())], measure)
        assert (c.design, c.n_a, c.winner) == ("paired", 8, "b")
        t = stats.ttest_rel(*values).confidence_interval(0.95)
        np.testing.assert_allclose([c.difference.low, c.difference.high], t, rtol=1e-6)


def test_unknown_seeds_are_not_paired():
    runs = [ramp(name, None, 1000, 0.1 + k / 100) for name in "ab" for k in range(4)]
    (task,) = tasks(runs, threshold=50)
    a, b = task.configurations
    for measure in task.measures():
        (c,) = compare_pairs([(a.outcomes(), b.outcomes())], measure)
        assert (c.design, c.difference.value, c.winner) == ("unpaired", 0.0, None)
    assert "seeds of a, b are unknown" in task.notes[0]


def test_environments_are_never_compared():
    runs = [ramp("a", 0, 1000, 0.1)]
    runs.append(run("a", 0, [10, 20], [1, 2], environment="F"))
    assert [(t.environment, t.horizon) for t in tasks(runs)] == [("E", 1000), ("F", 20)]


def test_single_episodes_are_smoothed_by_default():
    steps = np.arange(1, 61)
    noisy = [run("a", s, steps, steps % 2 * 10, episodes=True) for s in range(2)]
    (task,) = tasks(noisy, threshold=8)
    assert task.window == 12  # a fifth of the 60 episodes
    assert not task.configurations[0].passed.any()
    (task,) = tasks(noisy, threshold=8, window=1)
    assert task.configurations[0].time.tolist() == [1, 1]


def test_a_horizon_of_ones_own():
    runs = [ramp("a", 0, 1000, 0.1), ramp("b", 0, 500, 0.1)]
    assert tasks(runs)[0].horizon == 500
    assert "The runs of a are longer" in tasks(runs)[0].notes[0]
    (task,) = tasks(runs, horizon=800, threshold=70)
    assert [c.time.tolist() for c in task.configurations] == [[710], [500]]
    assert task.configurations[1].cut.tolist() == [True]
    with pytest.raises(ResultsError, match="no run reaches step 2,000"):
        tasks(runs, horizon=2000)
    with pytest.raises(ResultsError, match="no run has any values"):
        tasks([run("a", 0, [], [], used=False)])


def test_profiles_are_shares_with_wilsons_interval():
    first, last = profile(np.array([1.0, 2.0, 2.0, 5.0]), np.array([1.5, 5.0]))
    assert (first.value, last.value) == (0.75, 0.0)
    theirs = stats.binomtest(3, 4).proportion_ci(0.95, method="wilson")
    np.testing.assert_allclose([first.low, first.high], theirs)


def test_seeds_are_shown_as_ranges():
    curve = Curve(np.zeros(0), np.zeros(0))
    runs = [Run("", "", "", s, curve, "", "", False, ()) for s in (0, 1, 2, 4, 5, None)]
    assert seeds_text(runs) == "0–2, 4, 5, 1 unknown"
