"""How functions are compiled and kept on disk, and a clock that excludes the compilation.

Numba's cache is made safe here for several processes that compile at once.
The cache of a function is an index, signature -> number of a data file, and the data files. Numba
replaces each file atomically, but chooses the number from an index that it read before: of two
processes that compile two signatures of one function at the same time, both take the same number,
and the index of one may then point to the code of the other. A lock on the folder of the cache
makes reading the index and writing both files one step.

Numba notices when the file of a cached function changes, but not when another file changes from
which functions were compiled into it; ``compiled`` makes those files part of the key.
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
"""Decorator of a function that is compiled into the one that calls it.

It is not cached on disk: numba would not notice a change in another file. Its caller is.
"""


def lock_cache() -> None:
    """From here on, this process reads and writes numba's cache under a lock; idempotent."""
    if hasattr(IndexDataCacheFile.save, "__wrapped__"):
        return
    IndexDataCacheFile.save = _locked(IndexDataCacheFile.save, exclusive=True)
    IndexDataCacheFile.load = _locked(IndexDataCacheFile.load, exclusive=False)


def compiled(*modules: ModuleType, key: Any = None) -> Callable[[Callable[..., Any]], Any]:
    """Decorator: compiled, releasing the interpreter's lock, and cached until a source changes.

    Where no folder can be written, the function is compiled in every process.

    Args:
        modules: whose functions are compiled into the decorated one, besides its own file.
        key: what the decorated function closes over; its ``repr`` distinguishes it from others
            that are made of the same source.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        own = function.__code__.co_filename
        files = [own, *(str(module.__file__) for module in modules)]
        parts = (*(Path(file).read_bytes() for file in files), repr(key).encode())
        dispatcher = nb.njit(nogil=True, error_model="numpy")(function)
        with suppress(RuntimeError):  # numba's, if it finds no folder that can be written
            cache = SourceCache(function)
            cache.digest = hashlib.sha256(b"\0".join(parts)).hexdigest()
            dispatcher._cache = cache
        return dispatcher

    return decorate


class SourceCache(FunctionCache):
    """Numba's disk cache with a digest of the sources as part of its key.

    Numba's own key of a closure over functions changes with every process.
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
    """Hold the lock of a folder; no lock where there can be none, as in a read-only folder."""
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
    """How long numba has compiled, functions within functions counted once."""

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
        """With the compilation that has not ended yet."""
        since = time.perf_counter() - self._started if self._depth else 0.0
        return self.seconds + since


_compiling = _CompileTime()
event.register("numba:compile", _compiling)


def clock() -> float:
    """Wall time [s] without that of compilation; only differences mean something.

    The first job after an installation compiles for some seconds. That says nothing of its
    strategy.

    Example:
        >>> started = clock()
        >>> clock() - started < 1
        True
    """
    return time.perf_counter() - _compiling.total()
