"""Signals within a job."""

from __future__ import annotations

import os
import signal

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
