"""Random numbers in worker processes.

Strategies draw from torch's generator of their process, so ``torch.manual_seed`` and the
``set_seed`` of TorchRL's collectors decide what they draw. A new process needs a seed of its own: a
forked one inherits the state of its parent's generator, so that all workers would draw the same
numbers, and the seed of a spawned one comes from the operating system, so that no run could be
repeated. As torch's ``DataLoader`` does for its workers, the parent draws one seed per process
from its generator, and the new process seeds torch with it before it runs:

- every process forked while a strategy exists, by a hook on ``os.fork``;
- every spawned process that gets a strategy as an argument, where the strategy is unpickled.

A later ``torch.manual_seed`` in the worker, which is what ``set_seed`` of a collector with
workers does, replaces the seed.
"""

from __future__ import annotations

import os
from collections.abc import Hashable
from multiprocessing.context import get_spawning_popen
from typing import Any
from weakref import WeakSet

import torch

SEED = "_worker_seed"
"""The entry of a pickled strategy with the seed of the new process."""


_strategies: WeakSet[Hashable] = WeakSet()
"""The strategies of this process; without one, a fork draws and seeds nothing."""


def watch(strategy: Hashable) -> None:
    """Seed the processes that are forked while this strategy exists."""
    _strategies.add(strategy)


def _draw() -> int:
    return int(torch.randint(2**63 - 1, ()))


def pack(state: dict[str, Any]) -> dict[str, Any]:
    """Add a seed to the pickled state if it is an argument of a process being spawned."""
    return state if get_spawning_popen() is None else {**state, SEED: _draw()}


def unpack(state: dict[str, Any]) -> dict[str, Any]:
    """Seed torch if the pickled state brings a seed, and remove the seed."""
    seed = state.pop(SEED, None)
    if seed is not None:
        torch.manual_seed(seed)
    return state


class _Fork:
    """The seed of the next forked process."""

    seed: int | None = None

    @classmethod
    def before(cls) -> None:
        cls.seed = _draw() if _strategies else None

    @classmethod
    def in_child(cls) -> None:
        if cls.seed is not None:
            torch.manual_seed(cls.seed)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_Fork.before, after_in_child=_Fork.in_child)
