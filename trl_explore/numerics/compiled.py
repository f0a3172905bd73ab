"""Numba's cache of compiled code, made safe for several processes that compile at once.

The cache of a function is an index, signature -> number of a data file, and the data files. Numba
replaces each file atomically, but chooses the number from an index that it read before: of two
processes that compile two signatures of one function at the same time, both take the same number,
and the index of one may then point to the code of the other. A lock on the folder of the cache
makes reading the index and writing both files one step.

Numba notices when the file of a cached function changes, and not when another file does, from which
functions were compiled into it; ``compiled`` makes those part of the key.
"""

# numba's classes are not declared:
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import fcntl
import hashlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from types import ModuleType
from typing import Any

import numba as nb
from numba.core.caching import FunctionCache, IndexDataCacheFile

NAME = ".trl_explore.lock"


def lock_cache() -> None:
    """From here on, this process reads and writes numba's cache under a lock; idempotent."""
    if hasattr(IndexDataCacheFile.save, "__wrapped__"):
        return
    IndexDataCacheFile.save = _locked(IndexDataCacheFile.save, fcntl.LOCK_EX)
    IndexDataCacheFile.load = _locked(IndexDataCacheFile.load, fcntl.LOCK_SH)


def compiled(*modules: ModuleType, key: Any = None) -> Callable[[Callable[..., Any]], Any]:
    """Decorator: compiled without the interpreter's lock, and kept on disk until a source changes.

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


def _locked(method: Callable[..., Any], kind: int) -> Callable[..., Any]:
    @wraps(method)
    def call(self: IndexDataCacheFile, *args: Any) -> Any:
        with _lock(Path(self._cache_path), kind):
            return method(self, *args)

    return call


@contextmanager
def _lock(folder: Path, kind: int) -> Iterator[None]:
    """Hold the lock of a folder; without one where it cannot be had, as in a read-only folder."""
    try:
        file = os.open(folder / NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except OSError:
        yield
        return
    try:
        fcntl.flock(file, kind)
        yield
    finally:
        os.close(file)
