"""What a job writes, and that it is read back."""

from __future__ import annotations

import gc
import json
import os
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from tests.jobs.written import CONFIG, EPISODES_CSV, TRIALS_CSV, WEIGHTS, record, write
from trl_explore import jobs as results
from trl_explore.jobs import files, writing
from trl_explore.jobs.files import ResultsError
from trl_explore.training.trials import Trials

FILES = ["episodes.csv", "run.json", "scalars", "trials.csv", "weights.safetensors"]


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_files_to_the_letter(job):
    assert names(job) == FILES
    assert (job / "trials.csv").read_text() == TRIALS_CSV
    assert (job / "episodes.csv").read_text() == EPISODES_CSV
    assert names(job / "scalars") == [
        "active.csv",
        "converged.csv",
        "episode_score.csv",
        "score.csv",
    ]
    assert (job / "scalars" / "active.csv").read_text() == "1,3.0\n2,2.0\n3,1.0\n4,0.0\n"


def test_the_curves(job):
    curves = results.read_curves(job)
    assert sorted(curves) == ["active", "converged", "episode_score", "score"]
    assert curves.index.tolist() == [1, 2, 3, 4]
    for name, expected in record().curves().items():
        assert curves[name].tolist() == expected.tolist(), name


def test_run_json(job):
    run = results.read_run(job)
    assert run == json.loads((job / "run.json").read_text())
    expected = {
        "status": "finished",
        "experiment": "thesis",
        "strategy": "epsilon_greedy",
        "seed": 5,
        "trials": 3,
        "collector": "TorchRLCollector",
        "seconds": 2.25,
        "config": CONFIG,
    }
    assert {key: run[key] for key in expected} == expected
    assert run["versions"]["torch"] == torch.__version__
    assert set(run["versions"]) >= {"python", "trl_explore", "torchrl", "gymnasium", "numpy"}


def test_the_weights_load_without_pickle(job):
    loaded = load_file(job / "weights.safetensors")
    assert loaded.keys() == WEIGHTS.keys()
    assert torch.equal(loaded["weight"], WEIGHTS["weight"])


def test_reading_back(job):
    outcomes = results.read_job(job)
    assert outcomes.name == "epsilon_greedy,epsilon=0.1"
    assert (outcomes.experiment, outcomes.strategy) == ("thesis", "epsilon_greedy")
    assert outcomes.parameters == {"epsilon": 0.1}
    assert outcomes.config == CONFIG
    assert (outcomes.cap, outcomes.threshold, outcomes.window) == (4, 5.0, 2)
    assert outcomes.trial.tolist() == [10, 11, 12]
    assert outcomes.seed.tolist() == [5, 5, 5]
    assert outcomes.iterations.tolist() == [3, 2, 4]
    assert outcomes.converged.tolist() == [False, True, False]
    assert outcomes.score.tolist() == [2.5, 5.6, 4.0]
    assert outcomes.frames.tolist() == [33, 41, 126]
    assert outcomes.seconds.tolist() == [1.5, 1.0, 2.0]
    assert outcomes.status.tolist() == ["diverged", "converged", "capped"]
    assert outcomes.durations.tolist() == [4, 2, 4]
    assert outcomes.provenance["seconds"] == 2.25
    kinds = [outcomes.trial, outcomes.iterations, outcomes.frames, outcomes.seed]
    assert all(array.dtype == np.int64 for array in kinds)
    assert outcomes.converged.dtype == np.bool_
    episodes = results.read_episodes(job)
    for name, values in record().episodes().items():
        assert episodes[name].tolist() == (values + 10 * (name == "trial")).tolist()


def test_scores_keep_every_bit(tmp_path):
    trials = Trials(1, max_iterations=3, score_window=3)
    scores = [0.1 + 0.2, 1 / 3, 1e-17 + np.pi]
    for score in scores:
        trials.record(np.array([score]), np.array([1]), np.array([False]), 0.0)
    job = tmp_path / "job"
    job.mkdir()
    results.write_job(
        job, trials, {}, config={**CONFIG, "trials": 1}, experiment="e", strategy="s",
        collector="c", seconds=0.0,
    )  # fmt: skip
    assert results.read_episodes(job)["score"].tolist() == scores
    assert results.read_job(job).score[0] == np.mean(scores)
    assert results.read_curves(job)["episode_score"].tolist()[:2] == scores[:2]


def test_all_trials_of_one_status(tmp_path):
    """A column of one value only still reads as what it is."""
    for k, (score, name) in enumerate([(9.0, "converged"), (1.0, "capped")]):
        trials = Trials(2, max_iterations=1, score_threshold=5, score_window=1)
        trials.record(np.array([score] * 2), np.array([1, 1]), np.array([False] * 2), 0.0)
        job = tmp_path / str(k)
        job.mkdir()
        results.write_job(
            job, trials, {}, config={**CONFIG, "trials": 2}, experiment="e", strategy="s",
            collector="c", seconds=0.0,
        )  # fmt: skip
        outcomes = results.read_job(job)
        assert outcomes.status.tolist() == [name] * 2
        assert outcomes.converged.tolist() == [name == "converged"] * 2


def test_episodes_can_be_switched_off(tmp_path):
    job = write(tmp_path / "job", episodes=False)
    assert names(job) == [name for name in FILES if name != "episodes.csv"]
    assert len(results.read_job(job)) == 3
    with pytest.raises(ResultsError, match=r"episodes\.csv.*missing"):
        results.read_episodes(job)


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_writing_again_gives_the_same_files(job):
    before = contents(job)
    results.clear(job)
    assert names(job) == []
    write(job)
    assert contents(job) == before


def test_clear_leaves_other_files_alone(job):
    (job / ".hydra").mkdir()
    (job / ".hydra" / "config.yaml").write_text("seed: 0\n")
    (job / "notes.txt").write_text("mine")
    results.clear(job)
    assert names(job) == [".hydra", "notes.txt"]
    results.clear(job)  # nothing left to remove is no error


@pytest.mark.parametrize("point", range(5))
def test_a_job_is_complete_or_absent(tmp_path, monkeypatch, point):
    """Whatever file an interruption hits, the folder does not count as a finished job."""
    job, calls = tmp_path / "job", []
    write_whole, write_scalars = writing.write_whole, writing._write_scalars

    def whole(path, data):
        calls.append(path.name)
        if len(calls) > point:
            raise KeyboardInterrupt
        write_whole(path, data)

    def scalars(folder, trials):
        calls.append("scalars")
        if len(calls) > point:
            raise KeyboardInterrupt
        write_scalars(folder, trials)

    monkeypatch.setattr(writing, "write_whole", whole)
    monkeypatch.setattr(writing, "_write_scalars", scalars)
    with pytest.raises(KeyboardInterrupt):
        write(job)
    assert (
        calls[-1]
        == ["trials.csv", "episodes.csv", "scalars", "weights.safetensors", "run.json"][point]
    )
    assert not results.is_finished(job)
    assert results.find_jobs(tmp_path) == []
    with pytest.raises(ResultsError, match=r"run\.json.*missing"):
        results.read_job(job)
    monkeypatch.undo()
    results.clear(job)
    write(job)
    assert names(job) == FILES


def test_a_file_appears_whole_or_not_at_all(tmp_path, monkeypatch):
    def break_off(file: int) -> None:
        assert not (tmp_path / "file").exists() or (tmp_path / "file").read_text() == "old"
        raise OSError("disk full")

    monkeypatch.setattr(os, "fsync", break_off)
    for old in (None, "old"):
        if old:
            (tmp_path / "file").write_text(old)
        with pytest.raises(OSError, match="disk full"):
            files.write_whole(tmp_path / "file", b"half of")
        assert names(tmp_path) == ([] if old is None else ["file"])
    assert (tmp_path / "file").read_text() == "old"


def test_leftovers_of_a_killed_job_do_not_get_into_the_curves(job):
    """The logger of TorchRL appends to what it finds."""
    leftover = job / ".scalars.tmp" / "curves" / "scalars"
    leftover.mkdir(parents=True)
    (leftover / "score.csv").write_text("1,77.0\n")
    results.clear(job)
    write(job)
    assert results.read_curves(job)["score"].tolist() == record().curves()["score"].tolist()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="only Linux has it")
def test_a_full_disk_ends_the_scalars_without_a_traceback(job, monkeypatch):
    full = partial(open, "/dev/full", "w", encoding="utf-8")
    monkeypatch.setattr("torchrl.record.loggers.csv.open", lambda *_: full(), raising=False)
    results.clear(job)
    with pytest.raises(OSError, match=r"No space left on device: '.*scalars'") as caught:
        writing._write_scalars(job, record())
    lost: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", lost.append)
    del caught
    gc.collect()
    assert lost == []
    assert names(job) == []


def test_the_columns_are_those_of_the_documentation():
    assert tuple(results.TRIAL_COLUMNS) == (
        "trial", "seed", "iterations", "converged", "score", "frames", "seconds", "status",
    )  # fmt: skip
    assert tuple(results.EPISODE_COLUMNS)[:3] == ("trial", "iteration", "score")


def test_weights_are_read_back(job):
    import torch
    from safetensors.torch import load_file

    weights = results.read_weights(job)
    saved = load_file(job / "weights.safetensors")
    assert set(weights) == set(saved)
    for name, weight in weights.items():
        assert torch.equal(torch.from_numpy(weight), saved[name])
    (job / "weights.safetensors").write_bytes(b"{}")
    with pytest.raises(results.ResultsError, match=r"weights\.safetensors"):
        results.read_weights(job)
    (job / "weights.safetensors").unlink()
    with pytest.raises(results.ResultsError, match=r"weights\.safetensors.*missing"):
        results.read_weights(job)


LEARNED = {
    "learned": np.array([False, True, True]),
    "iterations_to_learn": np.array([3, 2, 0]),
    "frames_to_learn": np.array([33, 41, 0]),
    "learned_score": np.array([9.0, 500.0, 7.25]),
}


def test_what_was_learned_is_written_and_read_back(tmp_path):
    job = write(tmp_path / "job", learned=LEARNED)
    lines = (job / "trials.csv").read_text().splitlines()
    assert lines[0].endswith(",learned,iterations_to_learn,frames_to_learn,learned_score")
    assert lines[3].endswith(",capped,False,4,126,True,0,0,7.25")
    outcomes = results.read_job(job)
    for name, column in LEARNED.items():
        np.testing.assert_array_equal(getattr(outcomes, name), column)
    assert (outcomes.passed == [False, True, False]).all()


def test_a_job_that_is_being_cleared_is_first_of_all_unfinished(tmp_path, monkeypatch):
    job = write(tmp_path / "job")
    unlink, left = Path.unlink, [1]

    def once(path, missing_ok=False):
        if not left:
            raise OSError("killed")
        left.pop()
        unlink(path, missing_ok=missing_ok)

    monkeypatch.setattr(Path, "unlink", once)
    with pytest.raises(OSError, match="killed"):
        writing.clear(job)
    assert not results.is_finished(job)
