"""The configuration files, their defaults, and the error for a wrong configuration."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

_PACKAGE = Path(__file__).resolve().parents[1]
CONF = next(p for p in (_PACKAGE / "conf", _PACKAGE.parent / "conf") if p.is_dir())
"""The folder of the configuration files: inside an installed package, next to it in a checkout."""
GROUPS = (
    "env", "policy", "strategy", "loss", "correction", "baseline", "optimizer", "collector",
)  # fmt: skip
SCHEDULE = "schedule@"
"""Prefix of a choice that gives a parameter a schedule from ``conf/schedule``:
``+schedule@strategy.temperature=linear``."""
INERT = (
    "output_dir", "restart", "threads", "episodes", "collector.threads", "env.workers",
    "checkpoint_seconds", "debug",
)  # fmt: skip
"""Keys that do not change results; they are not part of a job's name or identity."""


class ConfigError(ValueError):
    """A configuration that cannot be run; the message is one line."""


def defaults_of(choices: Mapping[str, str | None]) -> DictConfig:
    """The values in ``conf/`` for these choices, before any override. Do not modify."""
    return _defaults(tuple(sorted(choices.items())))


@lru_cache(maxsize=64)
def _defaults(items: tuple[tuple[str, str | None], ...]) -> DictConfig:
    choices = dict(items)
    defaults = load("train").copy()
    for group in GROUPS:
        defaults[group] = group_defaults(group, choices.get(group))
    defaults = OmegaConf.merge(defaults, load(f"experiment/{choices.get('experiment')}"))
    assert isinstance(defaults, DictConfig)
    for key in ("defaults", "hydra"):
        defaults.pop(key, None)
    for key, option in schedules_of(choices).items():
        if (schedule := load(f"schedule/{option}")) and OmegaConf.select(defaults, key) is not None:
            OmegaConf.update(defaults, key, schedule, merge=False)
    return defaults


def group_defaults(group: str, option: str | None) -> DictConfig:
    """The values of a group: those that every option has in ``train.yaml``, then the file's own."""
    shared, own = load("train").get(group), load(f"{group}/{option}")
    merged = OmegaConf.merge(shared, own) if isinstance(shared, DictConfig) else own.copy()
    assert isinstance(merged, DictConfig)
    return merged


@cache
def load(name: str) -> DictConfig:
    """A file of ``conf/``, named without extension; empty if it does not exist. Do not modify."""
    path = CONF / f"{name}.yaml"
    content = OmegaConf.load(path) if path.is_file() else OmegaConf.create()
    assert isinstance(content, DictConfig)
    return content


def schedules_of(choices: Mapping[str, str | None]) -> dict[str, str]:
    """The parameters that have a schedule, each with its file in ``conf/schedule``."""
    return {
        key.removeprefix(SCHEDULE): str(option)
        for key, option in sorted(choices.items())
        if key.startswith(SCHEDULE)
    }


def same(value: Any, default: Any) -> bool:
    """Whether two configuration values are equal; 1 equals 1.0, but not true."""
    return value == default and isinstance(value, bool) == isinstance(default, bool)
