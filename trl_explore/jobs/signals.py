"""Handling of SIGINT (Ctrl-C), SIGTERM and SIGHUP: when they end a job, and when they wait."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from subprocess import CalledProcessError
from types import FrameType
from typing import Any, NoReturn

PATIENCE = 0.8
"""Seconds to wait for the end of an iteration before it is interrupted."""
TWICE = 0.3
"""A second signal within this time [s] counts as a repeat of the first; ``timeout`` sends two."""
LOOK = 0.5
"""Seconds between two checks that the parent process is alive."""
WATCH = "end with parent"
WORDS = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "hung up"}
REQUEUE = [getattr(signal, name) for name in ("SIGUSR1", "SIGUSR2") if hasattr(signal, name)]
"""Signals for which a launcher may have set a handler: submitit's requeues the job and exits."""
_received: list[Interrupted] = []
"""The signals received since ``raise_on_signals``."""


class Interrupted(KeyboardInterrupt):
    """A signal that ends the program; not an ``Exception``, so that no handler swallows it."""

    def __init__(self, signum: int) -> None:
        super().__init__(WORDS.get(signal.Signals(signum).name, "stopped"))
        self.signum = signum
        self.where = ""
        """Which job was interrupted, and the iteration from which it resumes."""

    @property
    def status(self) -> int:
        """The conventional exit status, 128 + the number of the signal."""
        return 128 + self.signum


def raise_on_signals() -> None:
    """Make SIGINT, SIGTERM and SIGHUP raise ``Interrupted`` at any point of the program."""

    def handle(signum: int, frame: FrameType | None) -> None:
        _received.append(Interrupted(signum))
        raise _received[0]

    _received.clear()
    sys.unraisablehook = _lost
    for signum in _handled():
        signal.signal(signum, handle)


def _lost(event: sys.UnraisableHookArgs) -> None:
    """End the process if ``Interrupted`` was raised in a destructor, where Python drops it.

    Within a job, the exception is raised again, after the iteration or by the timer.
    """
    if not isinstance(event.exc_value, Interrupted):
        sys.__unraisablehook__(event)
    elif not Interrupts.handling:
        leave(event.exc_value)


def check() -> None:
    """Raise the ``Interrupted`` of a received signal, which may have been dropped or converted."""
    if _received:
        raise _received[0] from None


def leave_on_signals() -> None:
    """Make these signals end the process at once, while it is still importing modules."""
    for signum in _handled():
        signal.signal(signum, lambda signum, frame: leave(Interrupted(signum)))


def leave(error: Interrupted) -> NoReturn:
    """Print why the process ends, and end it with the conventional status."""
    for signum in _handled():  # a second signal must not interrupt this
        signal.signal(signum, signal.SIG_IGN)
    print(f"{error}{error.where}; run the same command to resume", file=sys.stderr, flush=True)
    os._exit(error.status)


def end_with_parent() -> None:
    """End this process soon after its parent has ended, as on SIGTERM; idempotent.

    A process of joblib's pool would wait for more work.
    """

    def watch(parent: int) -> None:
        while os.getppid() == parent:
            time.sleep(LOOK)
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(2 * PATIENCE)
        os._exit(128 + signal.SIGTERM)

    if not any(thread.name == WATCH for thread in threading.enumerate()):
        threading.Thread(target=watch, args=[os.getppid()], name=WATCH, daemon=True).start()


def end_in_launcher(error: KeyboardInterrupt) -> NoReturn:
    """End the process of a submitit job after its job was interrupted and saved.

    submitit would take a return for the end of the job, although Slurm may start it again.

    Raises:
        Exception: if submitit was asked to requeue the job, and could not.
    """
    status = error.status if isinstance(error, Interrupted) else 128 + signal.SIGINT
    if isinstance(error, Interrupted) and error.signum in REQUEUE:
        _requeue(signal.getsignal(error.signum), error.signum)
    raise SystemExit(status) from None


def _requeue(handler: Any, signum: int) -> None:
    """Call the handler of a launcher, which requeues the job and exits; return instead."""
    try:
        handler(signum, None)
    except SystemExit:
        pass
    except CalledProcessError as error:
        if error.returncode >= 0:  # below 0: Slurm requeues the job, and so ended ``scontrol`` too
            raise


def _handled() -> list[signal.Signals]:
    """The signals to handle; SIGHUP only if it is not ignored (``nohup``)."""
    if threading.current_thread() is not threading.main_thread():
        return []  # only the main thread may set handlers
    hangup = [signal.SIGHUP] if hasattr(signal, "SIGHUP") else []  # Windows has none
    ignored = signal.SIG_IGN in map(signal.getsignal, hangup)
    return [signal.SIGINT, signal.SIGTERM, *([] if ignored else hangup)]


class Interrupts:
    """Handles signals within a job; restores the previous handlers afterwards.

    * Outside ``deferred``, a signal calls ``tidy`` and ends the process at once: imports and
      compilers do not survive an exception at an arbitrary line.
    * Within ``deferred``, it is recorded, and ``check`` raises it after the iteration; if the
      iteration takes longer than ``PATIENCE``, it is raised at once and the iteration is discarded.
    * Within ``held``, it waits without a limit, because files are being written.
    * A second signal ends the process at once, in every state.
    * A signal of ``REQUEUE`` with a handler counts too. ``end_in_launcher`` calls the handler after
      the job has saved its checkpoint; outside ``deferred``, it is called at once.

    Args:
        tidy: called before a signal outside ``deferred`` ends the process.
    """

    handling = False
    """Whether the signals of a job are being handled."""

    def __init__(self, tidy: Callable[[], None]) -> None:
        self.tidy = tidy
        self.pending: Interrupted | None = None
        self._deferred = False
        self._held = 0
        self._count = threading.Lock()
        self._since = 0.0

    def __enter__(self) -> Interrupts:
        handled = _handled()
        if handled:
            handled += [signum for signum in REQUEUE if callable(signal.getsignal(signum))]
        self._before = {signum: signal.getsignal(signum) for signum in handled}
        for signum in handled:
            signal.signal(signum, self._handle)
        if handled:
            self._before[signal.SIGALRM] = signal.signal(signal.SIGALRM, self._alarm)
        Interrupts.handling = bool(handled)
        return self

    def __exit__(self, kind: object, *error: object) -> None:
        Interrupts.handling = False
        for signum, handler in self._before.items():
            if signum == signal.SIGALRM:  # restored last: no handler sets the timer after it
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
            if signum in REQUEUE:
                _requeue(self._before[signal.Signals(signum)], signum)
            leave(self.pending)
        # Repeat it: an exception raised in a destructor or a callback is dropped.
        signal.setitimer(signal.ITIMER_REAL, PATIENCE, TWICE)

    def _alarm(self, signum: int, frame: FrameType | None) -> None:
        if self.pending is not None and not self._held:
            raise self.pending

    def _stop_timer(self) -> None:
        if self._before:
            signal.setitimer(signal.ITIMER_REAL, 0)

    def check(self) -> None:
        """Raise ``Interrupted`` if a signal was received."""
        if self.pending is not None:
            raise self.pending from None

    @contextmanager
    def deferred(self) -> Iterator[None]:
        """Within this context, a signal waits for ``check``, but at most ``PATIENCE`` seconds."""
        self._deferred = True
        try:
            yield
        finally:
            self._stop_timer()

    @contextmanager
    def held(self) -> Iterator[None]:
        """Within this context, no signal raises an exception."""
        with self._count:  # several threads write their checkpoints
            self._held += 1
        try:
            yield
        finally:
            with self._count:
                self._held -= 1
