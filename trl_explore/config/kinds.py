"""Check that the strategy and the policy support the environment's kind of actions."""

from __future__ import annotations

from typing import Any

from hydra.utils import get_object
from omegaconf import DictConfig, OmegaConf

from trl_explore.config.files import ConfigError, files_of

SERVING = ("strategy", "policy")
"""The groups whose options support one kind of action, the attribute ``actions`` of the class."""


def check_actions(config: DictConfig, kind: str) -> None:
    """Reject options that do not support the environment's actions, and name those that do.

    Args:
        config: the configuration of the job.
        kind: the kind of the environment's actions, "discrete" or "continuous".

    Raises:
        ConfigError: if the strategy or the policy supports only the other kind.
    """
    wrong: list[str] = []
    served: list[str] = []
    for group in SERVING:
        constructor = _constructor(config[group])
        if getattr(constructor, "actions", kind) != kind:
            wrong.append(constructor.__name__)
            served.append(f"{group}={'|'.join(options(group, kind))}")
    if wrong:
        raise ConfigError(
            f"the environment has {kind} actions, not supported by {' and '.join(wrong)}; "
            f"supported by {', '.join(served)}"
        )


def options(group: str, kind: str) -> list[str]:
    """The options of a group that support a kind of action."""
    files = files_of(group).items()
    found = ((name, _constructor(OmegaConf.load(path))) for name, path in files)
    return [name for name, constructor in found if getattr(constructor, "actions", None) == kind]


def _constructor(node: Any) -> Any:
    """The class that a configuration names; None if it does not exist."""
    try:
        return get_object(str(node.get("_target_")))
    except Exception:  # any error of the import; building it reports the error
        return None
