"""A configuration from the words of a command, and the name of its job."""

from __future__ import annotations

from typing import Any

from hydra import compose
from omegaconf import DictConfig, open_dict

from trl_explore.config import (
    job_name,
)


def composed(*overrides: str) -> tuple[DictConfig, dict[str, Any]]:
    """The configuration of a job as ``scripts/train.py`` gets it, and the choices of its groups."""
    config = compose("train", overrides=list(overrides), return_hydra_config=True)
    choices = dict(config.hydra.runtime.choices)
    with open_dict(config):
        config.pop("hydra")
    return config, choices


def name(*overrides: str) -> str:
    config, choices = composed(*overrides)
    return job_name(config, choices)
