"""Copies of an environment, distributed over several processes.

Processes are for environments with slow steps. Threads would not help: Box2D holds the
interpreter lock (GIL) while it steps.
"""

from __future__ import annotations

import json
import mmap
import os
import pickle
import subprocess
import sys
import tempfile
import traceback
import weakref
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from trl_explore.checks import check_integer, first_line
from trl_explore.envs.copies import Copies, EnvError, Make, Outputs
from trl_explore.numerics.streams import Stream

MAX_WORKERS, MIN_LANES = 256, 4
"""Most processes, and fewest lanes of each if their number is chosen automatically."""
BOOT = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from trl_explore.envs.processes import run_worker; run_worker()"
)


class ProcessCopies(Copies):
    """``Copies`` distributed over this process and others, with outputs in shared memory.

    Copy ``row`` is in process ``row % workers``, where 0 is this process, so that the load stays
    even when some copies have stopped. Each trial has its own random streams, so results do not
    depend on the process.

    Args:
        id: gymnasium id; its registration is copied to the other processes.
        make: the constructor; it is pickled, and called in the processes.
        first: the first copy.
        shape: the arguments of ``Outputs.of``.
        workers: the number of processes, at most n; they are started on first use.

    Attributes:
        all: the outputs of all copies.
    """

    def __init__(
        self, id: str, make: Make, first: gym.Env, shape: tuple[int, int, int], workers: int
    ) -> None:
        self._file, size = _memory_file(), Outputs.layout(*shape).itemsize
        os.ftruncate(self._file, size)
        weakref.finalize(self, os.close, self._file)
        self.all = Outputs.of(*shape, mmap.mmap(self._file, size))
        super().__init__(id, make, _share(self.all, 0, workers), first)
        self.workers, self._shape = workers, shape
        self._processes: list[_Process] = []

    def reset(
        self, rows: Sequence[int], trials: Any, episodes: Any, seed: int, stream: Stream
    ) -> None:
        """``Copies.reset``."""
        self._call("reset", rows, (np.asarray(trials), np.asarray(episodes)), (seed, stream))

    def step(self, rows: Sequence[int], actions: NDArray[Any]) -> bool:
        """``Copies.step``."""
        return self._call("step", rows, (actions,), ())

    def _call(
        self,
        method: str,
        rows: Sequence[int],
        each: tuple[NDArray[Any], ...],
        same: tuple[Any, ...],
    ) -> bool:
        """Call a method in every process that has some of the rows; whether one returns True."""
        copies, process = np.divmod(np.asarray(rows), self.workers)
        calls = [
            (copies[own].tolist(), *(x[own] for x in each), *same)
            for own in (process == k for k in range(self.workers))
        ]
        try:
            self._start()
            asked = [k for k in range(1, self.workers) if calls[k][0]]
            for k in asked:
                self._processes[k - 1].send((method, calls[k]))
            over = bool(getattr(super(), method)(*calls[0]))
            for k in asked:
                over |= bool(self._processes[k - 1].receive())
            return over
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
        for k in range(1, self.workers):
            setup = (self.id, spec, self.make, self._file, self._shape, k, self.workers)
            self._processes.append(_Process(setup, self._file))
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


def worker_count(workers: int | None, lanes: int) -> int:
    """The number of processes that step the lanes; None: one per processor."""
    if workers is None:
        return max(1, min(processors(), lanes // MIN_LANES))
    return min(check_integer("workers", workers, 1, MAX_WORKERS), lanes)


def processors() -> int:
    """The number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _memory_file() -> int:
    """A file without a name, in memory if the system has such files."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("outputs")
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


def _share(outputs: Outputs, k: int, workers: int) -> Outputs:
    """The outputs of the copies in process k."""
    columns: list[Any] = [column[k::workers] for column in outputs]
    return Outputs(*columns)


class _FailedError(Exception):
    """A failure in a process, as one line."""


class _Process:
    """A Python process that answers requests on its standard input.

    It is a fresh interpreter that loads gymnasium only: a fork would copy torch's locks, and
    multiprocessing's spawn would import the user's script again. It runs in a separate session, so
    that Ctrl-C reaches the main process only. It ends when its standard input closes, even if the
    main process is killed.
    """

    def __init__(self, setup: Any, file: int) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", BOOT, json.dumps([str(path) for path in sys.path])],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
            pass_fds=[file],
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


def run_worker() -> None:
    """Main program of a worker process: requests on standard input, answers on standard output."""
    requests, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # an environment's output must not mix with the answers
    copies = None
    while True:
        try:
            request = pickle.load(requests)
            if copies is None:
                copies, answer = _copies(*request), None
            else:
                answer = getattr(copies, request[0])(*request[1])
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
    if copies is not None:
        copies.close()


def _copies(
    id: str,
    spec: EnvSpec | None,
    make: Make,
    file: int,
    shape: tuple[int, int, int],
    k: int,
    workers: int,
) -> Copies:
    """The copies in this worker process."""
    if spec is not None:
        gym.registry.setdefault(spec.id, spec)
    memory = mmap.mmap(file, Outputs.layout(*shape).itemsize)
    return Copies(id, make, _share(Outputs.of(*shape, memory), k, workers))
