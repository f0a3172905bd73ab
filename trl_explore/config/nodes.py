"""OmegaConf's nodes, copied and read with less work; what is copied and read stays the same.

A job is copied several times on its way through Hydra, and most of the time of a copy is spent on
the notes that each node keeps about itself. An interpolation is parsed again at every access.
"""

from __future__ import annotations

from collections import defaultdict
from copy import deepcopy
from functools import cache, lru_cache
from typing import Any

from omegaconf import base
from omegaconf.base import ContainerMetadata, Metadata

PARSED = 256
"""Most interpolations whose parse tree is kept."""


@cache
def save_work() -> None:
    """Change OmegaConf in this process."""
    base.parse = lru_cache(PARSED)(base.parse)  # pyright: ignore[reportPrivateImportUsage]
    for kind in (Metadata, ContainerMetadata):
        kind.__deepcopy__ = _copied  # pyright: ignore[reportAttributeAccessIssue]


def _copied(notes: Metadata, memo: dict[int, Any]) -> Metadata:
    """A deep copy of the notes of a node: all but their two dictionaries cannot change."""
    copy = object.__new__(type(notes))
    vars(copy).update(vars(notes))
    copy.flags = None if notes.flags is None else dict(notes.flags)
    kept = notes.resolver_cache
    copy.resolver_cache = deepcopy(kept, memo) if kept else defaultdict(dict)
    return copy
