from __future__ import annotations

import json
import logging
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from trl_explore.commands import main, status
from trl_explore.jobs import sweep_files
from trl_explore.jobs.checkpoint import Store, pack
from trl_explore.jobs.files import ResultsError
from trl_explore.jobs.lock import Lock
from trl_explore.jobs.reading import find_jobs, read_run
from trl_explore.jobs.signals import Interrupted
from trl_explore.jobs.status import status_lines, survey

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "status.py"
REASON = "epsilon must be a number in [0, 1], got 2"
CAP = {"config": {"max_iterations": 1000}}


def finish(job: Path, **record) -> Path:
    job.mkdir(parents=True)
    (job / "run.json").write_text(json.dumps({**CAP, "iterations": 1000, "seconds": 2.5, **record}))
    return job


def begin(job: Path, *iterations: int) -> Path:
    """A job with a checkpoint after each of these iterations."""
    (job / ".hydra").mkdir(parents=True)
    store, history = Store(job), {"score": np.zeros(0)}
    for n in iterations:
        store.save({**CAP, "iteration": n, "seconds": n / 100}, pack({}), history)
    return job


@pytest.fixture
def sweep(tmp_path) -> Path:
    """One job in each state; ``f2`` failed before it had a folder."""
    sweep = tmp_path / "thesis"
    finish(sweep / "done")
    begin(sweep / "running", 100, 300, 200)
    begin(sweep / "cut", 450)
    sweep_files.record_failure(begin(sweep / "f1", 50), "the disk is full")
    sweep_files.record_failure(sweep / "f2", REASON)
    sweep_files.record_failure(sweep / "done", "of an earlier attempt")
    sweep_files.begin_sweep(sweep, ["done", "running", "cut", "f1", "f2", "l1", "l2"])
    return sweep


def test_every_state(sweep):
    with Lock(sweep / "running"):
        (found,) = survey([sweep])
    jobs = {job.name: (job.state, job.iterations, job.seconds) for job in found.jobs}
    assert jobs == {
        "done": ("done", 1000, 2.5),
        "running": ("running", 300, 3.0),
        "cut": ("cut off", 450, 4.5),
        "f1": ("failed", 50, 0.5),
        "f2": ("failed", None, None),
        "l1": ("left", None, None),
        "l2": ("left", None, None),
    }
    assert found.counts() == {"done": 1, "running": 1, "failed": 2, "cut off": 1, "left": 2}
    assert survey([sweep])[0].counts()["running"] == 0  # the lock has gone


def test_the_text(sweep):
    with Lock(sweep / "running"):
        lines = status_lines(survey([sweep])[0]).splitlines()
    assert lines[0] == f"{sweep}: 1 of 7 done, 1 running, 2 failed, 3 left (1 of them cut off)"
    assert [line.split() for line in lines[1:]] == [
        ["job", "state", "iterations", "passed", "learned", "seconds"],
        ["cut", "cut", "off", "450", "of", "1,000", "–", "–", "4.5"],
        ["done", "done", "1,000", "–", "–", "2.5"],
        ["f1", "failed", "50", "of", "1,000", "–", "–", "0.5", "the", "disk", "is", "full"],
        ["f2", "failed", "–", "–", "–", "–", *REASON.split()],
        ["l1", "left", "–", "–", "–", "–"],
        ["l2", "left", "–", "–", "–", "–"],
        ["running", "running", "300", "of", "1,000", "–", "–", "3.0"],
    ]


def test_what_a_finished_job_has_passed_and_learned(sweep):
    header = "trial,passed,iterations_to_pass,frames_to_pass,learned,iterations_to_learn"
    lines = [f"{header},frames_to_learn,learned_score", "0,True,1,9,False,5,99,2.5"]
    lines += ["1,True,2,9,True,5,99,9.5", "2,False,5,99,False,5,99,2.5"]
    (sweep / "done" / "trials.csv").write_text("\n".join(lines) + "\n")
    (line,) = [x for x in status_lines(survey([sweep])[0]).splitlines() if x.split()[0] == "done"]
    assert line.split() == ["done", "done", "1,000", "2", "of", "3", "1", "of", "3", "2.5"]
    (sweep / "done" / "trials.csv").write_text("\n".join([header, lines[1]]) + "\n")
    assert "–" in status_lines(survey([sweep])[0]).splitlines()[3]


@pytest.mark.parametrize("terminal", [True, False])
def test_watching_until_no_job_is_running(sweep, monkeypatch, capsys, terminal):
    """The running job ends while it is watched; on a terminal, lines are cut to its width."""
    lock = Lock(sweep / "running").__enter__()
    looks = []

    def wait(seconds):
        looks.append(seconds)
        if len(looks) == 2:
            lock.release()
        assert len(looks) < 9

    monkeypatch.setattr(status, "get_terminal_size", lambda: (40, 6))
    monkeypatch.setattr(status.time, "sleep", wait)
    monkeypatch.setattr(sys.stdout, "isatty", lambda: terminal, raising=False)
    status.watch([sweep])
    shown = capsys.readouterr().out
    assert len(looks) == 2
    if terminal:
        screens = shown.split("\033[H\033[J")[1:]
        assert len(screens) == 3
        assert all(len(line) <= 40 for screen in screens for line in screen.splitlines())
        assert all(len(screen.splitlines()) == 5 for screen in screens)
    else:
        assert [", 1 running" in line for line in shown.splitlines()] == [True, False]


def test_many_finished_jobs_are_only_counted(tmp_path):
    for k in range(50):
        finish(tmp_path / "s" / str(k))
    begin(tmp_path / "s" / "cut", 1)
    (found,) = survey([tmp_path])
    assert [line.split()[0] for line in status_lines(found).splitlines()[2:]] == ["cut"]
    assert len(status_lines(found, everything=True).splitlines()) == 2 + 51


def test_any_folders(sweep, tmp_path):
    """A job, a sweep, a folder of sweeps; what is given twice is told once."""
    finish(tmp_path / "other" / "a")
    assert [s.folder.name for s in survey([tmp_path])] == ["other", "thesis"]
    (one,) = survey([sweep / "cut"])
    assert [(job.name, job.state) for job in one.jobs] == [("cut", "cut off")]
    (both,) = survey([sweep, sweep / "cut"])
    assert len(both.jobs) == 7


@pytest.mark.parametrize("text", ["", "{", "[]", "3", "null", '{"seconds": "x"}', "\x00\xff",
                                  '{"seconds": NaN, "iterations": true}', "[" * 10**5])  # fmt: skip
def test_what_is_not_legible_is_not_known(sweep, text):
    for path in (
        sweep / "done" / "run.json",
        sweep / "sweep.json",
        sweep / ".failed" / "f1.json",
        sweep / "cut" / "checkpoint" / "0" / "b.safetensors",
    ):
        path.write_text(text)
    (found,) = survey([sweep])
    jobs = {job.name: job for job in found.jobs}
    assert jobs["done"].state == "done"
    assert (jobs["done"].iterations, jobs["done"].seconds) == (None, None)
    assert (jobs["cut"].state, jobs["cut"].iterations) == ("cut off", None)
    assert "reason" in jobs["f1"].reason
    assert "Traceback" not in status_lines(found)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
def test_a_pipe_is_no_record_of_a_job(tmp_path):
    finish(tmp_path / "done")
    (begin(tmp_path / "piped") / "run.json").unlink(missing_ok=True)
    os.mkfifo(tmp_path / "piped" / "run.json")
    (found,) = survey([tmp_path])
    assert [(job.name, job.state) for job in found.jobs] == [("done", "done"), ("piped", "cut off")]


def test_names_from_files_are_no_paths_and_move_no_cursor(tmp_path):
    sweep = tmp_path / "s"
    finish(sweep / "a")
    names = ["../x", "/etc", "..", "", 3, None, "fine", "red\033[31m"]
    (sweep / "sweep.json").write_text(json.dumps({"jobs": names}))
    (found,) = survey([sweep])
    assert [job.name for job in found.jobs] == ["a", "fine", "red\033[31m"]
    assert "red?[31m" in status_lines(found)
    assert "\033" not in status_lines(found)


def test_links_are_not_followed(tmp_path):
    finish(tmp_path / "elsewhere" / "a")
    finish(tmp_path / "here" / "b")
    (tmp_path / "here" / "link").symlink_to(tmp_path / "elsewhere")
    (found,) = survey([tmp_path / "here"])
    assert [job.name for job in found.jobs] == ["b"]


@pytest.mark.parametrize("what", ["absent", "empty", "file"])
def test_nothing_there_is_one_line(tmp_path, what):
    folder = tmp_path / "folder"
    if what == "empty":
        folder.mkdir()
    elif what == "file":
        folder.write_text("")
    with pytest.raises(ResultsError, match=str(folder)):
        survey([folder])
    done = subprocess.run([sys.executable, SCRIPT, folder], capture_output=True, text=True)
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (1, "", 1)


def test_the_command_needs_neither_torch_nor_pandas(sweep, tmp_path):
    for module in ("torch", "pandas", "hydra"):
        (tmp_path / "stub" / module).mkdir(parents=True)
        (tmp_path / "stub" / module / "__init__.py").write_text("raise SystemExit('imported')")
    path = os.pathsep.join([str(tmp_path / "stub"), str(SCRIPT.parent.parent)])
    done = subprocess.run(
        [sys.executable, SCRIPT, sweep],
        capture_output=True, text=True, env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(f"{sweep}: 1 of 7 done")


# What train.py writes for it


def test_an_earlier_sweep_that_is_not_done_stays_listed(tmp_path):
    sweep_files.begin_sweep(tmp_path, [])
    finish(tmp_path / "a")
    sweep_files.begin_sweep(tmp_path, ["a", "b"])
    sweep_files.begin_sweep(tmp_path, ["c"])
    assert sweep_files.read_asked(tmp_path) == ["c", "b"]
    finish(tmp_path / "b")
    sweep_files.end_sweep(tmp_path)
    assert sweep_files.read_asked(tmp_path) == ["c", "b"]
    finish(tmp_path / "c")
    sweep_files.end_sweep(tmp_path)
    assert not (tmp_path / "sweep.json").exists()


def test_a_sweep_of_which_nothing_could_begin_leaves_no_folder(tmp_path):
    sweep = tmp_path / "s"
    sweep.mkdir()
    sweep_files.begin_sweep(sweep, ["a"])
    (sweep / "multirun.yaml").write_text("")
    sweep_files.record_failure(sweep / "a", "wrong")
    sweep_files.end_sweep(sweep)
    assert not sweep.exists()


def test_a_failure_is_forgotten_when_the_job_is_finished(tmp_path):
    sweep_files.record_failure(tmp_path / "a", "wrong")
    sweep_files.record_failure(tmp_path / "b", "wrong too")
    sweep_files.forget_failure(tmp_path / "a")
    assert sweep_files.read_failures(tmp_path) == {"b": "wrong too"}
    sweep_files.forget_failure(tmp_path / "b")
    sweep_files.forget_failure(tmp_path / "b")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_read(sweep, monkeypatch):
    """No job is left out of status and of frames without a word."""
    allowed = os.scandir

    def scandir(place):
        if Path(place).name == "hidden":
            raise PermissionError(13, "Permission denied", str(place))
        return allowed(place)

    hidden = sweep / "more" / "hidden"
    hidden.mkdir(parents=True)
    monkeypatch.setattr(os, "scandir", scandir)
    for read in (lambda: survey([sweep]), lambda: find_jobs(sweep)):
        with pytest.raises(ResultsError, match=f"cannot read {hidden}: Permission denied"):
            read()


def test_a_record_that_cannot_be_read(sweep, monkeypatch):
    def read_bytes(path):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "read_bytes", read_bytes)
    (found,) = survey([sweep / "done"])
    assert [(job.state, job.iterations) for job in found.jobs] == [("done", None)]
    with pytest.raises(ResultsError, match=r"cannot read .*run\.json: Permission denied"):
        read_run(sweep / "done")


def test_an_error_of_the_file_system_is_one_line(monkeypatch, capsys):
    def fail(name):
        raise PermissionError(13, "Permission denied", "/somewhere/file")

    monkeypatch.setattr(main, "import_module", fail)
    assert main.main(["status", "."]) == 1
    assert capsys.readouterr().err == "error: /somewhere/file: Permission denied\n"


def test_only_the_temporary_files_of_ended_processes_are_removed(tmp_path):
    with subprocess.Popen(["true"]) as ended:
        pass
    kept, left = (tmp_path / f".{pid}.sweep.json.tmp" for pid in (os.getppid(), ended.pid))
    kept.touch()
    left.touch()
    sweep_files.begin_sweep(tmp_path, ["a job"])
    sweep_files.end_sweep(tmp_path)
    assert kept.exists()
    assert not left.exists()


def test_a_traceback_that_the_user_asked_for(monkeypatch):
    monkeypatch.setenv(main.TRACEBACK, "1")

    def fail(name):
        raise PermissionError(13, "Permission denied", "/somewhere/file")

    monkeypatch.setattr(main, "import_module", fail)
    with pytest.raises(PermissionError):
        main.main(["status", "."])


@pytest.mark.parametrize("name", ["SIGTERM", "SIGINT"])
def test_the_status_of_a_signal(monkeypatch, capsys, name):
    signum = signal.Signals[name]

    def fail(_):
        raise Interrupted(signum)

    monkeypatch.setattr(main, "import_module", fail)
    assert main.main(["report", "."]) == 128 + signum
    assert capsys.readouterr().err.count("\n") == 1


def test_a_warning_is_a_plain_line(monkeypatch, capsys):
    monkeypatch.setattr(logging.root, "handlers", [])
    assert main.main(["status", "no_such_folder"]) == 1
    logging.getLogger("trl_explore.jobs").warning("no file locks")
    assert capsys.readouterr().err.splitlines()[-1] == "no file locks"
