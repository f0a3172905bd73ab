"""Signals within a job."""

from __future__ import annotations

import io
import os
import signal
from subprocess import CalledProcessError

import pytest

from trl_explore.jobs import signals
from trl_explore.jobs.signals import Interrupted, Interrupts


@pytest.fixture
def interrupts(monkeypatch):
    """The signals of a job that is training; an immediate end of the process is an error here."""

    def leave(status):
        raise SystemExit(status)

    monkeypatch.setattr(os, "_exit", leave)
    monkeypatch.setattr(signals, "_received", [])
    with Interrupts(lambda: None) as handled:
        try:
            with handled.deferred():
                yield handled
        finally:
            handled.pending = None


def test_the_two_signals_of_timeout_are_one(interrupts):
    interrupts._handle(signal.SIGTERM, None)
    interrupts._handle(signal.SIGTERM, None)  # a moment later
    with pytest.raises(Interrupted, match="terminated"):
        interrupts.check()


def test_a_second_signal_after_a_while_ends_the_process_at_once(interrupts):
    interrupts._handle(signal.SIGINT, None)
    interrupts._since -= 2 * signals.TWICE
    with pytest.raises(SystemExit) as ended:
        interrupts._handle(signal.SIGINT, None)
    assert ended.value.code == 130


def asked(signum, frame):
    """As submitit's handler: requeue the job, and exit."""
    raise SystemExit(-1)


def refused(signum, frame):
    raise RuntimeError("timed-out too many times")


def ended_with(code):
    """As submitit's handler if ``scontrol`` did not end well."""

    def handle(signum, frame):
        raise CalledProcessError(code, "scontrol")

    return handle


@pytest.fixture
def on_requeue():
    """Set the handler that a launcher would set."""
    before = signal.getsignal(signal.SIGUSR2)
    yield lambda handler: signal.signal(signal.SIGUSR2, handler)
    signal.signal(signal.SIGUSR2, before)


def test_a_requeue_waits_until_the_job_is_saved(on_requeue, monkeypatch):
    monkeypatch.setattr(signals, "_received", [])
    on_requeue(asked)
    handled = Interrupts(lambda: None)
    with handled, handled.deferred():
        os.kill(os.getpid(), signal.SIGUSR2)  # does not call the handler of the launcher
        error, handled.pending = handled.pending, None
    assert error is not None
    assert signal.getsignal(signal.SIGUSR2) is asked
    with pytest.raises(SystemExit) as ended:
        signals.end_in_launcher(error)
    assert ended.value.code == 128 + signal.SIGUSR2


def test_a_requeue_before_training_releases_the_lock_and_leaves(on_requeue, monkeypatch):
    monkeypatch.setattr(signals, "_received", [])
    monkeypatch.setattr(signals, "leave", lambda error: order.append("left"))
    order = []
    on_requeue(lambda *_: order.append("requeued"))
    with Interrupts(lambda: order.append("released")) as handled:
        os.kill(os.getpid(), signal.SIGUSR2)
        handled.pending = None
    assert order == ["released", "requeued", "left"]


@pytest.mark.parametrize(
    ("handler", "error"),
    [
        (ended_with(-signal.SIGTERM), SystemExit),  # Slurm ended scontrol with the job
        (ended_with(1), CalledProcessError),
        (refused, RuntimeError),
    ],
)
def test_a_requeue_that_fails(on_requeue, handler, error):
    on_requeue(handler)
    with pytest.raises(error):
        signals.end_in_launcher(Interrupted(signal.SIGUSR2))


def test_a_signal_without_a_handler_is_not_touched(monkeypatch):
    monkeypatch.setattr(signals, "_received", [])
    assert signal.getsignal(signal.SIGUSR2) == signal.SIG_DFL
    with Interrupts(lambda: None):
        assert signal.getsignal(signal.SIGUSR2) == signal.SIG_DFL


def test_a_signal_that_a_destructor_drops_is_raised_again(interrupts, monkeypatch):
    monkeypatch.setattr(signals, "PATIENCE", 0.05)
    monkeypatch.setattr(signals, "TWICE", 0.05)
    interrupts._handle(signal.SIGTERM, None)
    for _ in range(2):
        with pytest.raises(Interrupted):
            signal.pause()


def test_a_signal_after_the_last_iteration_ends_the_job(monkeypatch):
    monkeypatch.setattr(signals, "_received", [])
    handled = Interrupts(lambda: None)
    with pytest.raises(Interrupted), handled, handled.deferred():
        os.kill(os.getpid(), signal.SIGTERM)


def test_a_hangup_that_is_ignored_stays_ignored():
    """``nohup`` ignores it for the program that it starts."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with Interrupts(lambda: None):
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_second_signal_does_not_break_off_the_last_words(interrupts, monkeypatch):
    class Slow(io.StringIO):
        def flush(self):
            os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr("sys.stderr", Slow())
    with pytest.raises(SystemExit) as ended:
        signals.leave(Interrupted(signal.SIGINT))
    assert ended.value.code == 130
    assert interrupts.pending is None
