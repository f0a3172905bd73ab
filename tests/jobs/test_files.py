"""The files of a finished job are those that it wrote, or somebody is told."""

import json
import os
import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from tests.jobs.written import CONFIG, write
from trl_explore import jobs as results
from trl_explore.commands import report, status
from trl_explore.jobs.files import SMALL, ResultsError, flaws

LEARNED = {
    "learned": np.array([False, True, True]),
    "iterations_to_learn": np.array([3, 2, 0]),
    "frames_to_learn": np.array([33, 41, 0]),
    "learned_score": np.array([9.0, 500.0, 7.25]),
}


@pytest.fixture
def sweep(tmp_path) -> Path:
    """Two jobs that differ in a parameter and in what was learned."""
    write(tmp_path / "thesis" / "epsilon=0.1", learned=LEARNED)
    strategy = {"_target_": "somewhere", "epsilon": 0.2}
    write(tmp_path / "thesis" / "epsilon=0.2", config={**CONFIG, "strategy": strategy})
    return tmp_path / "thesis"


def another_score(job: Path) -> None:
    path = job / "trials.csv"
    path.write_text(path.read_text().replace(",5.6,", ",9.6,"))


def another_record(job: Path) -> None:
    shutil.copy(job.parent / "epsilon=0.2" / "run.json", job)


def no_weights(job: Path) -> None:
    weights = load_file(job / "weights.safetensors")
    save_file({k: np.zeros_like(w) for k, w in weights.items()}, job / "weights.safetensors")


def gone(job: Path) -> None:
    (job / "scalars" / "score.csv").unlink()


CHANGES = {
    another_score: "trials.csv: changed since the job finished",
    another_record: "trials.csv: ",
    no_weights: "weights.safetensors: changed since the job finished",
    gone: "score.csv: missing",
}


@pytest.mark.parametrize(("change", "complaint"), CHANGES.items())
def test_what_was_changed_is_told_by_every_command(sweep, change, complaint, monkeypatch, capsys):
    job = sweep / "epsilon=0.1"
    change(job)
    assert any(complaint in flaw for flaw in flaws(job))
    monkeypatch.setattr("sys.argv", ["status", str(sweep), "--verify"])
    assert status.main() == 1
    told = capsys.readouterr()
    assert complaint in told.err
    assert "epsilon=0.2" not in told.err
    monkeypatch.setattr("sys.argv", ["report", str(sweep)])
    assert report.main() == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if complaint in line]
    assert len(lines) == 1
    with pytest.raises(ResultsError, match=complaint):
        results.check_files(job, up_to=SMALL)


@pytest.mark.parametrize("change", [another_score, another_record])
def test_changed_trials_are_not_read(sweep, change):
    change(sweep / "epsilon=0.1")
    with pytest.raises(ResultsError, match=r"trials\.csv"):
        results.read_frame(sweep)


def test_each_file_that_is_read_is_compared(sweep):
    """A digit of a curve, an episode and a weight, none of which contradicts another file."""
    job = sweep / "epsilon=0.1"
    for name, old, new, read in (
        ("episodes.csv", b"9.2", b"9.3", results.read_episodes),
        ("scalars/score.csv", b"1,2.0", b"1,2.5", results.read_curves),
        ("weights.safetensors", b"\x41", b"\x40", results.read_weights),
    ):
        data = (job / name).read_bytes()
        assert old in data
        (job / name).write_bytes(data.replace(old, new))
        with pytest.raises(ResultsError, match="changed since the job finished"):
            read(job)
        (job / name).write_bytes(data)
        read(job)


def test_large_files_are_compared_when_they_are_used(sweep, monkeypatch):
    job = sweep / "epsilon=0.1"
    no_weights(job)
    size = (job / "weights.safetensors").stat().st_size
    assert list(flaws(job, up_to=size - 1)) == []
    assert len(list(flaws(job, up_to=size))) == len(list(flaws(job))) == 1


def test_an_unchanged_sweep_is_confirmed(sweep, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["status", str(sweep), "--verify"])
    assert status.main() == 0
    assert "every file of 2 finished jobs is unchanged" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["../other.csv", "/etc/hostname", "scalars/../../other.csv", ""])
def test_a_record_that_names_a_file_elsewhere_is_refused(sweep, name):
    job = sweep / "epsilon=0.1"
    run = results.read_run(job)
    run["files"][name] = {"bytes": 1}
    with pytest.raises(ResultsError, match="not a file of a job"):
        results.check_files(job, run)
    (job / "run.json").write_text(json.dumps({**run, "files": 3}))
    with pytest.raises(ResultsError, match="list of files is not valid"):
        results.check_files(job)


def test_a_file_that_cannot_be_opened_is_one_line(sweep, monkeypatch):
    def refuse(*arguments, **options):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("hashlib.file_digest", refuse)
    with pytest.raises(ResultsError, match=r"episodes\.csv: not readable \(Permission denied\)"):
        results.check_files(sweep / "epsilon=0.1", names=["episodes.csv"])


def test_contents_are_on_disk_before_the_name_is(tmp_path, monkeypatch):
    """After a power failure, a name must not lead to contents that were never written.

    The same holds for ``run.json``: the names of all other files are on disk before it is written.
    """
    steps, job = [], tmp_path / "job"
    fsync, replace = os.fsync, Path.replace

    def note(file):
        steps.append("folder" if os.path.samestat(os.fstat(file), job.stat()) else "file")
        fsync(file)

    def rename(path, target):
        steps.append(f"name {Path(target).name}")
        return replace(path, target)

    monkeypatch.setattr(os, "fsync", note)
    monkeypatch.setattr(Path, "replace", rename)
    write(job)
    for before, step in pairwise(steps):
        assert before == "file" or not step.startswith("name")
    assert steps[-3:] == ["folder", "file", "name run.json"]
