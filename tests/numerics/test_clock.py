"""The clock stands still while numba compiles, and only then."""

from __future__ import annotations

import time

import numba as nb
import pytest

from trl_explore.numerics.clock import _CompileTime, _compiling, clock


def test_it_stands_still_while_numba_compiles():
    @nb.njit
    def inner(x):
        return x + 1

    @nb.njit
    def outer(x):
        return inner(x) * 2

    before, started, wall = _compiling.seconds, clock(), time.perf_counter()
    assert outer(3) == 8
    went, took = clock() - started, time.perf_counter() - wall
    compiled = _compiling.seconds - before
    assert 0 < compiled < took
    assert went + compiled == pytest.approx(took, abs=1e-3)
    before = _compiling.seconds
    assert outer(3) == 8
    assert _compiling.seconds == before


def test_functions_within_functions_count_once(monkeypatch):
    times = iter([1.0, 5.0])
    monkeypatch.setattr(time, "perf_counter", lambda: next(times))
    listener = _CompileTime()
    for notice in (listener.on_start, listener.on_start, listener.on_end, listener.on_end):
        notice(None)
    assert listener.seconds == 4.0
