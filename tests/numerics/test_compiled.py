"""Processes that compile at once; simulated with threads, whose locks are as apart as theirs."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from numba.core.caching import IndexDataCacheFile

from trl_explore.numerics import compiled


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
        compiled.lock_cache()
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
    compiled.lock_cache()
    method = IndexDataCacheFile.save
    compiled.lock_cache()
    assert IndexDataCacheFile.save is method


def test_a_folder_that_cannot_be_written_is_read_without_a_lock(tmp_path):
    with compiled._lock(tmp_path / "absent", 1):
        pass
    assert list(tmp_path.iterdir()) == []
