"""Frames divided among threads, at the boundaries of trials."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor


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
    """Call ``kernel(*frames, *shared, 0)``; whether the data are valid."""
    return kernel(*frames, *shared, 0)


def check_frames(frames: torch.Size, **columns: Tensor) -> None:
    """Compiled code reads beside an array that is too short: refuse it before.

    Raises:
        ValueError: naming the column that has not the shape ``frames``.
    """
    for name, column in columns.items():
        if column.shape != frames:
            raise ValueError(f"{name} is {list(column.shape)}, but the frames are {list(frames)}")
