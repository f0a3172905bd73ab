"""Ctrl-C and SIGTERM: when a job may be left, and when it must not."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import NoReturn

PATIENCE = 0.8
"""Seconds that an iteration has to end by itself before it is broken off."""
TWICE = 0.3
"""Seconds within which a second signal is the first one again, as ``timeout`` sends it."""
WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated", signal.SIGHUP: "hung up"}


_received: list[Interrupted] = []
"""The signals that have come since the program began to serve them."""


class Interrupted(KeyboardInterrupt):
    """A signal that ends the program; not an ``Exception``, so that nobody takes it for one."""

    def __init__(self, signum: int) -> None:
        super().__init__(WORDS.get(signal.Signals(signum), "stopped"))
        self.signum = signum
        self.where = ""
        """Which job was broken off, and where it goes on."""

    @property
    def status(self) -> int:
        """The conventional exit status, 128 + the number of the signal."""
        return 128 + self.signum


def raise_on_signals() -> None:
    """From here on, SIGINT, SIGTERM and SIGHUP raise ``Interrupted`` wherever the program is."""

    def handle(signum: int, frame: FrameType | None) -> None:
        _received.append(Interrupted(signum))
        raise _received[0]

    _received.clear()
    sys.unraisablehook = _lost
    for signum in _served():
        signal.signal(signum, handle)


def _lost(event: sys.UnraisableHookArgs) -> None:
    """What was raised in a destructor goes no further: end the process here, without a word of it.

    Within a job the exception comes again, at the next boundary or by the timer.
    """
    if not isinstance(event.exc_value, Interrupted):
        sys.__unraisablehook__(event)
    elif not Interrupts.serving:
        leave(event.exc_value)


def check() -> None:
    """End here if a signal has come.

    What it raised may have been lost on the way, or taken for an error of the code it was in.

    Raises:
        Interrupted: if so.
    """
    if _received:
        raise _received[0] from None


def leave_on_signals() -> None:
    """From here on, they end the process at once: while it is only importing its modules."""

    def handle(signum: int, frame: FrameType | None) -> None:
        leave(Interrupted(signum))

    for signum in _served():
        signal.signal(signum, handle)


def leave(error: Interrupted) -> NoReturn:
    """End the process, with a line that says why and the conventional status."""
    print(f"{error}{error.where}; the same command goes on", file=sys.stderr, flush=True)
    os._exit(error.status)


def _served() -> list[signal.Signals]:
    """The signals that end a program; a hang-up only if nobody has said that it does not."""
    if threading.current_thread() is not threading.main_thread():
        return []  # only the main thread may set handlers
    ignored = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    return [signal.SIGINT, signal.SIGTERM] + ([] if ignored else [signal.SIGHUP])


class Interrupts:
    """What a signal does within a job; before and after, the handlers are as they were.

    * At first it ends the process at once, after ``tidy``: imports and compilers do not take an
      exception at any line.
    * Within ``deferred`` it is noted, and raised by ``check`` at the next boundary; if none comes
      in time, it is raised wherever the program is. What is broken off then is thrown away.
    * Within ``held`` it waits, however long that takes: files are being written.
    * The second one ends the process at once, whatever it does.

    Args:
        tidy: called before the process is ended at the beginning.
    """

    serving = False
    """Whether a job is served at present."""

    def __init__(self, tidy: Callable[[], None]) -> None:
        self.tidy = tidy
        self.pending: Interrupted | None = None
        self._deferred = False
        self._held = 0
        self._count = threading.Lock()
        self._since = 0.0

    def __enter__(self) -> Interrupts:
        served = _served()
        self._before = {signum: signal.getsignal(signum) for signum in served}
        for signum in served:
            signal.signal(signum, self._handle)
        if served:
            self._before[signal.SIGALRM] = signal.signal(signal.SIGALRM, self._alarm)
        Interrupts.serving = bool(served)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        Interrupts.serving = False
        for signum, handler in self._before.items():
            if signum == signal.SIGALRM:  # the last: nobody sets the timer any more
                self._stop_timer()
            signal.signal(signum, handler)
        if kind is None:
            self.check()

    def _handle(self, signum: int, frame: FrameType | None) -> None:
        if self.pending is not None:
            if time.monotonic() - self._since > TWICE:
                os._exit(self.pending.status)
            return
        self.pending, self._since = Interrupted(signum), time.monotonic()
        _received.append(self.pending)
        if not self._deferred:
            self.tidy()
            leave(self.pending)
        # Again and again: an exception within a destructor or a callback gets lost.
        signal.setitimer(signal.ITIMER_REAL, PATIENCE, TWICE)

    def _alarm(self, signum: int, frame: FrameType | None) -> None:
        if self.pending is not None and not self._held:
            raise self.pending

    def _stop_timer(self) -> None:
        if self._before:
            signal.setitimer(signal.ITIMER_REAL, 0)

    def check(self) -> None:
        """End here if a signal has come.

        Raises:
            Interrupted: if so.
        """
        if self.pending is not None:
            raise self.pending from None

    @contextmanager
    def deferred(self) -> Iterator[None]:
        """A signal waits for ``check``, but not for longer than ``PATIENCE``."""
        self._deferred = True
        try:
            yield
        finally:
            self._stop_timer()

    @contextmanager
    def held(self) -> Iterator[None]:
        """Nothing is raised here."""
        with self._count:  # several threads write their checkpoints
            self._held += 1
        try:
            yield
        finally:
            with self._count:
                self._held -= 1
