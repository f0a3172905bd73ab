"""Copies of an environment, distributed over several processes.

Processes are for environments with slow steps. Threads would not help: Box2D holds the
interpreter lock (GIL) while it steps.
"""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
import traceback
import weakref
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from trl_explore.checks import first_line
from trl_explore.envs.copies import Copies, EnvError, Make, Signals
from trl_explore.numerics.streams import Stream

BOOT = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from trl_explore.envs.processes import serve; serve()"
)


class ProcessCopies(Copies):
    """``Copies`` distributed over this process and others; the signals are the same.

    Copy ``row`` is in process ``row % workers``, where 0 is this process, so that the load stays
    even when some copies have stopped. Each trial has its own random streams, so results do not
    depend on the process.

    Args:
        id: gymnasium id; its registration is copied to the other processes.
        make: the constructor; it is pickled, and called in the processes.
        signals: where the copies write.
        first: the first copy, if it exists already.
        workers: the number of processes, at most n; they are started on first use.
    """

    def __init__(
        self, id: str, make: Make, signals: Signals, first: gym.Env | None = None, *, workers: int
    ) -> None:
        super().__init__(id, make, signals.every(workers), first)
        self.workers, self.all = workers, signals
        n = len(signals.reward)
        sizes = (signals.observation.shape[1], signals.mask.shape[1])
        self._shares = [(len(range(k, n, workers)), *sizes) for k in range(1, workers)]
        self._processes: list[_Process] = []

    def reset(
        self,
        rows: Sequence[int],
        trials: Sequence[int],
        episodes: Sequence[int],
        seed: int,
        stream: Stream,
    ) -> None:
        """``Copies.reset``."""
        self._call("reset", rows, (trials, episodes), (seed, stream))

    def step(self, rows: Sequence[int], actions: Sequence[Any]) -> None:
        """``Copies.step``."""
        self._call("step", rows, (actions,), ())

    def _call(
        self,
        method: str,
        rows: Sequence[int],
        each: tuple[Sequence[Any], ...],
        same: tuple[Any, ...],
    ) -> None:
        """Call a method in every process that has some of the rows, and collect the signals."""
        n = self.workers
        parts = [[k for k, row in enumerate(rows) if row % n == part] for part in range(n)]
        calls = [
            ([rows[k] // n for k in part], *([x[k] for k in part] for x in each), *same)
            for part in parts
        ]
        try:
            self._start()
            asked = [k for k in range(1, n) if parts[k]]
            for k in asked:
                self._processes[k - 1].send((method, calls[k]))
            getattr(super(), method)(*calls[0])
            for k in asked:
                self.all.put([rows[i] for i in parts[k]], self._processes[k - 1].receive())
        except _FailedError as error:
            self._end()
            raise RuntimeError(
                f"environment {self.id!r} failed in a worker process: {error}"
            ) from None
        except BaseException:
            self._end()  # an unread answer would be taken for that of the next request
            raise

    def _start(self) -> None:
        """Start the processes, unless they run; they start up in parallel."""
        if self._processes:
            return
        spec = gym.registry.get(self.id)
        for share in self._shares:
            self._processes.append(_Process((self.id, spec, self.make, *share)))
        for process in self._processes:
            process.receive()

    def _end(self) -> None:
        for process in self._processes:
            process.end()
        self._processes = []

    def close(self) -> None:
        """Close every copy and end the processes."""
        super().close()
        self._end()


class _FailedError(Exception):
    """A failure in a process, as one line."""


class _Process:
    """A Python process that answers requests on its standard input.

    It is a fresh interpreter that loads gymnasium only: a fork would copy torch's locks, and
    multiprocessing's spawn would import the user's script again. It runs in a separate session, so
    that Ctrl-C reaches the main process only. It ends when its standard input closes, even if the
    main process is killed.
    """

    def __init__(self, setup: Any) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", BOOT, json.dumps([str(path) for path in sys.path])],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
        self.end = weakref.finalize(self, _end, self.process)
        try:
            self.send(setup)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            self.end()
            raise ValueError(
                "the environment cannot be pickled for a worker process "
                f"({first_line(error)}); set workers=1"
            ) from error

    def send(self, request: Any) -> None:
        pipe = self.process.stdin
        assert pipe is not None
        data = pickle.dumps(request, protocol=5)
        try:
            pipe.write(data)
            pipe.flush()
        except OSError:
            raise _FailedError(self._death()) from None

    def receive(self) -> Any:
        pipe = self.process.stdout
        assert pipe is not None
        try:
            failure, answer = pickle.load(pipe)
        except (EOFError, OSError, pickle.UnpicklingError):
            raise _FailedError(self._death()) from None
        if isinstance(failure, EnvError):
            raise failure
        if failure:
            raise _FailedError(failure)
        return answer

    def _death(self) -> str:
        return f"the process ended with status {self.process.wait()}"


def _end(process: subprocess.Popen[bytes]) -> None:
    """Close a process's pipes and wait for it; kill it if it takes too long."""
    for pipe in (process.stdin, process.stdout):
        assert pipe is not None
        with suppress(OSError):  # it may have ended before it read everything
            pipe.close()
    try:
        process.wait(timeout=5)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def serve() -> None:
    """Main program of a worker process: requests on standard input, answers on standard output."""
    requests, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # an environment's output must not mix with the answers
    share = None
    while True:
        try:
            request = pickle.load(requests)
            if share is None:
                share, answer = _Share(*request), None
            else:
                answer = share.answer(*request)
            reply = None, answer
        except EOFError:
            break
        except EnvError as error:  # the main process shows this traceback if the user wants it
            error.add_note("".join(traceback.format_exception(error)))
            reply = error, None
        except Exception as error:
            reply = f"{type(error).__name__}: {first_line(error)}", None
        try:
            pickle.dump(reply, answers, protocol=5)
            answers.flush()
        except BrokenPipeError:
            os._exit(0)  # the main process is gone: nothing left to answer or flush
    if share is not None:
        share.copies.close()


class _Share:
    """The copies in this worker process."""

    def __init__(
        self, id: str, spec: EnvSpec | None, make: Make, n: int, n_features: int, masked: int
    ) -> None:
        if spec is not None:
            gym.registry.setdefault(spec.id, spec)
        self.signals = Signals.of(n, n_features, masked)
        self.copies = Copies(id, make, self.signals)

    def answer(self, method: str, call: tuple[Any, ...]) -> tuple[NDArray[Any], ...]:
        """Call a method on some copies; returns their signals."""
        getattr(self.copies, method)(*call)
        return self.signals.rows(call[0])
