"""Copies of an environment: what they return is checked, and their errors name the place.

An environment is somebody else's code. Everything that it returns passes through ``Copies`` before
the program uses it: no value of a wrong type or shape is converted in silence.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from math import isfinite
from numbers import Real
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.wrappers import OrderEnforcing, TimeLimit
from numpy.typing import NDArray

from trl_explore.envs.flattening import writer
from trl_explore.envs.seeding import Source
from trl_explore.numerics.streams import Stream

Make = Callable[[], gym.Env]

MAX_REWARD = 1e30
"""The largest magnitude of a reward, so that sums over an episode are finite as float32."""


class EnvError(ValueError):
    """An environment that fails or returns what it must not; one line with trial and episode."""


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

    def rows(self, rows: Sequence[int]) -> tuple[NDArray[Any], ...]:
        """The columns of the copies ``rows``."""
        return tuple(getattr(self, field.name)[rows] for field in fields(self))

    def put(self, rows: Sequence[int], columns: tuple[NDArray[Any], ...]) -> None:
        """Write the columns of the copies ``rows``."""
        for field, column in zip(fields(self), columns, strict=True):
            getattr(self, field.name)[rows] = column


class Copies:
    """n copies of an environment, built on first use, which write into one set of signals.

    Args:
        id: gymnasium id, for messages.
        make: the constructor.
        signals: where the copies write.
        first: the first copy, if it exists already.
    """

    def __init__(self, id: str, make: Make, signals: Signals, first: gym.Env | None = None) -> None:
        self.id, self.make, self.signals = id, make, signals
        self.envs: list[gym.Env] = []
        self._sources: list[Source] = []
        self._steps: list[Callable[[Any], Any]] = []
        self._limits: list[int] = []
        self._ages: list[int] = []
        self._rows = list(signals.observation)
        self._places = [(0, 0)] * len(self._rows)
        self._masked = signals.mask.shape[1]
        if first is not None:
            self._add(first)

    def _add(self, env: gym.Env) -> None:
        self.envs.append(env)
        self._sources.append(Source(env))
        if not hasattr(self, "_write"):
            self._write = writer(env.observation_space)
        step, limit = _without_wrappers(env)
        self._steps.append(step)
        self._limits.append(limit)
        self._ages.append(0)

    def reset(
        self,
        rows: Sequence[int],
        trials: Sequence[int],
        episodes: Sequence[int],
        seed: int,
        stream: Stream,
    ) -> None:
        """Begin an episode in the copies ``rows`` [m], each with its trial's random stream."""
        while len(self.envs) < len(self._rows):
            self._add(self.make())
        signals = self.signals
        for row, trial, episode in zip(rows, trials, episodes, strict=True):
            self._places[row] = trial, episode
            try:
                answer = self._sources[row].reset(seed, stream, trial, episode)
            except (Exception, SystemExit) as error:
                raise self._raised(row, error) from error
            if type(answer) is not tuple or len(answer) != 2 or not isinstance(answer[1], dict):
                raise self.error(
                    row,
                    f"returned {_kinds(answer)} from reset (an old gym API?); "
                    "it must return observation, info",
                )
            observation, info = answer
            try:
                self._write(observation, self._rows[row])
            except ValueError as error:
                raise self.error(row, f"returned {error}") from None
            self._ages[row] = 0
            signals.reward[row] = 0
            signals.terminated[row] = signals.truncated[row] = False
            if self._masked:
                # A mask may come with steps only; the first action is then free.
                self._read_mask(row, info) if "action_mask" in info else signals.mask[row].fill(1)
            elif "action_mask" in info:
                self._check_info(row, info)

    def step(self, rows: Sequence[int], actions: Sequence[Any]) -> None:
        """Step the copies ``rows`` [m] with their actions [m]."""
        signals = self.signals
        rewards, terminated, truncated = signals.reward, signals.terminated, signals.truncated
        steps, views, ages, limits = self._steps, self._rows, self._ages, self._limits
        write, masked = self._write, self._masked
        for row, action in zip(rows, actions, strict=True):
            try:
                answer = steps[row](action)
            except (Exception, SystemExit) as error:
                raise self._raised(row, error) from error
            try:
                observation, reward, end, cut, info = answer
            except (TypeError, ValueError):
                raise self._wrong_step(row, answer) from None
            if (end is not True and end is not False) or (cut is not True and cut is not False):
                end, cut = self._flags(row, end, cut)
            if type(reward) is not float or not -MAX_REWARD <= reward <= MAX_REWARD:
                reward = self._reward(row, reward)
            try:
                write(observation, views[row])
            except ValueError as error:
                raise self.error(row, f"returned {error}") from None
            ages[row] = age = ages[row] + 1
            if age >= limits[row]:
                cut = True
            rewards[row] = reward
            terminated[row] = end
            truncated[row] = cut
            if masked:
                self._read_mask(row, info)
            elif type(info) is not dict or "action_mask" in info:
                self._check_info(row, info)

    def close(self) -> None:
        """Close every copy."""
        for env in self.envs:
            env.close()

    # What is wrong

    def error(self, row: int, what: str) -> EnvError:
        """The error of a copy that does ``what``, with the trial and the episode."""
        trial, episode = self._places[row]
        return EnvError(f"environment {self.id!r} {what} in episode {episode} of trial {trial}")

    def _raised(self, row: int, error: BaseException) -> EnvError:
        trial, episode = self._places[row]
        message = " ".join(str(error).split())
        return EnvError(
            f"environment {self.id!r} raised {type(error).__name__} in episode {episode} "
            f"of trial {trial}{f': {message}' if message else ''}"
        )

    def _wrong_step(self, row: int, answer: Any) -> EnvError:
        old = type(answer) is tuple and len(answer) == 4
        return self.error(
            row,
            f"returned {_kinds(answer)} from step{' (the old gym API)' if old else ''}; "
            "it must return observation, reward, terminated, truncated, info",
        )

    def _reward(self, row: int, reward: Any) -> float:
        """A reward that is not a Python float, as one."""
        number = None
        zero_dimensional = type(reward) is np.ndarray and reward.shape == ()
        if isinstance(reward, Real) or (zero_dimensional and reward.dtype.kind in "iuf"):
            try:
                number = float(reward)
            except OverflowError:
                number = float("inf")
        if number is None:
            shown = " ".join(repr(reward).split())[:80]
            raise self.error(row, f"returned the reward {shown}, which is not a number,")
        if not -MAX_REWARD <= number <= MAX_REWARD:
            allowed = f", which is not within ±{MAX_REWARD:g}," if isfinite(number) else ""
            raise self.error(row, f"returned the reward {number}{allowed}")
        return number

    def _flags(self, row: int, terminated: Any, truncated: Any) -> tuple[bool, bool]:
        """Flags that are not both Python bools, as such."""
        for name, flag in (("terminated", terminated), ("truncated", truncated)):
            if not isinstance(flag, bool | np.bool_):
                shown = " ".join(repr(flag).split())[:80]
                raise self.error(row, f"returned {name} = {shown}, which is not a bool,")
        return bool(terminated), bool(truncated)

    def _check_info(self, row: int, info: Any) -> None:
        if not isinstance(info, dict):
            raise self.error(row, f"returned info of type {type(info).__name__}, not dict,")
        if "action_mask" in info and isinstance(self.envs[row].action_space, gym.spaces.Discrete):
            raise self.error(
                row, "returned an action mask, but had none at its first reset and first step,"
            )

    def _read_mask(self, row: int, info: Any) -> None:
        """Read a copy's mask from ``info["action_mask"]``."""
        mask = info.get("action_mask") if isinstance(info, dict) else None
        array = np.asarray(mask)
        wrong = array.shape != (self._masked,) or array.dtype.kind not in "biuf"
        if wrong or (array.dtype.kind == "f" and not np.isin(array, (0, 1)).all()):
            raise self.error(
                row,
                "must return info['action_mask'] with one value for each of "
                f"{self._masked} actions, but returned {' '.join(repr(mask).split())[:80]}",
            )
        self.signals.mask[row] = array


def _without_wrappers(env: gym.Env) -> tuple[Callable[[Any], Any], int]:
    """The step function inside gymnasium's time limit and order check, and the limit.

    ``Copies`` does both, for a third of the time.
    """
    limit = np.iinfo(np.int64).max
    inner = env
    if type(inner) is TimeLimit:
        limit, inner = inner._max_episode_steps, inner.env
    if type(inner) is OrderEnforcing:
        inner = inner.env
    return inner.step, int(limit)


def _kinds(answer: Any) -> str:
    """What a method has returned, in a few words."""
    if type(answer) is not tuple:
        return f"one {type(answer).__name__}"
    return f"{len(answer)} values ({', '.join(type(value).__name__ for value in answer)})"
