"""Copies of an environment, in this process or distributed over several.

Processes are for environments with slow steps. Threads would not help: Box2D holds the
interpreter lock (GIL) while it steps.
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
    """The last outputs of the copies.

    Attributes:
        observation: [n, n_features].
        reward: [n].
        terminated: [n].
        truncated: [n].
        mask: [n, n_actions], False where an action is not allowed; [n, 0] if there are no masks.
    """

    observation: NDArray[np.float32]
    reward: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    mask: NDArray[np.bool_]

    @classmethod
    def of(cls, n: int, n_features: int, masked: int) -> Signals:
        """Signals of n copies; ``masked`` is the number of actions in a mask, 0 without masks."""
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
        """The columns of the copies ``rows``."""
        return tuple(getattr(self, field.name)[rows] for field in fields(self))

    def put(self, rows: Rows, columns: tuple[NDArray[Any], ...]) -> None:
        """Write the columns of the copies ``rows``."""
        for field, column in zip(fields(self), columns, strict=True):
            getattr(self, field.name)[rows] = column

    def read_mask(self, row: int, info: dict[str, Any]) -> None:
        """Read a copy's mask from ``info["action_mask"]``, if the environment has masks."""
        if not self.mask.shape[1]:
            return
        mask = np.asarray(info.get("action_mask"), dtype=np.bool_)
        if mask.shape != self.mask.shape[1:]:
            raise ValueError(
                "info['action_mask'] must have one value for each of "
                f"{self.mask.shape[1]} actions, got {info.get('action_mask')!r}"
            )
        self.mask[row] = mask


class Copies:
    """n copies of an environment, built on first use.

    Args:
        make: the constructor.
        n: the number of copies.
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
        """Begin an episode in the copies ``rows`` [m], each with its trial's random stream."""
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
        """Step the copies ``rows`` [m] with their actions [m, ...].

        An environment gets a Python int, or an array of its own, which it may keep or change.
        """
        observation, reward = signals.observation, signals.reward
        terminated, truncated = signals.terminated, signals.truncated
        envs, masked = self.envs, signals.mask.shape[1] > 0
        own = actions.tolist() if actions.ndim == 1 else [action.copy() for action in actions]
        for row, action in zip(rows.tolist(), own, strict=True):
            result = envs[row].step(action)
            observation[row], reward[row], terminated[row], truncated[row], info = result
            if masked:
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
    """``Copies`` distributed over this process and others; the signals are the same.

    Copy ``row`` is in process ``row % workers``, where 0 is this process, so that the load stays
    even when some copies have stopped. Each trial has its own random streams, so results do not
    depend on the process.

    Args:
        id: gymnasium id; its registration is copied to the other processes.
        make: the constructor; it is pickled, and called in the processes.
        n: the number of copies.
        first: the first copy, if it exists already.
        workers: the number of processes, at most n; they are started on first use.
        sizes: the number of features, and of actions in a mask.
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
        """Call a method in every process that has some of the rows, and collect the signals."""
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
            self._processes.append(_Process((spec, self.make, *share)))
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

    def __init__(self, spec: EnvSpec | None, make: Make, n: int, sizes: tuple[int, int]) -> None:
        if spec is not None:
            gym.registry.setdefault(spec.id, spec)
        self.copies = Copies(make, n)
        self.signals = Signals.of(n, *sizes)

    def answer(self, method: str, call: tuple[Any, ...]) -> tuple[NDArray[Any], ...]:
        """Call a method on some copies; returns their signals."""
        getattr(self.copies, method)(*call, self.signals)
        return self.signals.rows(call[0])
