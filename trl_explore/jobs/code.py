"""Digests of the source code that computes the results of a job."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from trl_explore.jobs.columns import PACKAGES

ROOT = Path(__file__).resolve().parents[1]
OWN = ROOT.name
COMPUTING = (
    "numerics", "statistics/evaluations.py", "strategies", "envs", "policies", "objectives",
    "collectors", "training",
)  # fmt: skip
"""The rooms and modules of this package whose code the results depend on."""


def code_digests(config: Mapping[str, Any]) -> dict[str, str]:
    """The SHA-256 of this package's computing code, and of each module that the user added.

    Files are read once per process, before the first job trains.

    A user's module is one that the configuration names, in ``_target_`` or before the colon of
    ``env.id``, and that belongs to no package whose version is recorded.
    """
    names = sorted({name for name in _modules(config) if name.partition(".")[0] not in PACKAGES})
    return {OWN: _own()} | {name: _digest(_files(name)) for name in names}


def changed_code(
    before: Mapping[str, str], now: Mapping[str, str], *, own: bool = True
) -> list[str]:
    """The modules whose code differs, in words.

    Args:
        before: the digests of an earlier run; results of older versions have none.
        now: the digests of this run.
        own: whether to compare the code of this package, too.
    """
    names = [name for name in sorted({*before, *now}) if before and (own or name != OWN)]
    return [f"code of {name} has changed" for name in names if before.get(name) != now.get(name)]


def _modules(node: Any) -> Iterator[str]:
    """The modules that a configuration names."""
    if isinstance(node, Mapping):
        for key, value in node.items():
            if key == "_target_":
                yield str(value).rpartition(".")[0]
            elif key == "id" and ":" in str(value):
                yield str(value).partition(":")[0]
            else:
                yield from _modules(value)
    elif isinstance(node, list):
        for value in node:
            yield from _modules(value)


def _files(name: str) -> tuple[Path, ...]:
    """The source files of a module, all those of its folder if it is a package; none if unknown."""
    try:
        spec = find_spec(name)
    except (ImportError, ValueError, AttributeError):
        return ()
    if spec is None or spec.origin is None:
        return ()
    path = Path(spec.origin)
    return _sources(path.parent) if path.name == "__init__.py" else (path,)


def _sources(place: Path) -> tuple[Path, ...]:
    """A module, or the modules in a folder."""
    return (place,) if place.suffix else tuple(sorted(place.rglob("*.py")))


@cache
def _own() -> str:
    return _digest(tuple(path for place in COMPUTING for path in _sources(ROOT / place)))


@cache
def _digest(files: tuple[Path, ...]) -> str:
    found = hashlib.sha256()
    for path in files:
        try:
            found.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
        except OSError:
            found.update(b"not readable")
    return found.hexdigest()[:16]
