"""The memory for compiled episodes, reused from call to call."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict

ROOT = ("trial", "observation", "action", "action_log_prob", "action_mask")
NEXT = ("reward", "done", "terminated", "truncated", "step_count", "episode_reward")


class Columns:
    """Flat arrays of frames that grow as needed.

    Attributes:
        arrays: the columns in the order of ``ROOT`` without the mask, ``NEXT``, and the mask;
            observation and mask are flattened row by row.
        capacity: the number of frames that fit.
    """

    def __init__(self, n_features: int, n_masks: int = 0) -> None:
        self.capacity = 0
        self._kinds = (
            ("trial", 1, np.int64),
            ("observation", n_features, np.float32),
            ("action", 1, np.int64),
            ("action_log_prob", 1, np.float32),
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
        grown = tuple(np.empty(frames * size, dtype) for _, size, dtype in self._kinds)
        for new, old, (_, size, _) in zip(grown, self.arrays, self._kinds, strict=False):
            new[: keep * size] = old[: keep * size]
        self.arrays, self.capacity = grown, frames
        columns = {
            name: torch.from_numpy(array).view(frames, size)
            for array, (name, size, _) in zip(grown, self._kinds, strict=True)
            if size
        }
        flat = ("trial", "action", "action_log_prob")
        self._root = {
            name: columns[name].view(-1) if name in flat else columns[name]
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
