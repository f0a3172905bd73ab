"""The clock of a training, which stands still while numba compiles."""

from __future__ import annotations

import time

from numba.core import event


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

    The first job after an installation compiles for some seconds. That is no property of its
    strategy.

    Example:
        >>> started = clock()
        >>> clock() - started < 1
        True
    """
    return time.perf_counter() - _compiling.total()
