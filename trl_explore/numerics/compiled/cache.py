"""Compilation of functions with a cache on disk, and a clock that excludes compilation.

This module makes numba's cache safe for processes that compile at the same time. The cache of a
function consists of data files and an index, signature -> number of a data file. Numba replaces
each file atomically, but chooses the number from an index that it has read earlier. Two processes
that compile two signatures of a function at the same time may choose the same number, and the index
of one may then point to the code of the other. A lock on the cache's folder makes reading the index
and writing both files one step.

Numba notices when the source file of a cached function changes, but not when functions from other
files, compiled into it, change. ``compiled`` makes those files part of the key.
"""

# numba's classes are not declared:
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import wraps
from pathlib import Path
from types import ModuleType
from typing import Any

import numba as nb
from numba.core import event
from numba.core.caching import FunctionCache, IndexDataCacheFile

NAME = ".trl_explore.lock"

kernel_function = nb.njit(nogil=True, error_model="numpy", forceinline=True)
"""Decorator of a function that is compiled into its caller.

It is not cached on disk; its caller is, because numba would not notice a change in another file.
"""


def lock_cache() -> None:
    """Make this process read and write numba's cache under a lock; idempotent."""
    if hasattr(IndexDataCacheFile.save, "__wrapped__"):
        return
    IndexDataCacheFile.save = _locked(IndexDataCacheFile.save, exclusive=True)
    IndexDataCacheFile.load = _locked(IndexDataCacheFile.load, exclusive=False)


def compiled(*modules: ModuleType, key: Any = None) -> Callable[[Callable[..., Any]], Any]:
    """Decorator: compile without the GIL, and cache on disk until a source file changes.

    If no cache folder is writable, every process compiles the function.

    Args:
        modules: the modules, besides the function's own, whose functions are compiled into it.
        key: the values that the function closes over; its ``repr`` distinguishes functions with
            the same source.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        own = function.__code__.co_filename
        files = [own, *(str(module.__file__) for module in modules)]
        parts = (*(Path(file).read_bytes() for file in files), repr(key).encode())
        dispatcher = nb.njit(nogil=True, error_model="numpy")(function)
        with suppress(RuntimeError):  # raised by numba if no cache folder is writable
            cache = SourceCache(function)
            cache.digest = hashlib.sha256(b"\0".join(parts)).hexdigest()
            dispatcher._cache = cache
        return dispatcher

    return decorate


class SourceCache(FunctionCache):
    """Numba's disk cache with a hash of the sources as part of its key.

    Numba's own key for a closure over functions differs in every process.
    """

    digest = ""

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return sig, codegen.magic_tuple(), self.digest


def _locked(method: Callable[..., Any], *, exclusive: bool) -> Callable[..., Any]:
    @wraps(method)
    def call(self: IndexDataCacheFile, *args: Any) -> Any:
        with _lock(Path(self._cache_path), exclusive=exclusive):
            return method(self, *args)

    return call


@contextmanager
def _lock(folder: Path, *, exclusive: bool) -> Iterator[None]:
    """Hold the lock of a folder; no lock if it is read-only or the system has no ``fcntl``."""
    try:
        import fcntl

        file = os.open(folder / NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except (ImportError, OSError):  # fcntl exists on Unix only
        yield
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH)
        yield
    finally:
        os.close(file)


class _CompileTime(event.Listener):
    """Total compile time of numba; nested compilations count once."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self._depth = 0
        self._started = 0.0

    def on_start(self, event: event.Event) -> None:
        if self._depth == 0:
            self._started = time.perf_counter()
        self._depth += 1

    def on_end(self, event: event.Event) -> None:
        self._depth -= 1
        if self._depth == 0:
            self.seconds += time.perf_counter() - self._started

    def total(self) -> float:
        """Seconds of compilation so far, including one that has not finished."""
        since = time.perf_counter() - self._started if self._depth else 0.0
        return self.seconds + since


_compiling = _CompileTime()
event.register("numba:compile", _compiling)


def clock() -> float:
    """Wall time [s] without compilation; only differences are meaningful.

    The first job after an installation compiles for some seconds, which must not count as time of
    its strategy.

    Example:
        >>> started = clock()
        >>> clock() - started < 1
        True
    """
    return time.perf_counter() - _compiling.total()
