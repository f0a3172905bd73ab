"""Numba's cache of compiled code, made safe for several processes that compile at once.

The cache of a function is an index, signature -> number of a data file, and the data files. Numba
replaces each file atomically, but chooses the number from an index that it read before: of two
processes that compile two signatures of one function at the same time, both take the same number,
and the index of one may then point to the code of the other. A lock on the folder of the cache
makes reading the index and writing both files one step.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Any

from numba.core.caching import IndexDataCacheFile

NAME = ".trl_explore.lock"


def lock_cache() -> None:
    """From here on, this process reads and writes numba's cache under a lock; idempotent."""
    if hasattr(IndexDataCacheFile.save, "__wrapped__"):
        return
    IndexDataCacheFile.save = _locked(IndexDataCacheFile.save, fcntl.LOCK_EX)
    IndexDataCacheFile.load = _locked(IndexDataCacheFile.load, fcntl.LOCK_SH)


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
