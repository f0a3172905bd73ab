"""The cache, with processes that compile at once (simulated by threads), and the clock."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier
from types import SimpleNamespace

import numba as nb
import pytest
from numba.core.caching import CompileResultCacheImpl

from trl_explore.numerics.compiled import cache
from trl_explore.numerics.compiled.cache import _CompileTime, _compiling, clock


def test_two_that_compile_at_once_do_not_mix_their_code(tmp_path, monkeypatch):
    both = Barrier(2)
    load_index = cache._Files._load_index

    def at_once(self):
        index = load_index(self)
        both.wait(60)
        return index

    files = [cache._Files(str(tmp_path), "kernel", 1) for _ in range(2)]

    def save(k):
        files[k].save(f"signature {k}", f"code {k}")

    with monkeypatch.context() as patch, ThreadPoolExecutor(2) as pool:
        patch.setattr(cache._Files, "_load_index", at_once)
        list(pool.map(save, range(2)))
    assert len(list(tmp_path.glob("*.nbc"))) == 2
    found = [files[0].load(f"signature {k}") for k in range(2)]
    assert all(code in (None, f"code {k}") for k, code in enumerate(found))
    for k in range(2):  # a lost entry is written again
        save(k)
    assert [files[0].load(f"signature {k}") for k in range(2)] == ["code 0", "code 1"]


@pytest.fixture
def double(tmp_path, monkeypatch):
    """A function that multiplies by 2, with its cache in ``tmp_path``; new in every call.

    Or by another factor that it closes over; ``modules`` are compiled into it.
    """
    monkeypatch.setattr(nb.config, "CACHE_DIR", str(tmp_path))

    def make(factor=2, *modules):
        @cache.compiled(*modules, key=factor)
        def double(x):
            return factor * x

        return double

    assert make()(3) == 6
    return make


def test_functions_that_close_over_other_values_have_code_of_their_own(double):
    assert [double(factor)(3) for factor in (2, 5, 5, 2)] == [6, 15, 15, 6]


def test_a_function_is_compiled_again_after_a_change_of_another_module(tmp_path, double):
    module = SimpleNamespace(__file__=tmp_path / "helper.py")
    hits = []
    for text in ("one", "one", "two", "one"):
        module.__file__.write_text(text)
        function = double(2, module)
        function(3)
        hits.append(bool(function.stats.cache_hits))
    assert hits == [False, True, False, True]


def changes(data):
    yield "empty", b""
    yield "half", data[: len(data) // 2]
    yield "last byte", data[:-1] + bytes([data[-1] ^ 1])
    yield (
        "middle byte",
        data[: len(data) // 2] + bytes([data[len(data) // 2] ^ 1]) + data[len(data) // 2 + 1 :],
    )


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
def test_a_damaged_file_of_the_cache_is_replaced(tmp_path, double, suffix):
    (path,) = tmp_path.rglob(f"*.{suffix}")
    whole = path.read_bytes()
    for name, data in changes(whole):
        path.write_bytes(data)
        first, second = double(), double()
        assert first(3) == 6, name
        assert not first.stats.cache_hits, name
        assert second(3) == 6, name
        assert second.stats.cache_hits, name


def test_a_cache_that_cannot_be_written_is_not_used_and_one_line_says_so(
    tmp_path, double, monkeypatch, caplog
):
    for path in tmp_path.rglob("*.nb?"):
        path.unlink()

    def full(self, name, data):
        raise OSError(28, "No space left on device", name)

    monkeypatch.setattr(cache, "_warned", [])
    monkeypatch.setattr(cache._Files, "_save_data", full)
    assert [double()(3), double()(3)] == [6, 6]
    (record,) = caplog.records
    assert "No space left" in record.getMessage()


def test_a_file_of_the_cache_that_cannot_be_read_counts_as_missing(double, monkeypatch):
    def refuse(path):
        raise PermissionError(13, "Permission denied", str(path))

    again = double()
    monkeypatch.setattr(Path, "read_bytes", refuse)
    assert again(3) == 6
    assert not again.stats.cache_hits


def test_code_is_compiled_where_no_cache_can_be_written(monkeypatch, caplog):
    def refuse(function):
        raise RuntimeError("cannot cache function: no locator available")

    monkeypatch.setattr(cache, "SourceCache", refuse)
    monkeypatch.setattr(cache, "_warned", [])

    @cache.compiled()
    def double(x):
        return 2 * x

    assert double(3) == 6
    (record,) = caplog.records
    assert "NUMBA_CACHE_DIR" in record.getMessage()


def test_a_user_without_a_home_gets_no_folder_named_like_one(tmp_path, monkeypatch):
    monkeypatch.setattr(nb.config, "CACHE_DIR", "")
    monkeypatch.setenv("HOME", "~")
    monkeypatch.setenv("XDG_CACHE_HOME", "")
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(
        CompileResultCacheImpl._locator_classes[1], "from_function", lambda *arguments: None
    )
    monkeypatch.chdir(tmp_path)

    @cache.compiled()
    def double(x):
        return 2 * x

    assert double(3) == 6
    assert not list(tmp_path.iterdir())


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
