"""The cache, with processes that compile at once (simulated by threads), and the clock."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

import numba as nb
import pytest
from numba.core.caching import IndexDataCacheFile

from trl_explore.numerics.compiled import cache
from trl_explore.numerics.compiled.cache import _CompileTime, _compiling, clock


@pytest.fixture(params=[False, True], ids=["numba", "locked"])
def locked(request, monkeypatch):
    """Numba as it is, and with the lock; each writer is slow between index and data."""
    save_index = IndexDataCacheFile._save_index

    def slow(self, overloads):
        time.sleep(0.1)
        save_index(self, overloads)

    for name in ("save", "load"):
        method = getattr(IndexDataCacheFile, name)
        monkeypatch.setattr(IndexDataCacheFile, name, getattr(method, "__wrapped__", method))
    monkeypatch.setattr(IndexDataCacheFile, "_save_index", slow)
    if request.param:
        cache.lock_cache()
    return request.param


def test_two_that_compile_at_once_do_not_mix_their_code(tmp_path, locked):
    files = [IndexDataCacheFile(str(tmp_path), "kernel", 1) for _ in range(2)]
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda k: files[k].save(f"signature {k}", f"code {k}"), range(2)))
    index = files[0]._load_index()
    assert (len(set(index.values())) == 2) == locked  # without the lock, one of them is lost
    if locked:
        assert [files[0].load(f"signature {k}") for k in range(2)] == ["code 0", "code 1"]


def test_locking_twice_is_locking_once(monkeypatch):
    for name in ("save", "load"):
        monkeypatch.setattr(IndexDataCacheFile, name, getattr(IndexDataCacheFile, name))
    cache.lock_cache()
    method = IndexDataCacheFile.save
    cache.lock_cache()
    assert IndexDataCacheFile.save is method


def test_a_folder_that_cannot_be_written_is_read_without_a_lock(tmp_path):
    with cache._lock(tmp_path / "absent", exclusive=True):
        pass
    assert list(tmp_path.iterdir()) == []


def test_code_is_compiled_where_no_cache_can_be_written(monkeypatch):
    def refuse(function):
        raise RuntimeError("cannot cache function: no locator available")

    monkeypatch.setattr(cache, "SourceCache", refuse)

    @cache.compiled()
    def double(x):
        return 2 * x

    assert double(3) == 6


def test_the_clock_stands_still_while_numba_compiles():
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
