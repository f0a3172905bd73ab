"""Copies of an environment, in this process or divided among several.

Processes are for environments whose step takes long. Threads would not do: Box2D holds the lock of
the interpreter while it steps.
"""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
import weakref
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, fields
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from trl_explore.checks import first_line
from trl_explore.numerics.streams import Stream, generator

Make = Callable[[], gym.Env]
Rows = NDArray[np.int64]


@dataclass(frozen=True)
class Signals:
    """What the copies said last.

    Attributes:
        observation: [n, n_features].
        reward: [n].
        terminated: [n].
        truncated: [n].
        mask: [n, n_actions], False where an action is not allowed; [n, 0] where there are no masks.
    """

    observation: NDArray[np.float32]
    reward: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    mask: NDArray[np.bool_]

    @classmethod
    def of(cls, n: int, n_features: int, masked: int) -> Signals:
        """Those of n copies; ``masked`` is the number of actions in a mask."""
        return cls(
            np.zeros((n, n_features), dtype=np.float32),
            np.zeros(n),
            np.zeros(n, dtype=np.bool_),
            np.zeros(n, dtype=np.bool_),
            np.ones((n, masked), dtype=np.bool_),
        )

    def every(self, k: int) -> Signals:
        """A view of the copies 0, k, 2k, ..."""
        return Signals(*(getattr(self, field.name)[::k] for field in fields(self)))

    def rows(self, rows: Rows) -> tuple[NDArray[Any], ...]:
        """The columns of some copies."""
        return tuple(getattr(self, field.name)[rows] for field in fields(self))

    def put(self, rows: Rows, columns: tuple[NDArray[Any], ...]) -> None:
        """Write the columns of some copies."""
        for field, column in zip(fields(self), columns, strict=True):
            getattr(self, field.name)[rows] = column

    def read_mask(self, row: int, info: dict[str, Any]) -> None:
        """Take a copy's mask from ``info["action_mask"]``, if the environment gives masks."""
        if not self.mask.shape[1]:
            return
        mask = np.asarray(info.get("action_mask"), dtype=np.bool_)
        if mask.shape != self.mask.shape[1:]:
            raise ValueError(
                f"info['action_mask'] must be one value for each of {self.mask.shape[1]} actions, "
                f"got {info.get('action_mask')!r}"
            )
        self.mask[row] = mask


class Copies:
    """n copies of an environment, built when they are needed.

    Args:
        make: the constructor.
        n: how many.
        first: the first copy, if it exists already.
    """

    def __init__(self, make: Make, n: int, first: gym.Env | None = None) -> None:
        self.make, self.n = make, n
        self.envs = [] if first is None else [first]

    def reset(
        self,
        rows: Rows,
        trials: NDArray[np.int64],
        episodes: NDArray[np.int64],
        seed: int,
        stream: Stream,
        signals: Signals,
    ) -> None:
        """Begin an episode in the copies ``rows``, each drawn from its trial's stream [m]."""
        while len(self.envs) < self.n:
            self.envs.append(self.make())
        for row, trial, episode in zip(
            rows.tolist(), trials.tolist(), episodes.tolist(), strict=True
        ):
            env = self.envs[row]
            env.unwrapped.np_random = generator(seed, stream, trial, episode)
            signals.observation[row], info = env.reset()
            signals.reward[row] = 0
            signals.terminated[row] = signals.truncated[row] = False
            signals.read_mask(row, info)

    def step(self, rows: Rows, actions: NDArray[Any], signals: Signals) -> None:
        """Step the copies ``rows``, each by its action [m, ...]."""
        observation, reward = signals.observation, signals.reward
        terminated, truncated = signals.terminated, signals.truncated
        for row, action in zip(rows.tolist(), actions, strict=True):
            observation[row], reward[row], terminated[row], truncated[row], info = self.envs[
                row
            ].step(action)
            signals.read_mask(row, info)

    def close(self) -> None:
        """Close every copy."""
        for env in self.envs:
            env.close()


BOOT = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from trl_explore.envs.copies import serve; serve()"
)


class ProcessCopies(Copies):
    """``Copies`` divided among this process and others; the signals are the same.

    Copy ``row`` lives in process ``row % workers``, number 0 being this one: the copies that still
    run are then spread evenly when some have stopped. Each copy draws from streams of its own, so
    that nothing depends on where it is stepped.

    Args:
        id: gymnasium id; what is registered under it is made known to the other processes.
        make: the constructor; it is pickled, and called in the processes.
        n: how many copies.
        first: the first copy, if it exists already.
        workers: how many processes, at most n; they are started when they are needed.
        sizes: number of features, and of actions in a mask.
    """

    def __init__(
        self,
        id: str,
        make: Make,
        n: int,
        first: gym.Env | None = None,
        *,
        workers: int,
        sizes: tuple[int, int],
    ) -> None:
        super().__init__(make, len(range(0, n, workers)), first)
        self.id, self.workers = id, workers
        self._shares = [(len(range(k, n, workers)), sizes) for k in range(1, workers)]
        self._processes: list[_Process] = []

    def reset(
        self,
        rows: Rows,
        trials: NDArray[np.int64],
        episodes: NDArray[np.int64],
        seed: int,
        stream: Stream,
        signals: Signals,
    ) -> None:
        """``Copies.reset``."""
        self._call("reset", rows, (trials, episodes), (seed, stream), signals)

    def step(self, rows: Rows, actions: NDArray[Any], signals: Signals) -> None:
        """``Copies.step``."""
        self._call("step", rows, (actions,), (), signals)

    def _call(
        self,
        method: str,
        rows: Rows,
        each: tuple[NDArray[Any], ...],
        same: tuple[Any, ...],
        signals: Signals,
    ) -> None:
        """Call a method in every process that has some of the rows, and gather the signals."""
        parts = [np.flatnonzero(rows % self.workers == k) for k in range(self.workers)]
        calls = [(rows[part] // self.workers, *(x[part] for x in each), *same) for part in parts]
        try:
            self._start()
            asked = [k for k in range(1, self.workers) if len(parts[k])]
            for k in asked:
                self._processes[k - 1].send((method, calls[k]))
            getattr(super(), method)(*calls[0], signals.every(self.workers))
            for k in asked:
                signals.put(rows[parts[k]], self._processes[k - 1].receive())
        except _FailedError as error:
            self._end()
            raise RuntimeError(
                f"environment {self.id!r} in a process of its own: {error}"
            ) from None
        except BaseException:
            self._end()  # an answer that is not awaited would be taken for the next one's
            raise

    def _start(self) -> None:
        """Start the processes that are missing; they get ready side by side."""
        if self._processes:
            return
        spec = gym.registry.get(self.id)
        for share in self._shares:
            self._processes.append(_Process((spec, self.make, *share)))
        for process in self._processes:
            process.receive()

    def _end(self) -> None:
        for process in self._processes:
            process.end()
        self._processes = []

    def close(self) -> None:
        """Close every copy, and end the processes."""
        super().close()
        self._end()


class _FailedError(Exception):
    """What went wrong in a process, as one line."""


class _Process:
    """A Python process that serves requests on its standard input.

    A fresh interpreter with nothing but gymnasium: a fork would copy torch's locks, and
    multiprocessing's spawn would import the user's script again. It is in a session of its own, so
    that Ctrl-C reaches the main process only, and ends when its standard input does, also when
    the main process is killed.
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
                f"the environment cannot be sent to a process ({first_line(error)}); set workers=1"
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
        if failure:
            raise _FailedError(failure)
        return answer

    def _death(self) -> str:
        return f"the process has ended, status {self.process.wait()}"


def _end(process: subprocess.Popen[bytes]) -> None:
    """Let a process end, and wait for it."""
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
    """The main program of a process: requests on standard input, answers on standard output."""
    requests, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what an environment prints must not get among the answers
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
        except Exception as error:
            reply = f"{type(error).__name__}: {first_line(error)}", None
        try:
            pickle.dump(reply, answers, protocol=5)
            answers.flush()
        except BrokenPipeError:
            os._exit(0)  # the main process is gone; nothing is left to be told or flushed
    if share is not None:
        share.copies.close()


class _Share:
    """The copies that live in this process."""

    def __init__(self, spec: EnvSpec | None, make: Make, n: int, sizes: tuple[int, int]) -> None:
        if spec is not None:
            gym.registry.setdefault(spec.id, spec)
        self.copies = Copies(make, n)
        self.signals = Signals.of(n, *sizes)

    def answer(self, method: str, call: tuple[Any, ...]) -> tuple[NDArray[Any], ...]:
        """The signals of some copies after a method was called on them."""
        getattr(self.copies, method)(*call, self.signals)
        return self.signals.rows(call[0])
