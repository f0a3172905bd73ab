import numpy as np
import pytest

from trl_explore.statistics import samples
from trl_explore.statistics.samples import Sample, common_trials

CARTPOLE = {"env": {"id": "CartPole-v1", "max_steps": 500}}


def test_iterations_are_restricted_to_the_cap(make):
    o = make([100, 40, 1000], diverged=[1], converged=[1, 0, 0])
    s = samples.iterations(o)
    assert s.values.tolist() == [100, 1000, 1000]
    assert (s.cap, s.unit, s.label) == (1000, "iterations", "softmax")
    assert s.converged.tolist() == [True, False, False]


def test_frames_with_a_cost_of_iterations(make):
    o = make([100, 1000], frames=[9000, 20000], config=CARTPOLE)
    assert samples.frames(o).values.tolist() == [9000, 20000]
    s = samples.frames(o, per_iteration=10.0)
    assert s.values.tolist() == [10000, 30000]
    (failed,) = s.kinds
    assert (failed.least, failed.most) == (10_000, 1000 * 205)
    assert samples.frames(make([100])).kinds[0].most == np.inf


def test_scores_have_two_rare_kinds(make):
    o = make(
        [100, 150, 1000, 1000], score=[240, 196, 30, np.nan], diverged=[3], config=CARTPOLE,
        converged=[1, 1, 0, 0],
    )  # fmt: skip
    s = samples.scores(o)
    assert s.values.tolist() == [240, 196, 30]
    failed, first = s.kinds
    assert failed.members.tolist() == [False, False, True]
    assert (failed.least, failed.most) == (0, 195)
    assert first.members.tolist() == [True, False, False]
    assert (first.least, first.most) == (195, 500)
    assert s.ordinary.tolist() == [False, True, False]
    unknown = samples.scores(make([150, 1000])).kinds
    assert (unknown[0].least, unknown[1].most) == (-np.inf, np.inf)
    env = {"env": {"id": "Acrobot-v1", "max_steps": 500}}
    acrobot = make([150], score=[-90.0], config=env, threshold=-100)
    assert samples.scores(acrobot).kinds[0].least == -500


def test_common_trials_are_pairs(make):
    a, b = samples.iterations(make([1, 2, 3])), samples.iterations(make([7, 8], first_trial=2))
    x, y, paired = common_trials(a, b)
    assert (x.values.tolist(), y.values.tolist(), paired) == ([3], [7], True)
    assert common_trials(a, samples.iterations(make([9], seed=1)))[2] is False


def test_one_kind_of_trials_and_scaled_values():
    s = Sample.of([100.0, 1000.0], [False, True], least=1000.0, most=1000.0)
    assert s.only(s.converged).kinds == ()
    moved = s.scaled(0.5, 100.0)
    assert (moved.values.tolist(), moved.cap) == ([0.0, 450.0], 450.0)


def test_refuses():
    with pytest.raises(ValueError, match="all need the same"):
        Sample.of([1.0, 2.0], [True])
    with pytest.raises(ValueError, match="not finite"):
        Sample.of([np.nan])
