"""What strategies read from the frames of a TensorDict."""

from __future__ import annotations

import warnings
from typing import cast

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torch._C._functorch import is_batchedtensor

from trl_explore.strategies.schedules import Value


def read(tensordict: TensorDictBase, key: NestedKey) -> Tensor:
    """The entry under ``key``.

    Raises:
        KeyError: if it is missing; the message names the entries that are there.
    """
    value = tensordict.get(key, None)
    if value is None:
        there = ", ".join(map(str, tensordict.keys(include_nested=True, leaves_only=True)))
        raise KeyError(f"missing key: {key!r}; the data have {there or 'no entries'}")
    return value


PADDING = ("collector", "mask")
"""The key of the mask that TorchRL's ``split_trajs`` writes; without it, there is no padding."""


def padding_mask(data: TensorDictBase) -> Tensor:
    """Whether a frame is one of the data, not padding of TorchRL's ``split_trajs`` [*batch]."""
    mask = data.get(PADDING, None)
    if mask is None:
        return torch.ones(data.batch_size, dtype=torch.bool, device=data.device)
    return mask.reshape(data.batch_size)


def readable(tensor: Tensor) -> bool:
    """Whether a number can be read at once: on the CPU, not in compiled code, not under vmap."""
    return not torch.compiler.is_compiling() and tensor.is_cpu and not is_batchedtensor(tensor)


def rows(value: Value | Tensor, trial: Tensor | None, like: Tensor) -> float | Tensor:
    """A number as it is, or per-trial values as a column [*batch, 1] in the dtype of ``like``.

    Raises:
        ValueError: if the value is per trial and ``trial`` is None.
    """
    if getattr(value, "ndim", 0) == 0:
        return cast("float | Tensor", value)
    if trial is None:
        raise ValueError("missing key: 'trial' (a parameter has one value per trial)")
    column = torch.as_tensor(value, dtype=like.dtype, device=like.device)[trial]
    return column.reshape(column.shape + (1,) * (like.ndim - column.ndim))


class FirstFrames:
    """Finds the lanes of a batch whose frame is the first of an episode.

    A frame is the first if its "is_init" is true (TorchRL's ``InitTracker``), its "step_count" is 0
    (``StepCounter``), or its ("collector", "traj_ids"), which TorchRL's collectors write, is not
    that of the lane's frame before. Without any of these, the start of an episode is unknown;
    a warning says so once.

    Args:
        name: the name of the strategy, for the warning.
        is_init_key: the entry that marks the first frame of an episode.

    Attributes:
        begun: whether a collector calls the strategy's ``begin``; no entry is then needed.
    """

    def __init__(self, name: str, is_init_key: NestedKey) -> None:
        self.name, self.is_init_key = name, is_init_key
        self.begun = False
        self._ids = torch.zeros(0, dtype=torch.int64)

    def __call__(self, tensordict: TensorDictBase, batch: torch.Size) -> Tensor:
        """Whether a frame is the first of its episode [*batch], for each agent or head too."""
        is_init = tensordict.get(self.is_init_key, None)
        step_count = tensordict.get("step_count", None)
        ids = tensordict.get(("collector", "traj_ids"), None)
        marks: list[Tensor] = [] if is_init is None else [is_init.bool()]
        if step_count is not None:
            marks.append(step_count == 0)
        if ids is not None:
            if self._ids.shape != ids.shape or self._ids.device != ids.device:
                self._ids = torch.full_like(ids, -1)
            marks.append(ids != self._ids)
            self._ids = ids.clone()
        if not marks:
            if not self.begun and not torch.compiler.is_compiling():
                warnings.warn(
                    f"{self.name} cannot see where an episode begins: append TorchRL's InitTracker "
                    f"to the environment ({self.is_init_key!r} is missing)",
                    stacklevel=2,
                )
                self.begun = True
            return torch.zeros(batch, dtype=torch.bool, device=tensordict.device)
        found = torch.zeros(batch, dtype=torch.bool, device=marks[0].device)
        for mark in marks:
            if mark.ndim > tensordict.batch_dims and mark.shape[-1] == 1:
                mark = mark.squeeze(-1)
            if mark.ndim > len(batch):  # the agents of one lane
                mark = mark.flatten(len(batch)).any(-1)
            found = found | mark.reshape(mark.shape + (1,) * (len(batch) - mark.ndim))
        return found
