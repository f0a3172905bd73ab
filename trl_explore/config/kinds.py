"""Whether strategy and policy serve the actions that the environment takes."""

from __future__ import annotations

from typing import Any

from hydra.utils import get_object
from omegaconf import DictConfig, OmegaConf

from trl_explore.config.files import CONF, ConfigError

SERVING = ("strategy", "policy")
"""The groups whose options serve one kind of action, which their class states in ``actions``."""


def check_actions(config: DictConfig, kind: str) -> None:
    """Refuse what does not serve the environment's actions, and name what does.

    Args:
        config: the configuration of the job.
        kind: "discrete" or "continuous", what the environment's actions are.

    Raises:
        ConfigError: if strategy or policy serve the other kind.
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
            f"the environment has {kind} actions, not served by {' and '.join(wrong)}; "
            f"served by {', '.join(served)}"
        )


def options(group: str, kind: str) -> list[str]:
    """The files of ``conf/`` in a group that serve a kind of action."""
    files = sorted((CONF / group).glob("*.yaml"))
    found = ((path.stem, _constructor(OmegaConf.load(path))) for path in files)
    return [name for name, constructor in found if getattr(constructor, "actions", None) == kind]


def _constructor(node: Any) -> Any:
    """The class that a configuration names; None if it names none that exists."""
    try:
        return get_object(str(node.get("_target_")))
    except Exception:  # whatever importing it raises; building it says what is wrong
        return None
