"""Copies of an environment in this process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

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
