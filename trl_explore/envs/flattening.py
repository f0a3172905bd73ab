"""Observations as vectors, and indices or vectors as actions, checked value by value."""

from __future__ import annotations

from collections.abc import Callable
from math import prod
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.spaces.utils import flatdim, flatten_space
from numpy.typing import NDArray

Write = Callable[[Any, NDArray[np.float32]], None]
"""Writes an observation into a vector; raises ``ValueError`` if it does not belong to its space."""

MAX_FEATURES = 10**7
"""The largest length of an observation."""
MAX_JOINT_ACTIONS = 1000
"""The largest number of combinations of a MultiDiscrete or MultiBinary action."""


class UnsupportedSpaceError(ValueError):
    """A space that has no vectors, or no single action; the message says which are supported."""


def flat_observations(space: spaces.Space[Any]) -> spaces.Box:
    """The space of the vectors: that of ``gymnasium.spaces.utils.flatten``, as float32.

    A Discrete space is one-hot encoded; the parts of a Dict or a Tuple follow each other.

    Raises:
        UnsupportedSpaceError: if observations differ in length, or are no numbers.

    Example:
        >>> flat_observations(spaces.Tuple((spaces.Discrete(3), spaces.MultiBinary(2)))).shape
        (5,)
    """
    writer(space)
    if not 1 <= flatdim(space) <= MAX_FEATURES:
        raise UnsupportedSpaceError(
            f"observation space {space} with {flatdim(space)} numbers, "
            f"but must have 1 to {MAX_FEATURES}"
        )
    flat = flatten_space(space)
    assert isinstance(flat, spaces.Box)
    with np.errstate(over="ignore"):
        return spaces.Box(flat.low.astype(np.float32), flat.high.astype(np.float32))


def writer(space: spaces.Space[Any]) -> Write:
    """The function that writes an observation of a space into its row.

    Raises:
        UnsupportedSpaceError: if observations differ in length, or are no numbers.

    Example:
        >>> row = np.zeros(4, np.float32)
        >>> writer(spaces.Dict(a=spaces.Box(0, 9, (2,)), b=spaces.Discrete(2, start=5)))(
        ...     {"a": np.array([3, 4]), "b": 6}, row
        ... )
        >>> row
        array([3., 4., 0., 1.], dtype=float32)
    """
    return _writer(space, "observation")


def _writer(space: spaces.Space[Any], name: str) -> Write:
    if isinstance(space, spaces.Discrete):
        return _one_hot(int(space.start), int(space.n), name)
    if isinstance(space, spaces.MultiDiscrete):
        return _multi_discrete(space, name)
    if isinstance(space, spaces.Box):
        return _array(space.shape, name)
    if isinstance(space, spaces.MultiBinary):
        return _multi_binary(space, name)
    if isinstance(space, spaces.Dict):
        return _parts(dict, list(space.spaces), list(space.spaces.values()), name)
    if isinstance(space, spaces.Tuple):
        return _parts(tuple, list(range(len(space.spaces))), list(space.spaces), name)
    raise UnsupportedSpaceError(
        f"{name} space {space}, but must have Box, Discrete, MultiDiscrete, MultiBinary, "
        "or a Dict or Tuple of them; a wrapper can leave a part out (env.wrappers, "
        "gymnasium.wrappers.FilterObservation)"
    )


def _array(shape: tuple[int, ...], name: str) -> Write:
    float32 = np.dtype(np.float32)
    vector = len(shape) == 1

    def write(value: Any, row: NDArray[np.float32]) -> None:
        if type(value) is not np.ndarray or value.dtype is not float32:
            value = _numbers(value, name)
        if value.shape != shape:
            raise ValueError(f"{name} of shape {value.shape}, but its space has {shape}")
        row[...] = value if vector else value.reshape(-1)  # faster than row[:]

    return write


def _numbers(value: Any, name: str) -> NDArray[Any]:
    """An array of real numbers, as float32."""
    try:
        array = np.asarray(value)
    except Exception:  # an object of the environment can raise anything
        array = np.asarray(None)
    if array.dtype.kind not in "biuf" or isinstance(value, np.ma.MaskedArray):
        raise ValueError(f"{name} = {shown(value)}, which is not an array of numbers")
    if array.dtype.kind == "f" and array.dtype.itemsize > 4:
        with np.errstate(over="ignore"):  # what is too large is found as not finite
            return array.astype(np.float32)
    return array


def _index(value: Any, start: int, n: int, name: str) -> int:
    """A position in a Discrete space, from 0."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if type(value) is np.ndarray and value.shape == () and value.dtype.kind in "iu":
        whole = True
    if not whole or not start <= value < start + n:
        raise ValueError(
            f"{name} = {shown(value)}, but its space has the integers {start} to {start + n - 1}"
        )
    return int(value) - start


def _one_hot(start: int, n: int, name: str) -> Write:
    def write(value: Any, row: NDArray[np.float32]) -> None:
        index = _index(value, start, n, name)
        row[:] = 0
        row[index] = 1

    return write


def _multi_binary(space: spaces.MultiBinary, name: str) -> Write:
    write_array = _array(space.shape or (), name)

    def write(value: Any, row: NDArray[np.float32]) -> None:
        write_array(value, row)
        if ((row != 0) & (row != 1)).any():
            raise ValueError(f"{name} = {shown(value)}, but its space has 0 and 1")

    return write


def _multi_discrete(space: spaces.MultiDiscrete, name: str) -> Write:
    sizes, starts = space.nvec.reshape(-1), space.start.reshape(-1)
    offsets = np.concatenate([[0], np.cumsum(sizes)[:-1]])

    def write(value: Any, row: NDArray[np.float32]) -> None:
        array = _numbers(value, name)
        if array.shape != space.shape or array.dtype.kind not in "iu":
            raise ValueError(f"{name} = {shown(value)}, but its space is {space}")
        index = array.reshape(-1) - starts
        if (index < 0).any() or (index >= sizes).any():
            raise ValueError(f"{name} = {shown(value)}, but its space is {space}")
        row[:] = 0
        row[offsets + index] = 1

    return write


def _parts(
    kind: type[dict | tuple], keys: list[Any], subspaces: list[spaces.Space[Any]], name: str
) -> Write:
    writes = [
        _writer(space, f"{name}[{key!r}]") for key, space in zip(keys, subspaces, strict=True)
    ]
    ends = np.cumsum([flatdim(space) for space in subspaces]).tolist()
    parts = [
        (key, write, slice(start, end))
        for key, write, start, end in zip(keys, writes, [0, *ends[:-1]], ends, strict=True)
    ]
    known = set(keys)

    def write(value: Any, row: NDArray[np.float32]) -> None:
        if not isinstance(value, kind):
            raise ValueError(f"{name} of type {type(value).__name__}, not {kind.__name__}")
        given = set(value) if isinstance(value, dict) else set(range(len(value)))
        if given != known:
            raise ValueError(
                f"{name} with the parts {shown(sorted(map(str, given)))}, "
                f"but its space has {shown(sorted(map(str, known)))}"
            )
        for key, write_part, where in parts:
            write_part(value[key], row[where])

    return write


def shown(value: Any) -> str:
    """A value in a message: one line of at most 80 characters."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # an object of the environment can raise anything
        text = f"a {type(value).__name__}"
    return text if len(text) <= 80 else f"{text[:77]}..."


class Actions:
    """The actions of an environment, from the numbers of a policy.

    A Discrete action is a Python int, from the space's start. A MultiDiscrete or MultiBinary action
    is one of all combinations of its components, which are numbered. A Box action is an array of
    its own, clipped to the bounds.

    Args:
        space: the action space of the environment.

    Attributes:
        space: the space of the policy: Discrete from 0, or a Box with one dimension.

    Raises:
        UnsupportedSpaceError: if the space is none of these.

    Example:
        >>> Actions(spaces.Discrete(3, start=5)).read(np.array([0, 2]))
        [5, 7]
        >>> Actions(spaces.MultiDiscrete([2, 3])).read(np.array([0, 5]))
        [array([0, 0]), array([1, 2])]
    """

    def __init__(self, space: spaces.Space[Any]) -> None:
        self.space: spaces.Discrete | spaces.Box
        if isinstance(space, spaces.Discrete):
            start = int(space.start)
            self.space = spaces.Discrete(int(space.n))
            self._read = (lambda a: a.tolist()) if start == 0 else (lambda a: (a + start).tolist())
        elif isinstance(space, spaces.MultiDiscrete | spaces.MultiBinary):
            table = _combinations(space)
            self.space = spaces.Discrete(len(table))
            self._read = lambda a: [table[k].copy() for k in a.tolist()]
        elif isinstance(space, spaces.Box) and np.issubdtype(space.dtype, np.floating):
            low, high = space.low.reshape(-1), space.high.reshape(-1)
            self.space = spaces.Box(low, high, dtype=space.dtype)  # pyright: ignore
            shape, dtype = space.shape, space.dtype
            own: Any = np.ndarray.copy if shape else np.array

            def read(actions: NDArray[Any]) -> list[Any]:
                clipped = np.minimum(np.maximum(actions, low), high).astype(dtype, copy=False)
                return [own(action) for action in clipped.reshape(-1, *shape)]

            self._read = read
        else:
            raise UnsupportedSpaceError(
                f"action space {space}, but must have Discrete, MultiDiscrete, MultiBinary or a "
                "Box of floats; a wrapper can convert it (gymnasium.ActionWrapper, env.wrappers)"
            )

    def read(self, actions: NDArray[Any]) -> list[Any]:
        """The actions of m environments, from an array [m] or [m, n_dims]."""
        return self._read(actions)


def _combinations(space: spaces.MultiDiscrete | spaces.MultiBinary) -> NDArray[Any]:
    """All actions of a space, numbered as ``numpy.unravel_index`` does."""
    assert space.shape is not None
    multi = isinstance(space, spaces.MultiDiscrete)
    sizes = space.nvec.reshape(-1) if multi else np.full(prod(space.shape), 2)
    start = space.start if multi else 0
    n = prod(int(size) for size in sizes)
    if n > MAX_JOINT_ACTIONS:
        raise UnsupportedSpaceError(
            f"action space {space} with {n} combinations, but at most {MAX_JOINT_ACTIONS} are "
            "supported; a wrapper can offer fewer (gymnasium.ActionWrapper, env.wrappers)"
        )
    table = np.stack(np.unravel_index(np.arange(n), tuple(sizes)), axis=1)
    return (table.reshape(n, *space.shape) + start).astype(space.dtype)
