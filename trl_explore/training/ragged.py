"""Arrays of different lengths in flat columns, as a checkpoint keeps them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

KINDS = {"i": (np.int32, np.int64), "f": (np.float32, np.float64)}
"""Kind of a column -> the type that is stored if it is exact, and the type in memory."""


def flatten(
    entries: Sequence[tuple[NDArray[Any], ...]], names: Sequence[str]
) -> dict[str, NDArray[Any]]:
    """One column for each name, from entries of one array for each name.

    Args:
        entries: the first array of each is [rows], the others are [rows] or [rows, width].
        names: of the arrays of an entry.

    Returns:
        "rows" and "width" [entries], and the columns, each in the smaller type if that is exact.
    """
    parts = list(zip(*entries, strict=True)) or [()] * len(names)
    flat = {
        name: np.concatenate([array.reshape(-1) for array in part]) if part else np.zeros(0)
        for name, part in zip(names, parts, strict=True)
    }
    return {
        "rows": np.array([len(entry[0]) for entry in entries], dtype=np.int64),
        "width": np.array([entry[-1].size // len(entry[0]) for entry in entries], dtype=np.int64),
        **{name: _small(column) for name, column in flat.items()},
    }


def unflatten(
    columns: Mapping[str, NDArray[Any]], names: Sequence[str]
) -> Iterator[tuple[NDArray[Any], ...]]:
    """The entries of ``flatten``; arrays of width 1 are [rows]."""
    first, *others = (columns[name].astype(KINDS[columns[name].dtype.kind][1]) for name in names)
    low = start = 0
    for rows, width in zip(columns["rows"].tolist(), columns["width"].tolist(), strict=True):
        high, stop = low + rows, start + rows * width
        shape = (rows,) if width == 1 else (rows, width)
        yield first[low:high], *(column[start:stop].reshape(shape) for column in others)
        low, start = high, stop


def _small(values: NDArray[Any]) -> NDArray[Any]:
    """The values in the smaller type if that is exact, else unchanged."""
    with np.errstate(over="ignore", invalid="ignore"):
        small = values.astype(KINDS[values.dtype.kind][0])
    return small if np.array_equal(small, values, equal_nan=True) else values
