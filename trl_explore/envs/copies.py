"""Copies of an environment: what they return is checked, and their errors name the place."""

from __future__ import annotations

import logging
import signal
from collections.abc import Callable, Sequence
from math import inf, isfinite
from numbers import Real
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box, flatdim
from gymnasium.wrappers import OrderEnforcing, TimeLimit
from numpy.typing import NDArray

from trl_explore.checks import first_line
from trl_explore.envs.flattening import Actions, shown, writer
from trl_explore.envs.seeding import Source
from trl_explore.numerics.streams import Stream

logger = logging.getLogger(__name__)

Make = Callable[[], gym.Env]

FLOATS = (float, np.float64, np.float32)
"""The usual types of a reward."""
MESSAGE = 1000
"""The largest length of an environment's own message."""
MAX_REWARD = 1e30
"""The largest magnitude of a reward, so that sums over an episode are finite as float32."""
_FALSE = np.False_


class EnvError(ValueError):
    """An environment that fails or returns what it must not; one line with trial and episode."""

    @classmethod
    def placed(cls, id: str, what: str, trial: int, episode: int) -> EnvError:
        """The error of an environment that does ``what``."""
        return cls(f"environment {id!r} {what} in episode {episode} of trial {trial}")


class Outputs(NamedTuple):
    """The last outputs of the copies, one column each, in one piece of memory.

    Attributes:
        observation: [n, n_features]; reward, terminated and truncated are [n].
        mask: [n, n_actions], False where an action is not allowed; [n, 0] if there are no masks.
    """

    observation: NDArray[np.float32]
    reward: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    mask: NDArray[np.bool_]

    @classmethod
    def of(cls, n: int, n_features: int, masked: int, memory: Any = None) -> Outputs:
        """Outputs of n copies; ``masked`` is the number of actions in a mask, 0 without masks.

        ``memory`` is a buffer for the ``layout``; None: memory of its own.
        """
        layout = cls.layout(n, n_features, masked)
        whole = np.zeros((), layout) if memory is None else np.ndarray((), layout, memory)
        whole["mask"] = True
        columns: list[Any] = [whole[name] for name in cls._fields]
        return cls(*columns)

    @staticmethod
    def layout(n: int, n_features: int, masked: int) -> np.dtype[Any]:
        """The memory of n copies' outputs."""
        observation, mask = ("observation", "f4", (n, n_features)), ("mask", "?", (n, masked))
        flags = [(name, "?", (n,)) for name in ("terminated", "truncated")]
        return np.dtype([observation, ("reward", "f8", (n,)), *flags, mask], align=True)


class Copies:
    """n copies of an environment, built on first use, which write into one set of outputs.

    No value of a wrong type or shape is converted silently.

    Args:
        id: gymnasium id, for messages.
        make: the constructor.
        outputs: where the copies write.
        first: the first copy, if it exists already.
    """

    def __init__(self, id: str, make: Make, outputs: Outputs, first: gym.Env | None = None) -> None:
        self.id, self.make, self.outputs = id, make, outputs
        self.envs: list[gym.Env] = []
        self._sources: list[Source] = []
        self._steps: list[Callable[[Any], Any]] = []
        self._limits: list[int] = []
        self._ages: list[int] = []
        self._rows: list[Any] = list(outputs.observation)
        self._places = [(0, 0)] * len(self._rows)
        self._masked = outputs.mask.shape[1]
        # Assignment to a memoryview is fast, and fails if the type or the shape differs.
        self._views: list[Any] = [memoryview(row) for row in self._rows]
        reward: Any = outputs.reward
        self._rewards: Any = memoryview(reward)
        if first is not None:
            self._add(first)

    def _add(self, env: gym.Env) -> None:
        here, size = env.action_space, flatdim(env.observation_space)
        if self.envs and here != (first := self.envs[0].action_space):
            raise EnvError(
                f"environment {self.id!r} has the action space {shown(here)} in one "
                f"trial and {shown(first)} in another"
            )
        if size != (n_features := self.outputs.observation.shape[1]):
            raise EnvError(
                f"environment {self.id!r} has observations of {size} numbers in one trial "
                f"and of {n_features} in another"
            )
        if not self.envs:
            space = env.observation_space
            self._write, self._read = writer(space), Actions(env.action_space).read
            self._vectors = isinstance(space, Box) and len(space.shape) == 1
        self.envs.append(env)
        self._sources.append(Source(env))
        step, limit = _without_wrappers(env)
        self._steps.append(step)
        self._limits.append(limit)
        self._ages.append(0)

    def reset(
        self, rows: Sequence[int], trials: Any, episodes: Any, seed: int, stream: Stream
    ) -> None:
        """Begin the episodes [m] of the trials [m] in the copies ``rows`` [m]."""
        while (k := len(self.envs)) < len(self._rows):
            try:
                env = self.make()
            except ValueError as error:
                of = dict(zip(rows, trials, strict=True)).get(k, "another one")
                raise EnvError(f"{error}, when it was built for trial {of}") from error
            self._add(env)
        outputs = self.outputs
        for row, trial, episode in zip(rows, trials, episodes, strict=True):
            self._places[row] = trial, episode
            try:
                answer = self._sources[row].reset(seed, stream, trial, episode)
            except BaseException as error:
                raise self._raised(row, error) from error
            if type(answer) is not tuple or len(answer) != 2 or not isinstance(answer[1], dict):
                raise self._wrong(row, answer, "reset (an old gym API?)", "observation, info")
            observation, info = answer
            self._observe(row, observation)
            self._ages[row] = 0
            outputs.reward[row] = 0
            outputs.terminated[row] = outputs.truncated[row] = False
            if self._masked:
                # A mask may come with steps only; the first action is then free.
                self._read_mask(row, info) if "action_mask" in info else outputs.mask[row].fill(1)
            elif "action_mask" in info:
                self._check_info(row, info)

    def step(  # noqa: C901 - one loop, because every call per step costs time
        self, rows: Sequence[int], actions: NDArray[Any]
    ) -> bool:
        """Step the copies ``rows`` [m] with actions [m] or [m, n_dims]; whether one ends."""
        terminated, truncated = self.outputs.terminated, self.outputs.truncated
        steps, ages, limits, masked = self._steps, self._ages, self._limits, self._masked
        views, rewards, vectors = self._views, self._rewards, self._vectors
        vector, low, high, over = np.ndarray, -MAX_REWARD, MAX_REWARD, False
        for row, action in zip(rows, self._read(actions), strict=True):
            try:
                answer = steps[row](action)
            except BaseException as error:
                raise self._raised(row, error) from error
            try:
                observation, reward, end, cut, info = answer
            except (TypeError, ValueError):
                old = " (the old gym API)" if type(answer) is tuple and len(answer) == 4 else ""
                must = "observation, reward, terminated, truncated, info"
                raise self._wrong(row, answer, f"step{old}", must) from None
            if (end is not False and end is not _FALSE) or (cut is not False and cut is not _FALSE):
                terminated[row], truncated[row] = self._flags(row, end, cut)
                over = True
            if type(reward) is not float or not low <= reward <= high:
                reward = self._reward(row, reward)
            rewards[row] = reward
            if vectors and type(observation) is vector:
                try:
                    views[row][:] = observation
                except ValueError:
                    vectors = self._vectors = False
                    self._observe(row, observation)
            else:
                self._observe(row, observation)
            ages[row] = age = ages[row] + 1
            if age >= limits[row]:
                truncated[row] = over = True
            if masked:
                self._read_mask(row, info)
            elif type(info) is not dict or "action_mask" in info:
                self._check_info(row, info)
        return over

    def close(self) -> None:
        """Close every copy; what one raises is said, but spoils nothing."""
        for env in self.envs:
            try:
                env.close()
            except Exception as error:
                name = f"{type(error).__name__}: {first_line(error)}"
                logger.warning("environment %r raised %s when it was closed", self.id, name)

    def _observe(self, row: int, observation: Any) -> None:
        try:
            self._write(observation, self._rows[row])
        except ValueError as error:
            raise self._error(row, f"returned {error}") from None

    # What is wrong

    def _error(self, row: int, what: str) -> EnvError:
        return EnvError.placed(self.id, what, *self._places[row])

    def _raised(self, row: int, error: BaseException) -> EnvError:
        """What an environment has raised, as one line; Ctrl-C goes on as it is."""
        if isinstance(error, KeyboardInterrupt):
            # Where Ctrl-C has another handler, a plain KeyboardInterrupt is the environment's own.
            default = signal.getsignal(signal.SIGINT) is signal.default_int_handler
            if default or type(error) is not KeyboardInterrupt:
                raise error
        placed = self._error(row, f"raised {type(error).__name__}")
        try:
            message = " ".join(str(error).split())[:MESSAGE]
        except Exception:  # a message that cannot be made
            return placed
        return EnvError(f"{placed}: {message}") if message else placed

    def _wrong(self, row: int, answer: Any, method: str, must: str) -> EnvError:
        """The error of a method that has returned something else than it must."""
        found = f"one {type(answer).__name__}"
        if type(answer) is tuple:
            kinds = ", ".join(type(value).__name__ for value in answer)
            found = f"{len(answer)} values ({kinds})"
        return self._error(row, f"returned {found} from {method}; it must return {must}")

    def _reward(self, row: int, reward: Any) -> float:
        """A reward that is not a Python float, as one."""
        scalar = type(reward) in FLOATS or isinstance(reward, Real | np.bool_)
        array = type(reward) is np.ndarray and reward.shape == () and reward.dtype.kind in "biuf"
        if not (scalar or array):
            raise self._error(row, f"returned the reward {shown(reward)}, which is not a number,")
        try:
            number = float(reward)
        except OverflowError:
            number = inf
        if not -MAX_REWARD <= number <= MAX_REWARD:
            allowed = f", which is not within ±{MAX_REWARD:g}," if isfinite(number) else ""
            raise self._error(row, f"returned the reward {number}{allowed}")
        return number

    def _flags(self, row: int, terminated: Any, truncated: Any) -> tuple[bool, bool]:
        """Flags as Python bools."""
        for name, flag in (("terminated", terminated), ("truncated", truncated)):
            if not isinstance(flag, bool | np.bool_):
                raise self._error(row, f"returned {name} = {shown(flag)}, which is not a bool,")
        return bool(terminated), bool(truncated)

    def _check_info(self, row: int, info: Any) -> None:
        if not isinstance(info, dict):
            raise self._error(row, f"returned info of type {type(info).__name__}, not dict,")
        if "action_mask" in info and isinstance(self.envs[row].action_space, gym.spaces.Discrete):
            raise self._error(
                row, "returned an action mask, but had none at its first reset and first step,"
            )

    def _read_mask(self, row: int, info: Any) -> None:
        """Read a copy's mask from ``info["action_mask"]``."""
        mask = info.get("action_mask") if isinstance(info, dict) else None
        array = np.asarray(mask)
        wrong = array.shape != (self._masked,) or array.dtype.kind not in "biuf"
        if wrong or (array.dtype.kind == "f" and not np.isin(array, (0, 1)).all()):
            raise self._error(
                row,
                "must return info['action_mask'] with one value for each of "
                f"{self._masked} actions, but returned {shown(mask)}",
            )
        self.outputs.mask[row] = array


def _without_wrappers(env: gym.Env) -> tuple[Callable[[Any], Any], int]:
    """The step function without time limit and order check, and the limit; ``step`` does both."""
    limit = np.iinfo(np.int64).max
    inner = env
    if type(inner) is TimeLimit:
        limit, inner = inner._max_episode_steps, inner.env
    if type(inner) is OrderEnforcing:
        inner = inner.env
    return inner.step, int(limit)
