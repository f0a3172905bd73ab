"""Parameters and their like as arrays with one row for each trial."""

# numba rewrites signatures:
# pyright: reportCallIssue=false

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import NDArray
from torch import Tensor

from trl_explore.compiled import compiled


class Views:
    """Arrays [rows, elements] in the memory of tensors; kept, and made anew where that has moved.

    Args:
        tensors: on the CPU and contiguous; read at every call, so that others can take their place.

    Example:
        >>> import torch
        >>> weight = torch.nn.Parameter(torch.zeros(2, 1, 3))
        >>> views = Views([weight])
        >>> views()[0][1, 2] = 5
        >>> weight.detach().flatten().tolist()
        [0.0, 0.0, 0.0, 0.0, 0.0, 5.0]
    """

    def __init__(self, tensors: Sequence[Tensor]) -> None:
        self.tensors = tensors
        self._places: list[tuple[int, Any]] = []
        self._arrays: list[NDArray[Any]] = []

    def __call__(self) -> list[NDArray[Any]]:
        """The arrays, in the order of the tensors."""
        # A view keeps its memory alive, so that nothing else can lie in the same place.
        places = [(t.data_ptr(), t.shape) for t in self.tensors]
        if places != self._places:
            self._arrays = [t.detach().view(len(t), -1).numpy() for t in self.tensors]
            self._places = places
        return self._arrays


def all_finite(rows: NDArray[Any]) -> bool:
    """Whether every number is finite.

    Args:
        rows: [*], contiguous.
    """
    return _all_finite(rows.reshape(-1))


@compiled()
def _all_finite(x):
    broken = 0
    for i in range(len(x)):  # no early exit, so that it becomes vector instructions
        broken += (x[i] - x[i]) != 0
    return broken == 0
