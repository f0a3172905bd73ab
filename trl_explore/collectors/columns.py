"""The memory for the frames of a compiled collector: one flat array for each column."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict

from trl_explore.numerics.surrogate import FrameArrays

ROOT = ("trial", "observation", "action", "action_log_prob", "action_mask")
NEXT = ("reward", "done", "terminated", "truncated", "step_count", "episode_reward")

ColumnTypes = tuple[tuple[str, int, Any], ...]
"""The name, the size per frame and the type of every column."""


def grown(
    types: ColumnTypes, frames: int, old: tuple[NDArray[Any], ...] = (), keep: int = 0
) -> tuple[NDArray[Any], ...]:
    """Flat arrays for ``frames`` frames, with the first ``keep`` frames of the old ones."""
    new = tuple(np.empty(frames * size, dtype) for _, size, dtype in types)
    for to, of, (_, size, _) in zip(new, old, types, strict=False):
        to[: keep * size] = of[: keep * size]
    return new


class Columns:
    """Flat arrays of frames that grow as needed.

    Attributes:
        arrays: the columns in the order of ``ROOT`` without the mask, ``NEXT``, and the mask;
            observation, action and mask are flattened row by row.
        capacity: the number of frames that fit.

    Args:
        n_features: the size of an observation.
        n_masks: the size of an action mask; 0: there is no such column.
        n_dims: the size of an action vector; 0: actions are indices.
        exact: whether there is a log-probability.
    """

    def __init__(
        self, n_features: int, *, n_masks: int = 0, n_dims: int = 0, exact: bool = True
    ) -> None:
        self.capacity = 0
        self._n_features, self._plain = n_features, not (n_masks or n_dims)
        self._flat = ["trial", "action_log_prob", *([] if n_dims else ["action"])]
        self._types = (
            ("trial", 1, np.int64),
            ("observation", n_features, np.float32),
            ("action", n_dims or 1, np.float32 if n_dims else np.int64),
            ("action_log_prob", int(exact), np.float32),
            ("reward", 1, np.float32),
            ("done", 1, np.bool_),
            ("terminated", 1, np.bool_),
            ("truncated", 1, np.bool_),
            ("step_count", 1, np.int64),
            ("episode_reward", 1, np.float32),
            ("action_mask", n_masks, np.bool_),
        )
        self.arrays: tuple[NDArray[Any], ...] = ()

    def reserve(self, frames: int, keep: int = 0) -> None:
        """Make room for ``frames`` frames, and keep the first ``keep`` of those present."""
        if frames <= self.capacity:
            return
        self.arrays = grown(self._types, frames, self.arrays, keep)
        self.capacity = frames
        columns = {
            name: torch.from_numpy(array).view(frames, size)
            for array, (name, size, _) in zip(self.arrays, self._types, strict=True)
            if size
        }
        self._root = {
            name: columns[name].view(-1) if name in self._flat else columns[name]
            for name in ROOT
            if name in columns
        }
        self._next = {name: columns[name] for name in NEXT}

    def frames(self, count: int) -> TensorDict:
        """The first ``count`` frames as a TensorDict over the same memory."""
        batch = torch.Size([count])
        source: dict[str, Any] = {name: c[:count] for name, c in self._root.items()}
        after = {name: c[:count] for name, c in self._next.items()}
        source["next"] = TensorDict._new_unsafe(after, batch)
        return TensorDict._new_unsafe(source, batch)

    def frame_arrays(self, count: int) -> FrameArrays | None:
        """What REINFORCE reads from the first ``count`` frames; None with masks or vectors."""
        if not self._plain:
            return None
        trial, observation, action, _, reward, done, *_ = self.arrays
        d = self._n_features
        return FrameArrays(
            observation[: count * d].reshape(count, d), action[:count], reward[:count],
            done[:count], trial[:count],
        )  # fmt: skip
