"""The data of compiled episodes, filled by several threads at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict

ROOT = ("trial", "observation", "action", "action_log_prob", "action_mask")
NEXT = ("reward", "done", "terminated", "truncated", "step_count", "episode_reward")


class Columns:
    """Flat arrays for frames, kept from call to call.

    They are filled from the middle on, in both directions at once: two threads then need not know
    how many frames the other one has.

    Attributes:
        arrays: the columns, in the order of ``ROOT`` without the mask, ``NEXT``, and the mask; of
            observation and mask, the rows one after the other.
        middle: the frame from which on they are filled.
    """

    def __init__(self, n_features: int, n_masks: int = 0) -> None:
        self.middle = self.capacity = 0
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

    def has(self, below: int, above: int) -> bool:
        """Whether there is room for so many frames below and above the middle."""
        return below <= self.middle and above <= self.capacity - self.middle

    def reserve(self, below: int, above: int, low: int = 0, high: int = 0) -> int:
        """Make room for so many frames below and above the middle.

        The frames from ``low`` to ``high`` are kept; returns by how much they, and the middle,
        have moved.
        """
        if self.has(below, above):
            return 0
        below, above = max(below, self.middle), max(above, self.capacity - self.middle)
        moved, self.middle, self.capacity = below - self.middle, below, below + above
        grown = tuple(np.empty(self.capacity * size, dtype) for _, size, dtype in self._kinds)
        for new, old, (_, size, _) in zip(grown, self.arrays, self._kinds, strict=False):
            new[(low + moved) * size : (high + moved) * size] = old[low * size : high * size]
        self.arrays = grown
        columns = {
            name: torch.from_numpy(array).view(self.capacity, size)
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
        return moved

    def take(self, part: Part, place: int, *, before: bool = False) -> int:
        """Copy a part's frames behind ``place``, or before it; returns their other end."""
        first, last = part.bounds
        n = last - first
        start = place - n if before else place
        for own, others, (_, size, _) in zip(
            self.arrays, part.columns.arrays, self._kinds, strict=True
        ):
            own[start * size : (start + n) * size] = others[first * size : last * size]
        return start if before else start + n

    def frames(self, low: int, high: int) -> TensorDict:
        """The frames from ``low`` to ``high`` as a TensorDict over the same memory."""
        batch = torch.Size([high - low])
        source: dict[str, Any] = {name: c[low:high] for name, c in self._root.items()}
        after = {name: c[low:high] for name, c in self._next.items()}
        source["next"] = TensorDict._new_unsafe(after, batch)
        return TensorDict._new_unsafe(source, batch)


class Part:
    """Episodes that one thread runs, and the columns that it writes their frames to.

    Attributes:
        trials: rows of the trials whose episodes are still to be run.
        episodes: the numbers of the episodes.
        place: the end of the frames so far; backwards, their beginning.
    """

    def __init__(
        self,
        columns: Columns,
        scratch: Any,
        trials: NDArray[np.int64],
        episodes: NDArray[np.int64],
        *,
        backwards: bool = False,
    ) -> None:
        self.columns, self.scratch, self.backwards = columns, scratch, backwards
        self.trials, self.episodes = trials, episodes
        self.place = columns.middle

    def run(
        self, loop: Callable[..., tuple[int, int]], parameters: Any, context: Any, bell: int = 0
    ) -> None:
        """Run episodes until all are done, or the columns are full."""
        done, self.place = loop(
            parameters, self.trials, self.episodes, *context, self.scratch, self.columns.arrays,
            self.place, self.backwards, bell,
        )  # fmt: skip
        left = slice(0, len(self.trials) - done) if self.backwards else slice(done, None)
        self.trials, self.episodes = self.trials[left], self.episodes[left]

    def need(self, frames: int) -> int:
        """Room for so many frames of every episode; 0: twice as much as now, if any is left."""
        if frames or not len(self.trials):
            return frames * len(self.trials)
        columns = self.columns
        return 2 * (columns.middle if self.backwards else columns.capacity - columns.middle)

    @property
    def bounds(self) -> tuple[int, int]:
        """The first frame, and the end of the last one."""
        middle = self.columns.middle
        return (self.place, middle) if self.backwards else (middle, self.place)


def grow(parts: Sequence[Part], frames: int = 0) -> None:
    """Make room for ``frames`` frames of every episode; 0: twice as much where that is too little.

    Parts that share columns must be given together: the columns' frames may move.
    """
    for columns in {id(part.columns): part.columns for part in parts}.values():
        mine = [part for part in parts if part.columns is columns]
        below = sum(part.need(frames) for part in mine if part.backwards)
        above = sum(part.need(frames) for part in mine if not part.backwards)
        if columns.has(below, above):
            continue
        low = min(part.bounds[0] for part in mine)
        high = max(part.bounds[1] for part in mine)
        moved = columns.reserve(below, above, low, high)
        for part in mine:
            part.place += moved


def joined(parts: Sequence[Part]) -> TensorDict:
    """The frames of all parts, one after the other, in the columns that the middle ones share."""
    if len(parts) == 1:
        return parts[0].columns.frames(*parts[0].bounds)
    middle = len(parts) // 2
    columns, high = parts[middle].columns, parts[middle].bounds[1]
    low = parts[middle - 1].bounds[0]
    before, behind = parts[: middle - 1], parts[middle + 1 :]
    if before or behind:
        sizes = [sum(b - a for a, b in (p.bounds for p in ps)) for ps in (before, behind)]
        moved = columns.reserve(
            columns.middle - low + sizes[0], high - columns.middle + sizes[1], low, high
        )
        low, high = low + moved, high + moved
        for part in reversed(before):
            low = columns.take(part, low, before=True)
        for part in behind:
            high = columns.take(part, high)
    return columns.frames(low, high)
