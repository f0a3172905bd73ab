"""Timing single trials of a real sweep."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest

from trl_explore.commands.time import time_trial
from trl_explore.jobs.files import ResultsError
from trl_explore.jobs.records import read_timings
from trl_explore.jobs.writing import write_timings
from trl_explore.report.loading import load


@pytest.fixture(scope="module")
def sweep(tmp_path_factory, run_many) -> Path:
    out = tmp_path_factory.mktemp("timed")
    short = ["trials=3", "max_iterations=4", "score_window=2", f"output_dir={out}"]
    (done,) = run_many([["-m", "strategy=softmax,argmax", *short]], out)
    assert done.returncode == 0, done.stderr
    return out / "train"


@pytest.fixture
def time_trials(request, run_many, tmp_path) -> Callable[..., Any]:
    script = request.config.rootpath / "scripts" / "time_trials.py"

    def run(*args: Path | str) -> Any:
        (ran,) = run_many([[str(arg) for arg in args]], tmp_path, script)
        return ran

    return run


def test_each_trial_runs_again_by_itself_with_the_frames_it_had(sweep, time_trials):
    done = time_trials(sweep, "--trials", "2")
    assert done.returncode == 0, done.stderr
    timings = read_timings(sweep)
    assert timings is not None
    assert len(timings) == 4
    assert set(timings["trial"]) == {0, 1}
    assert (timings["seconds"] > 0).all()
    for job in load([sweep]).jobs:
        mine = timings[timings["job"] == job.folder.name]
        assert mine["frames"].tolist() == job.outcomes.frames[:2].tolist()
        assert job.timing is not None
        assert job.timing.trial.tolist() == [0, 1]


def test_timings_of_other_jobs_stay(sweep, time_trials):
    assert time_trials(sweep, "--trials", "3").returncode == 0
    before = read_timings(sweep)
    job = next(path for path in sweep.iterdir() if path.name.startswith("softmax"))
    done = time_trials(job, "--trials", "1")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("1 trial") == 1
    after = read_timings(sweep)
    assert before is not None
    assert after is not None
    others = before["job"] != job.name
    assert sum(others) == 3
    kept = after[after["job"] != job.name].reset_index(drop=True)
    assert kept.equals(before[others].reset_index(drop=True))
    assert after.loc[after["job"] == job.name, "trial"].tolist() == [0]


def test_a_threshold_that_gymnasium_registers_is_found_again(run_many, tmp_path, time_trials):
    out = tmp_path / "registered"
    short = ["env.max_steps=20", "trials=2", "max_iterations=3", f"output_dir={out}"]
    (done,) = run_many([["env=gym", "env.id=Acrobot-v1", *short]], tmp_path)
    assert done.returncode == 0, done.stderr
    done = time_trials(out)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "line", ["strategy._target_=os.system", "+evil=1", "hydra.run.dir=elsewhere", "strategy=a,b"]
)
def test_a_recorded_configuration_is_not_trusted(sweep, time_trials, line):
    job = next(path for path in sweep.iterdir() if path.name.startswith("softmax"))
    recorded = job / ".hydra" / "overrides.yaml"
    before = recorded.read_text()
    recorded.write_text(f"{before}- {line}\n")
    try:
        done = time_trials(job)
    finally:
        recorded.write_text(before)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert done.stderr.startswith("error:")


def test_nothing_to_time_is_one_line(tmp_path, time_trials):
    done = time_trials(tmp_path)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: ")
    assert str(tmp_path) in line


def test_timings_are_read_as_they_were_written(tmp_path):
    timings = pd.DataFrame({"experiment": ["e"], "job": ["1.0"], "trial": [3], "seconds": [0.25],
                            "frames": [17]})  # fmt: skip
    write_timings(tmp_path, timings)
    pd.testing.assert_frame_equal(read_timings(tmp_path), timings, check_dtype=False)
    assert [p.name for p in tmp_path.iterdir()] == ["timings.csv"]


@pytest.mark.parametrize("rows", ["e,j,0,x,1", "e,j,0,-1,1", "e,j,0", "e,j,0,1,1\ne,j,0,2,1"])
def test_foreign_timings_are_refused(tmp_path, rows):
    (tmp_path / "timings.csv").write_text(f"experiment,job,trial,seconds,frames\n{rows}\n")
    with pytest.raises(ResultsError, match=r"timings\.csv"):
        read_timings(tmp_path)


def test_evaluations_are_not_part_of_the_time():
    ended = []
    trainer = SimpleNamespace(
        run=lambda: SimpleNamespace(frames=[7]), evaluating=100.0, close=lambda: ended.append(True)
    )
    trials = pd.DataFrame({"trial": [3, 4], "frames": [5, 7]})
    config = SimpleNamespace(first_trial=3)
    job: Any = SimpleNamespace(trainer=lambda trial: trainer, trials=trials, config=config)
    assert time_trial(job, 4) == (pytest.approx(-100, abs=1), 7)
    assert ended == [True]
