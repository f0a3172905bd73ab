"""Compilation of functions with a cache on disk, and a clock that excludes compilation.

This module makes numba's cache safe for processes that compile at the same time, without a lock,
which not every file system has. The cache of a function consists of data files and an index,
key -> name of a data file. Numba replaces each file atomically, but numbers the data files from an
index that it has read earlier. Two processes that compile two signatures of a function at the same
time may choose the same number, and the index of one may then point to the code of the other. Here
a hash of the key names the data file. At worst, an entry of the index is lost, and the function is
compiled once more.

Numba notices when the source file of a cached function changes, but not when functions from other
files, compiled into it, change. ``compiled`` makes those files part of the key.

Every file ends with the length of its contents and their SHA-256. A damaged file is replaced, and a
cache that cannot be written is not used: the function is then compiled in every process, and one
line says so.
"""

# numba's classes are not declared:
# pyright: reportAttributeAccessIssue=false, reportIncompatibleMethodOverride=false

from __future__ import annotations

import hashlib
import logging
import os
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numba as nb
from numba.core import event
from numba.core.caching import FunctionCache, IndexDataCacheFile, NullCache

SIZE, DIGEST = 8, hashlib.sha256().digest_size
"""The bytes that hold the length of what numba has written, and its digest."""
logger = logging.getLogger(__name__)

kernel_function = nb.njit(nogil=True, error_model="numpy", forceinline=True)
"""Decorator of a function that is compiled into its caller.

It is not cached on disk; its caller is, because numba would not notice a change in another file.
"""


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
        try:
            cache = SourceCache(function)
            cache.digest = hashlib.sha256(b"\0".join(parts)).hexdigest()
        except RuntimeError:  # raised by numba if no cache folder is writable
            cache = _NoCache()
        dispatcher._cache = cache
        return dispatcher

    return decorate


class SourceCache(FunctionCache):
    """Numba's disk cache with a hash of the sources as part of its key.

    Numba's own key for a closure over functions differs in every process.
    """

    digest = ""

    def __init__(self, function: Callable[..., Any]) -> None:
        if os.path.expanduser("~") == "~":  # noqa: PTH111  (the user has no home)
            os.environ.setdefault("XDG_CACHE_HOME", os.devnull)  # numba would make a folder ~
        super().__init__(function)
        stamp = self._impl.locator.get_source_stamp()
        self._cache_file = _Files(self._cache_path, self._impl.filename_base, stamp)

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return sig, codegen.magic_tuple(), self.digest

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save the code of a signature, if that is possible."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            _warn(f"{error.filename or self._cache_path}: {error.strerror}")


class _NoCache(NullCache):
    """The cache of a function if no cache folder is writable."""

    def save_overload(self, sig: Any, cres: Any) -> None:
        _warn("no folder is writable; NUMBA_CACHE_DIR names one")


def _warn(reason: str) -> None:
    if not _warned:
        _warned.append(reason)
        logger.warning("compiled code is not stored, so every process compiles it (%s)", reason)


_warned: list[str] = []
"""The reason that was printed; the others are not."""


class _Files(IndexDataCacheFile):
    """The files of a function's cache, named by their keys and checked by their digests."""

    def save(self, key: Any, data: Any) -> None:
        name = self._data_name(int(hashlib.sha256(repr(key).encode()).hexdigest()[:16], 16))
        self._save_data(name, data)
        self._save_index({**self._load_index(), key: name})

    def _dump(self, obj: Any) -> bytes:
        data = super()._dump(obj)
        return data + len(data).to_bytes(SIZE, "little") + hashlib.sha256(data).digest()

    def _load_index(self) -> dict[Any, str]:
        return super()._load_index() if _is_whole(Path(self._index_path)) else {}

    def _load_data(self, name: str) -> Any:
        return super()._load_data(name) if _is_whole(Path(self._data_path(name))) else None


def _is_whole(path: Path) -> bool:
    """Whether a file ends with what ``_Files._dump`` returned."""
    try:
        content = path.read_bytes()
    except OSError:  # missing, or another user's
        return False
    end = len(content) - SIZE - DIGEST
    start = end - int.from_bytes(content[end : end + SIZE], "little")
    whole = start >= 0 and hashlib.sha256(content[start:end]).digest() == content[-DIGEST:]
    if not whole:
        logger.debug("damaged: %s", path)
    return whole


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
