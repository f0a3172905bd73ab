"""Where the configuration files lie, what they say by default, and the error of this package."""

from __future__ import annotations

from collections.abc import Mapping
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
    """What the files of ``conf/`` say for these choices, before any override."""
    defaults = OmegaConf.load(CONF / "train.yaml")
    assert isinstance(defaults, DictConfig)
    for group in GROUPS:
        path = CONF / group / f"{choices.get(group)}.yaml"
        defaults[group] = OmegaConf.load(path) if path.is_file() else {}
    experiment = CONF / "experiment" / f"{choices.get('experiment')}.yaml"
    if experiment.is_file():
        defaults = OmegaConf.merge(defaults, OmegaConf.load(experiment))
    assert isinstance(defaults, DictConfig)
    for key in ("defaults", "hydra"):
        defaults.pop(key, None)
    for key, option in schedules_of(choices).items():
        path = CONF / "schedule" / f"{option}.yaml"
        if path.is_file() and OmegaConf.select(defaults, key) is not None:
            OmegaConf.update(defaults, key, OmegaConf.load(path), merge=False)
    return defaults


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
