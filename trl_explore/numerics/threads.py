"""Frames divided among threads, at the boundaries of trials."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import numba as nb
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from trl_explore.checks import MAX_THREADS, check_integer
from trl_explore.numerics.crew import together

MIN_FRAMES = 10_000
"""Below this number of frames, handing work to a thread costs more than it saves."""

_threads = 1


def set_threads(threads: int) -> None:
    """Set among how many threads compiled code divides large data; results do not depend on it.

    Not torch's threads, which would wait for their next task on the cores that these need: beside
    more than one of these, torch should have one (``torch.set_num_threads(1)``).
    """
    global _threads
    _threads = check_integer("threads", threads, 1, MAX_THREADS)


def get_threads() -> int:
    """Among how many threads compiled code divides large data."""
    return _threads


def fits(first: Tensor, *others: Tensor) -> bool:
    """Whether compiled code serves these tensors: on the CPU, all float32 or all float64."""
    dtype = first.dtype
    if not first.is_cpu or (dtype is not torch.float32 and dtype is not torch.float64):
        return False
    return all([other.is_cpu and other.dtype is dtype for other in others])  # noqa: C419 - faster


def by_trial(
    kernel: Callable[..., bool],
    frames: Sequence[NDArray[Any]],
    shared: Sequence[Any],
    *,
    ordered: bool = False,
) -> bool:
    """Call ``kernel(*frames, *shared, bell)``, on large data in several threads at once.

    Every thread has the frames of whole trials, in their order, so that no result depends on the
    number of threads (``set_threads``) as long as trials share nothing in the kernel.

    Args:
        kernel: compiled, releasing the interpreter's lock; it first rings the ``bell``, and returns
            whether the data are valid.
        frames: arrays [frames, ...]; the last one is the trial of each frame.
        shared: further arguments, the same for every thread.
        ordered: whether data are valid only where the trials ascend, and the kernel looks.

    Returns:
        Whether every call found its data valid.
    """
    trial, threads = frames[-1], _threads
    if threads == 1 or len(trial) < MIN_FRAMES or not (ordered or _ascending(trial)):
        return kernel(*frames, *shared, 0)
    cuts = [len(trial) * j // threads for j in range(1, threads)]
    edges = [0, *(int(np.searchsorted(trial, trial[cut])) for cut in cuts), len(trial)]
    parts = [(low, high) for low, high in pairwise(edges) if high > low]
    if any(trial[before - 1] >= trial[low] for (_, before), (low, _) in pairwise(parts)):
        return kernel(*frames, *shared, 0)  # no order to cut by
    calls = [partial(kernel, *(x[low:high] for x in frames), *shared) for low, high in parts]
    return all(together(calls))


@nb.njit(cache=True, nogil=True)
def _ascending(trial):
    falls = 0
    for i in range(1, len(trial)):  # no early exit, so that it becomes vector instructions
        falls += trial[i] < trial[i - 1]
    return falls == 0


def check_frames(frames: torch.Size, **columns: Tensor) -> None:
    """Compiled code reads beside an array that is too short: refuse it before.

    Raises:
        ValueError: naming the column that has not the shape ``frames``.
    """
    for name, column in columns.items():
        if column.shape != frames:
            raise ValueError(f"{name} is {list(column.shape)}, but the frames are {list(frames)}")
