"""Cells of memory by which compiled code calls threads that wait in compiled code."""

from __future__ import annotations

import threading

import numpy as np

from trl_explore.numerics.bell import CELLS, LINE, NUMBER, cells, heard, report, ring
from trl_explore.numerics.compiled.cache import compiled


def test_a_bell_calls_as_many_workers_as_it_says():
    memory = cells(3)
    numbers = memory[LINE:].reshape(3, CELLS)
    numbers[:, NUMBER] = [4, 5, 6]
    memory[0] = 2
    address = memory.ctypes.data
    ringing = compiled(key="test")(lambda bell: ring(bell))
    ringing(0)
    assert numbers[:, 0].tolist() == [0, 0, 0]
    ringing(address)
    assert numbers[:, 0].tolist() == [4, 5, 0]
    assert heard(numbers[1].ctypes.data, 4, 1)
    assert not heard(numbers[1].ctypes.data, 5, 1000)


def test_a_report_waits_for_the_answer():
    own = np.zeros(2 * LINE, dtype=np.int64)
    told, answer = own.ctypes.data, own[LINE:].ctypes.data
    assert not report(told, 3, answer, 1)
    assert own[0] == 3
    other = threading.Thread(target=report, args=(answer, 5, told, 1))
    other.start()
    assert report(told, 4, answer, 20_000_000_000)
    other.join()
    assert own[[0, LINE]].tolist() == [4, 5]
