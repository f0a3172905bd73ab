"""Threads that run compiled code beside the calling one, and soon have work again."""

from __future__ import annotations

import atexit
import os
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trl_explore.checks import MAX_THREADS, check_integer
from trl_explore.numerics.bell import CALLED, CELLS, LINE, NUMBER, REPORTED, cells, heard, report

PATIENCE = 2_000_000
"""For how long a thread looks whether there is work before it falls asleep [ns]."""
NAP = 2e-4
"""For how long the calling thread then sleeps between two looks [s]."""

Call = Callable[[int], Any]
"""Something to do, given the address of the bell that its compiled code is to ring first; or 0."""


def together(calls: Sequence[Call]) -> list[Any]:
    """What the calls return, each on a thread of its own, the first one on the calling thread.

    The others begin when the first one rings (``bell.ring``); a thread that sleeps begins at once,
    and without a ring all begin after ``PATIENCE``. None is left running when one has failed or is
    interrupted: they write to memory that others will use again. Where the threads have work
    already, the calls are made one after the other.

    Raises:
        ValueError: if there are more than ``MAX_THREADS`` calls.
    """
    check_integer("threads", len(calls), 1, MAX_THREADS)
    crew = _crew()
    if crew.free.locked():
        return [call(0) for call in calls]
    with crew.free:  # its acquire() and a try would leave a gap for a signal between them
        return crew.run(calls)


@lru_cache(maxsize=1)
def _crew() -> Crew:
    crew = Crew()
    atexit.register(crew.dismiss)
    return crew


os.register_at_fork(after_in_child=_crew.cache_clear)  # threads stay behind


class Crew:
    """The calling thread and its workers, who are engaged when they are needed.

    Attributes:
        free: held while they work.
    """

    def __init__(self) -> None:
        self.free = threading.Lock()
        self._cells = cells(MAX_THREADS)
        self._workers: list[_Worker] = []

    def run(self, calls: Sequence[Call]) -> list[Any]:
        """As ``together``; ``free`` must be held."""
        first, *others = calls
        self._settle()  # what signals have left running
        if not others:
            return [first(0)]
        workers = self._engaged(len(others))
        self._cells[0] = len(workers)
        try:
            for worker, call in zip(workers, others, strict=True):
                worker.post(call)
            return [first(self._cells.ctypes.data), *[worker.result() for worker in workers]]
        except BaseException:
            self._settle()
            raise

    def _engaged(self, count: int) -> list[_Worker]:
        """So many workers."""
        if not self._workers:
            # Compiled here, where an error of the compiler or of its cache has somebody to go to.
            report(self._cells.ctypes.data, 0, self._cells.ctypes.data, 0)
            heard(self._cells.ctypes.data, 0, 0)
        for i in range(len(self._workers), count):
            place = LINE + i * CELLS
            self._workers.append(_Worker(i, self._cells[place : place + CELLS]))
        return self._workers[:count]

    def _settle(self) -> None:
        """Wait until nobody works, whatever signals come meanwhile."""
        while not all(map(_Worker.is_done, self._workers)):
            with suppress(BaseException):  # another one is on its way already
                for worker in self._workers:
                    worker.wait()
        for worker in self._workers:
            worker.forget()

    def dismiss(self) -> None:
        """End the workers: a thread must not come back to an interpreter that is gone."""
        self.free.acquire(blocking=False)  # for good: later calls are made one after the other
        for worker in self._workers:
            if worker.is_alive():  # none is in the child of a fork
                worker.end()


class _Worker(threading.Thread):
    """A thread that makes one call after the other."""

    def __init__(self, index: int, own: NDArray[np.int64]) -> None:
        super().__init__(name=f"trl_explore-{index + 1}", daemon=True)
        self._cells = own
        self._called, self._reported = (own.ctypes.data + 8 * i for i in (CALLED, REPORTED))
        # A signal may come inside of a condition's own ``with``, but not of that of a lock in C.
        self._lock = threading.RLock()
        self._changed = threading.Condition(self._lock)
        self._asleep = False
        self._posted = self._finished = 0
        self._call: Call | None = None
        self._result: Any = None
        self._error: BaseException | None = None
        self.start()

    def post(self, call: Call | None) -> None:
        """The next call, made when the bell rings, or at once by a thread that sleeps.

        None ends the thread.
        """
        with self._lock:
            self._call, self._result, self._error = call, None, None
            self._posted += 1
            self._cells[NUMBER] = self._posted
            if self._asleep:
                self._changed.notify_all()

    def is_done(self) -> bool:
        """Whether the last call has ended."""
        return self._finished == self._posted

    def wait(self) -> None:
        """Wait for the end of the last call."""
        if self.is_done() or heard(self._reported, self._posted - 1, PATIENCE):
            return
        while not self.is_done():
            with self._lock:
                self._changed.notify_all()  # in case that ``post`` was interrupted before it did
            time.sleep(NAP)

    def forget(self) -> None:
        """Let go of what the last call returned, or raised."""
        self._result = self._error = None

    def result(self) -> Any:
        """What the last call returned, or raised."""
        self.wait()
        result, error = self._result, self._error
        self.forget()
        try:
            if error is not None:
                raise error
            return result
        finally:
            del error  # which knows this frame

    def end(self) -> None:
        """End the thread."""
        self.post(None)
        self._cells[CALLED] = self._posted
        self.join()

    def run(self) -> None:
        last, called = 0, False
        while True:
            if not called:
                self._sleep(last)
            last, call, self._call = self._posted, self._call, None
            if call is None:
                return
            try:
                self._result = call(0)
            except BaseException as error:  # of whatever kind: it is the caller's
                self._error = error
            del call  # and the memory that it holds
            self._finished = last
            called = report(self._reported, last, self._called, PATIENCE)

    def _sleep(self, last: int) -> None:
        """Wait until there is a call after the number ``last``."""
        with self._lock:
            self._asleep = True
            while self._posted == last:
                self._changed.wait()
            self._asleep = False
