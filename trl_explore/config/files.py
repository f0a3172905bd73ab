"""Where the configuration files lie, what they say by default, and the error of this package."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

_PACKAGE = Path(__file__).resolve().parents[1]
CONF = next(p for p in (_PACKAGE / "conf", _PACKAGE.parent / "conf") if p.is_dir())
"""The configuration files: inside the package where it is installed, beside it in a checkout."""
GROUPS = (
    "env", "policy", "strategy", "loss", "correction", "baseline", "optimizer", "collector",
)  # fmt: skip
SCHEDULE = "schedule@"
"""How a choice begins that lets a parameter follow a file of ``conf/schedule``:
``+schedule@strategy.temperature=linear``."""
INERT = (
    "output_dir", "restart", "threads", "episodes", "collector.threads", "env.workers",
    "checkpoint_seconds",
)  # fmt: skip
"""Keys that change no result: they are not part of a job's name or identity."""


class ConfigError(ValueError):
    """A configuration that cannot be run; the message is one line."""


def defaults_of(choices: Mapping[str, str | None]) -> DictConfig:
    """What the files of ``conf/`` say for these choices, before any override; not to be changed."""
    return _defaults(tuple(sorted(choices.items())))


@lru_cache(maxsize=64)
def _defaults(items: tuple[tuple[str, str | None], ...]) -> DictConfig:
    choices = dict(items)
    defaults = load("train").copy()
    for group in GROUPS:
        defaults[group] = load(f"{group}/{choices.get(group)}")
    defaults = OmegaConf.merge(defaults, load(f"experiment/{choices.get('experiment')}"))
    assert isinstance(defaults, DictConfig)
    for key in ("defaults", "hydra"):
        defaults.pop(key, None)
    for key, option in schedules_of(choices).items():
        if (schedule := load(f"schedule/{option}")) and OmegaConf.select(defaults, key) is not None:
            OmegaConf.update(defaults, key, schedule, merge=False)
    return defaults


@cache
def load(name: str) -> DictConfig:
    """A file of ``conf/``, named without its ending; empty if there is none. Not to be changed."""
    path = CONF / f"{name}.yaml"
    content = OmegaConf.load(path) if path.is_file() else OmegaConf.create()
    assert isinstance(content, DictConfig)
    return content


def schedules_of(choices: Mapping[str, str | None]) -> dict[str, str]:
    """Which parameters follow a file of ``conf/schedule``, and which file."""
    return {
        key.removeprefix(SCHEDULE): str(option)
        for key, option in sorted(choices.items())
        if key.startswith(SCHEDULE)
    }


def same(value: Any, default: Any) -> bool:
    """Whether two values of a configuration are equal; 1 and 1.0 are, 1 and true are not."""
    return value == default and isinstance(value, bool) == isinstance(default, bool)
