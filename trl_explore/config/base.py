"""Where the configuration files lie, what they say by default, and the error of this package."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

CONF = Path(__file__).resolve().parents[2] / "conf"
GROUPS = ("env", "policy", "strategy", "loss", "optimizer", "collector")
INERT = ("output_dir", "restart", "threads", "episodes", "collector.threads", "env.workers")
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
    return defaults


def same(value: Any, default: Any) -> bool:
    """Whether two values of a configuration are equal; 1 and 1.0 are, 1 and true are not."""
    return value == default and isinstance(value, bool) == isinstance(default, bool)
