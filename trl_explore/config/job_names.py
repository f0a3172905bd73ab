"""Names of sweeps and jobs, built from resolved values."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, cast
from urllib.parse import quote

from omegaconf import DictConfig, OmegaConf

from trl_explore.config.files import (
    GROUPS,
    INERT,
    ConfigError,
    commented,
    defaults_of,
    load,
    same,
    schedules_of,
    search_in,
    strategies_of,
)

ABSENT = object()
"""The default of a key that ``conf/`` does not have."""


def register_resolvers() -> None:
    """Register ``${sweep_folder:}``, ``${job_name:}`` and ``${commented_config:}``."""
    OmegaConf.register_new_resolver("sweep_folder", _sweep_folder, replace=True)
    OmegaConf.register_new_resolver("job_name", _job_name, replace=True)
    OmegaConf.register_new_resolver("commented_config", _commented_config, replace=True)


def _choices(root: DictConfig) -> Mapping[str, str | None]:
    """The choices of a job; a worker learns here where the files of the configuration are."""
    search_in(Path(s.path) for s in root.hydra.runtime.config_sources if s.schema == "file")
    return root.hydra.runtime.choices


def _sweep_folder(*, _root_: DictConfig) -> str:
    given = _root_.output_dir
    output = str(given).strip() if isinstance(given, str | int | float) else ""
    if not output:
        got = given if OmegaConf.is_config(given) else "an empty value"
        raise ConfigError(f"output_dir must be the name of a folder, got {got}")
    try:
        expanded = Path(output).expanduser() if output.startswith("~") else Path(output)
    except RuntimeError:
        raise ConfigError(f"output_dir={output}: the user of this ~ has no home folder") from None
    here = OmegaConf.select(_root_, "hydra.runtime.cwd", throw_on_missing=False) or ""
    # Absolute, because a node of Ray works in another folder than the command.
    return str(Path(here, expanded, _choices(_root_).get("experiment") or "train"))


def _job_name(*, _root_: DictConfig) -> str:
    return job_name(_root_, _choices(_root_))


def _commented_config(*, _root_: DictConfig) -> str:
    """The configuration for ``--help``, whose template marks its own names with a dollar."""
    own = OmegaConf.masked_copy(_root_, [str(key) for key in _root_ if key != "hydra"])
    return commented(OmegaConf.to_yaml(own), _choices(_root_)).replace("$", "$$")


def job_name(config: DictConfig, choices: Mapping[str, str | None]) -> str:
    """The name of a job: strategy, parameters, and all other values that differ from ``conf/``.

    Example: ``epsilon_greedy,epsilon=0.1,seed=3``. The values are resolved, so that
    ``temperature=1`` and ``temperature=1.0`` are one job, and different configurations never share
    a folder.
    """
    parts = [str(choices.get("strategy"))]
    parts += [
        f"{group}={choices.get(group)}"
        for group in GROUPS
        if group != "strategy" and choices.get(group) != _default_choices()[group]
    ]
    chosen = {**strategies_of(choices), **schedules_of(choices)}
    parts += [f"{key.removeprefix('strategy.')}={option}" for key, option in chosen.items()]
    leaves = dict(_leaves(config, choices))
    for key in sorted(leaves, key=lambda key: (not key.startswith("strategy."), key)):
        value, default = leaves[key]
        shown_always = key.startswith(("strategy.", "correction.strategy.")) and "._" not in key
        usual = default is not ABSENT and same(value, default)
        if key in INERT or (usual and not shown_always):
            continue
        parts.append(f"{key.removeprefix('strategy.')}={_in_kind_of(default, value)}")
    name = quote(",".join(parts), safe="=,.+-_[] ").replace(" ", "")
    if len(name) <= 200:
        return name
    return f"{name[:180]}-{hashlib.sha256(name.encode()).hexdigest()[:12]}"


def _in_kind_of(default: Any, value: Any) -> Any:
    """A whole number as the default writes it, so that 100 and 100.0 have one name."""
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(default, float) and isinstance(value, float) and value.is_integer():
        return int(value)
    return value


@cache
def _default_choices() -> dict[str, str]:
    named = (entry for entry in load("train").defaults if isinstance(entry, DictConfig))
    return {str(group): option for entry in named for group, option in entry.items()}


def _leaves(
    config: DictConfig, choices: Mapping[str, str | None]
) -> Iterator[tuple[str, tuple[Any, Any]]]:
    """Every key of the configuration that holds a value, with the value and its default."""
    values = {
        str(name): OmegaConf.to_container(node, resolve=True) if OmegaConf.is_config(node) else node
        for name in config
        if name != "hydra" and not OmegaConf.is_missing(config, str(name))
        for node in [config[name]]
    }
    defaults = _unresolved(tuple(sorted(choices.items())))

    def walk(node: Any, default: Any, key: str) -> Iterator[tuple[str, tuple[Any, Any]]]:
        if isinstance(node, dict):
            inner = default if isinstance(default, dict) else {}
            for name, child in node.items():
                yield from walk(child, inner.get(name, "???"), f"{key}.{name}" if key else name)
        else:
            value = None if node == "???" else node
            yield key, (value, _default(config, values, default, key))

    return walk(values, defaults, "")


@lru_cache(maxsize=64)
def _unresolved(items: tuple[tuple[str, str | None], ...]) -> dict[str, Any]:
    return cast(dict[str, Any], OmegaConf.to_container(defaults_of(dict(items))))


def _default(config: DictConfig, values: Any, default: Any, key: str) -> Any:
    """The default of a key in ``conf/``; if it refers to another key, the value of that key."""
    if default == "???":
        return ABSENT
    pointer = re.fullmatch(r"\$\{([\w.]+)\}", default) if isinstance(default, str) else None
    if pointer:
        found = values
        for name in pointer[1].split("."):
            found = found.get(name) if isinstance(found, dict) else None
        return found
    if "${" not in str(default):
        return default
    parent, _, name = key.rpartition(".")
    given = OmegaConf.select(config, parent) if parent else config
    text = OmegaConf.to_container(OmegaConf.masked_copy(given, name))
    return given[name] if text == {name: default} else ABSENT
