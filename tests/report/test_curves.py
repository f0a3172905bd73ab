"""Curves of what was recorded, from files and by hand."""

import numpy as np
import pytest

from trl_explore.report.curves import Curve, read_traces, running_means
from trl_explore.report.evidence import gather
from trl_explore.report.figures.panels import limits_of
from trl_explore.report.groups import group_jobs
from trl_explore.report.loading import load


def test_running_means_by_hand_leave_out_what_has_no_value():
    trial = np.array([0, 0, 0, 1, 1])
    iteration = np.array([1, 2, 3, 1, 2])
    values = np.array([1.0, np.nan, 4.0, np.nan, np.nan])
    table = running_means(trial, iteration, values, 2, np.array([1, 2, 3, 9]))
    # Trial 0: {1}, {1, nan}, {nan, 4}, carried on; trial 1 has no value at all.
    assert table[:, 0].tolist() == [1.0, 1.0, 4.0, 4.0]
    assert np.isnan(table[:, 1]).all()


def test_the_order_of_rows_does_not_matter():
    rng = np.random.default_rng(0)
    trial, iteration = np.repeat([3, 8], 5), np.tile(np.arange(1, 6), 2)
    values = rng.normal(size=10)
    order = rng.permutation(10)
    at = np.array([1, 3, 5])
    assert np.array_equal(
        running_means(trial, iteration, values, 3, at),
        running_means(trial[order], iteration[order], values[order], 3, at),
    )


def test_traces_of_a_group(tmp_path, make_job):
    make_job(tmp_path / "train", "softmax", [150, 200], diagnostics=True, evaluate_every=60)
    make_job(tmp_path / "train", "argmax", [150, 200], strategy="argmax")
    (group,) = group_jobs(load([tmp_path]).jobs)
    traces = read_traces(group)
    assert not traces.gaps
    assert len(traces.learning) == 2
    assert set(traces.diagnostics["kl"]) == set(traces.evaluations) == {"softmax"}
    kl = traces.diagnostics["kl"]["softmax"]
    assert np.allclose(kl.mean, 0.1)
    _, greedy = traces.evaluations["softmax"]
    # Evaluated at 60, 120 (both trials) and 180 (trial 1): 260, 320, (320 + 380) / 2.
    at = greedy.iterations
    assert greedy.mean[at <= 60].tolist() == pytest.approx([260.0] * int((at <= 60).sum()))
    assert greedy.mean[np.searchsorted(at, 121)] == pytest.approx(320.0)
    assert greedy.mean[-1] == pytest.approx(350.0)


def test_a_damaged_recording_is_a_gap_and_scores_are_still_drawn(tmp_path, make_job):
    job = make_job(tmp_path / "train", "softmax", [150, 200], diagnostics=True)
    make_job(tmp_path / "train", "argmax", [150, 200], strategy="argmax")
    text = (job / "episodes.csv").read_text()
    (job / "episodes.csv").write_text(text.replace(",0.25,", ",7.0,", 1))
    evidence = gather(load([tmp_path]))
    (gap,) = evidence.gaps
    assert "exploratory is outside the range 0 to 1" in gap.why
    assert len(evidence.groups[0].traces.learning) == 2
    assert evidence.groups[0].traces.diagnostics == {}


def test_limits():
    def row(values):
        return Curve(np.arange(1.0, 1 + len(values)), np.array(values))

    assert limits_of([row([2.0, 10.0]), row([4.0, 20.0])]) == (0.0, 21.0)
    low, high = limits_of([row([1e-12, 10.0])], log=True)
    assert low == pytest.approx(10 * 1e-6 / 1.5)
    assert high == 15.0
    assert limits_of([row([0.9, 1.1])], line=1.0, from_zero=False) == pytest.approx((0.89, 1.11))
