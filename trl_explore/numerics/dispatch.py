"""Choice of the implementation: compiled code if it applies, torch otherwise.

This is the only way from the operations in ``numerics`` to the modules in ``numerics.compiled``.
Those are imported on first use, so that importing an operation needs neither numba nor a cache.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

import torch
from torch import Tensor
from torch._C._functorch import is_functorch_wrapped_tensor  # pyright: ignore


@cache
def has_numba() -> bool:
    """Whether numba can be imported. Without it, every operation runs in torch."""
    try:
        import_module("numba")
    except ImportError:
        return False
    return True


@cache
def compiled(name: str) -> Any:
    """The module ``name`` of ``numerics.compiled``, imported on first use.

    Raises:
        ImportError: if numba is missing; call ``supports`` first.
    """
    return import_module(f"trl_explore.numerics.compiled.{name}")


def supports(first: Tensor, *others: Tensor) -> bool:
    """Whether compiled code supports these tensors: on the CPU, all float32 or all float64."""
    dtype = first.dtype
    if not first.is_cpu or (dtype is not torch.float32 and dtype is not torch.float64):
        return False
    same = all([other.is_cpu and other.dtype is dtype for other in others])  # noqa: C419 - faster
    return same and has_numba() and not transformed(first, *others)


def transformed(*tensors: Tensor) -> bool:
    """Whether torch traces or transforms a tensor (compile, vmap, grad), so it has no array."""
    if torch.compiler.is_compiling():
        return True
    return any([is_functorch_wrapped_tensor(tensor) for tensor in tensors])  # noqa: C419 - faster


def check_frames(frames: torch.Size, **columns: Tensor) -> None:
    """Compiled code does not check bounds, so shapes are validated here.

    Raises:
        ValueError: naming the column whose shape is not ``frames``.
    """
    for name, column in columns.items():
        if column.shape != frames:
            raise ValueError(
                f"{name} has shape {list(column.shape)}, but the frames have {list(frames)}"
            )
