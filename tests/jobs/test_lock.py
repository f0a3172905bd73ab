"""File systems whose locks fail, never return, or exclude no process."""

import errno
import fcntl
import logging
import os
import socket
import subprocess
import threading
import time

import pytest

from trl_explore.jobs import lock, status
from trl_explore.jobs.lock import NAME, Lock, LockedError, is_locked

HOST = socket.gethostname()


def failing(code):
    def flock(file, kind):
        raise OSError(code, os.strerror(code))

    return flock


def waiting(file, kind):
    threading.Event().wait(3)


KINDS = {
    "ENOSYS": (failing(errno.ENOSYS), "Function not implemented"),
    "ENOLCK": (failing(errno.ENOLCK), "No locks available"),
    "waits": (waiting, "no answer within 0 s"),
    "does nothing": (lambda file, kind: None, "they exclude no process"),
}


@pytest.fixture(params=KINDS.values(), ids=KINDS)
def reason(request, monkeypatch):
    """A file system whose locks do not work, and why."""
    flock, reason = request.param
    monkeypatch.setattr(fcntl, "flock", flock)
    monkeypatch.setattr(lock, "BLOCKED", 0.02)
    monkeypatch.setattr(lock, "PATIENCE", 0.01)
    monkeypatch.setattr(lock, "_reasons", {})
    return reason


def test_the_lock_is_held_all_the_same(reason, tmp_path, caplog):
    job = tmp_path / "job"
    with caplog.at_level(logging.WARNING), Lock(job):
        assert caplog.text.count(reason) == 1
        assert str(tmp_path) in caplog.text
        assert "output_dir" in caplog.text
        assert is_locked(job)
        with pytest.raises(
            LockedError, match=rf"in use by process {os.getpid()} on .*delete .*\.lock"
        ):
            Lock(job).__enter__()
        with Lock(tmp_path / "another"):
            pass
        assert caplog.text.count(reason) == 1
    assert not job.exists()
    assert not is_locked(job)


def test_status_in_another_process(reason, tmp_path, monkeypatch):
    """It has not seen the locks fail before."""
    with Lock(tmp_path / "job"):
        (tmp_path / "job" / "trials.csv").touch()
        monkeypatch.setattr(lock, "_reasons", {})
        (sweep,) = status.survey([tmp_path])
        assert [job.state for job in sweep.jobs] == ["running"]


def test_a_process_that_was_killed_does_not_run_for_ever(reason, tmp_path):
    ended, unread = (subprocess.Popen(["cat"], stdin=subprocess.PIPE) for _ in range(2))
    births = [lock._birth(process.pid) for process in (ended, unread)]
    ended.communicate()
    unread.kill()  # its parent, as the first process of a container, does not ask how it ended
    os.waitid(os.P_PID, unread.pid, os.WEXITED | os.WNOWAIT)
    job = tmp_path / "job"
    processes = (
        *zip((ended.pid, unread.pid), births, strict=True),
        (os.getpid(), "17"),
        (2**40, "1"),
    )
    for pid, start in processes:
        job.mkdir()
        (job / NAME).write_text(f"{HOST} {pid} {start}")
        assert not is_locked(job)
        with Lock(job):
            assert is_locked(job)
    unread.communicate()


@pytest.mark.parametrize("age", [1, 10**6])
def test_a_process_on_another_computer_runs_if_it_has_written_lately(reason, tmp_path, age):
    job = tmp_path / "job"
    (job / "checkpoint" / "0").mkdir(parents=True)
    (job / NAME).write_text("elsewhere 17 4")
    (job / "checkpoint" / "0" / "a.safetensors").touch()
    for path in job.rglob("*"):
        os.utime(path, (time.time() - age,) * 2)
    assert is_locked(job) == (age == 1)
    for wait in (False, True)[:age]:  # only a process that runs is worth waiting for
        with pytest.raises(LockedError, match="process 17 on elsewhere"):
            Lock(job, wait=wait).__enter__()


@pytest.mark.parametrize("text", ["", "not of this program", "a b c", "\x00" * 9])
def test_a_file_with_other_words_is_nobodys(reason, tmp_path, text):
    (tmp_path / "job").mkdir()
    (tmp_path / "job" / NAME).write_text(text)
    assert not is_locked(tmp_path / "job")
    with Lock(tmp_path / "job"):
        pass


def test_where_locks_work_nothing_is_written(tmp_path, caplog):
    with Lock(tmp_path / "job"):
        assert (tmp_path / "job" / NAME).read_bytes() == b""
    assert not caplog.text


def test_a_file_deleted_before_it_was_locked_is_not_held(tmp_path, monkeypatch):
    """Another process releases the lock, and so deletes its file, between open and flock."""
    job, flock, calls = tmp_path / "job", lock._flock, []

    def late(file, kind):
        if not calls:
            (job / NAME).unlink()
        calls.append(file)
        flock(file, kind)

    monkeypatch.setattr(lock, "_reasons", {tmp_path.stat().st_dev: ""})
    monkeypatch.setattr(lock, "_flock", late)
    with Lock(job):
        assert len(calls) == 2
        assert is_locked(job)


def test_waiting_for_a_lock_ends_when_it_is_released(tmp_path):
    held = Lock(tmp_path / "job")
    held.__enter__()
    threading.Timer(0.3, held.release).start()
    with Lock(tmp_path / "job", wait=True):
        assert held._file < 0


def test_two_processes_may_look_at_once(tmp_path):
    (tmp_path / NAME).touch()
    with (tmp_path / NAME).open() as other:
        fcntl.flock(other, fcntl.LOCK_SH)
        assert not is_locked(tmp_path)


def test_a_released_lock_keeps_no_file_open(tmp_path):
    lowest = os.dup(0)
    os.close(lowest)
    with Lock(tmp_path / "job"):
        pass
    again = os.dup(0)
    os.close(again)
    assert again == lowest
