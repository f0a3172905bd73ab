"""Compiled code in several threads at once."""

from __future__ import annotations

import threading
import time

import pytest

from trl_explore.threads import together


def test_results_are_in_the_order_of_the_calls():
    main = threading.get_ident()
    first, *others = together([threading.get_ident, threading.get_ident, lambda: 7])
    assert first == main
    assert others[0] != main
    assert others[1] == 7
    assert together([lambda: 5]) == [5]


@pytest.mark.parametrize("broken", [0, 1])
@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_no_thread_is_left_running(broken, error):
    ended = []

    def fail():
        raise error

    def work():
        time.sleep(0.1)
        ended.append(True)

    calls = [work, work, work]
    calls[broken] = fail
    with pytest.raises(error):
        together(calls)
    assert len(ended) == 2
