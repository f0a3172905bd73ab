"""Compiled code in several threads at once: who runs what, and what becomes of failures."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from trl_explore.numerics import crew
from trl_explore.numerics.bell import heard, ring
from trl_explore.numerics.compiled.cache import compiled
from trl_explore.numerics.crew import Crew, together


def thread(bell):
    return threading.get_ident()


@compiled()
def ring_and_wait(bell, cell):
    """Ring, and wait for somebody who writes the cell."""
    ring(bell)
    return heard(cell, 0, 20_000_000_000)


def test_results_are_in_the_order_of_the_calls():
    first, *others = together([thread, thread, lambda bell: 7])
    assert first == threading.get_ident()
    assert others[0] != first
    assert others[1] == 7
    assert together([lambda bell: 5]) == [5]


def test_threads_are_kept():
    idents = {together([thread, thread])[1] for _ in range(20)}
    assert len(idents) == 1


def test_only_the_first_call_has_a_bell():
    bells = together([int, int, int])
    assert bells[0] != 0
    assert bells[1:] == [0, 0]
    assert together([int]) == [0]


@pytest.mark.parametrize("pause", [0.0, 0.05], ids=["awake", "asleep"])
def test_the_others_begin_while_the_first_is_in_compiled_code(pause):
    """It would wait for ever, were nobody there to write what it waits for."""
    together([int, int])
    for _ in range(5):
        time.sleep(pause)
        cell = np.zeros(1, dtype=np.int64)

        def write(bell, cell=cell):
            cell[0] = 1
            return "written"

        assert together([lambda bell, c=cell: ring_and_wait(bell, c.ctypes.data), write]) == [
            True,
            "written",
        ]


def test_many_calls_in_a_row():
    """Thousands of changes between waiting, working and sleeping, and not one call is lost."""
    total = np.zeros(3, dtype=np.int64)

    def add(bell, k):
        total[k] += 1
        return total[k]

    for i in range(3000):
        if i % 500 == 0:
            time.sleep(0.02)
        assert together([lambda bell, k=k: add(bell, k) for k in range(1 + i % 3)])[0] == i + 1
    assert total.tolist() == [3000, 2000, 1000]


def test_a_bell_that_nobody_rings_is_not_waited_for():
    """A call without compiled code rings nothing; the others then begin by themselves."""
    together([int, int])  # one that waits awake
    begun = threading.Event()
    calls = [lambda bell: begun.wait(60), lambda bell: begun.set()]
    assert together(calls) == [True, None]


@pytest.mark.parametrize("broken", [0, 1])
@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_no_thread_is_left_running(broken, error):
    ended = []

    def fail(bell):
        raise error

    def work(bell):
        time.sleep(0.1)
        ended.append(True)

    calls = [work, work, work]
    calls[broken] = fail
    with pytest.raises(error):
        together(calls)
    assert len(ended) == 2
    assert together([int, lambda bell: 3])[1] == 3


class Alarm(BaseException):
    """What a signal raises."""


@pytest.fixture
def alarm():
    """Signals raise, wherever the program is."""

    def ring_alarm(number, frame):
        raise Alarm

    before = signal.signal(signal.SIGALRM, ring_alarm)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.signal(signal.SIGALRM, before)


def test_a_signal_at_any_moment_leaves_no_lock_and_no_call_behind(alarm):
    draw, memory, interrupted = random.Random(0), np.zeros(4), 0

    def write(bell, k, value):
        memory[k] = value

    for i in range(400):
        calls = [lambda bell, k=k, i=i: write(bell, k, i) for k in range(1 + i % 4)]
        try:
            signal.setitimer(signal.ITIMER_REAL, draw.uniform(1e-6, 3e-4))
            together(calls)
            signal.setitimer(signal.ITIMER_REAL, 0)
        except Alarm:
            interrupted += 1
        memory[:] = -1
        if i % 4 == 3:
            assert together([lambda bell, k=k: (k, write(bell, k, k))[0] for k in range(4)]) == [
                0, 1, 2, 3,
            ]  # fmt: skip
            assert memory.tolist() == [0, 1, 2, 3]
        else:
            assert memory.tolist() == [-1, -1, -1, -1]
    assert interrupted > 20


def test_a_second_signal_does_not_leave_a_thread_running(alarm):
    memory = []

    def slow(bell):
        time.sleep(0.3)
        memory.append("written")
        raise ValueError("of the first call")

    def wait(bell):
        signal.setitimer(signal.ITIMER_REAL, 0.05, 0.05)
        time.sleep(10)

    with pytest.raises(Alarm):
        together([wait, slow])
    signal.setitimer(signal.ITIMER_REAL, 0)
    assert memory == ["written"]
    assert together([int, lambda bell: 2])[1] == 2


def test_more_calls_than_threads_are_refused():
    with pytest.raises(ValueError, match=r"threads .*64.*65"):
        together([int] * 65)


def test_after_the_end_calls_are_made_one_after_the_other(monkeypatch):
    """As in an exit handler that runs after the one that ends the threads."""
    own = Crew()
    monkeypatch.setattr(crew, "_crew", lambda: own)
    assert together([thread, thread])[1] != threading.get_ident()
    own.dismiss()
    assert set(together([thread, thread])) == {threading.get_ident()}


def test_calls_from_within_a_call_are_made_there():
    def nested(bell):
        return together([thread, thread])

    own, other = together([nested, nested])
    assert own[0] == own[1] == threading.get_ident()
    assert other[0] == other[1] != own[0]


def test_a_result_is_not_kept():
    kept = Crew()
    try:
        assert kept.run([int, lambda bell: np.zeros(3)])[1].tolist() == [0, 0, 0]
        assert kept._workers[0]._result is None
        assert kept._workers[0]._call is None
    finally:
        kept.dismiss()
    assert not kept._workers[0].is_alive()


def test_the_interpreter_ends_while_threads_wait():
    code = (
        "from trl_explore.numerics.crew import together; print(together([int, lambda bell: 4])[1])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, "4\n", "")


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_process_has_threads_of_its_own():
    together([int, int])
    child = os.fork()
    if child == 0:
        status = 1
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(60)
        try:
            status = together([int, lambda bell: 0])[1]
        finally:
            os._exit(status)
    assert os.waitpid(child, 0)[1] == 0
