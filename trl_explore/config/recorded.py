"""The configuration of a finished job, composed again from what its folder records.

A folder of results may come from someone else. So nothing in it is constructed unless ``conf/`` or
the user's own ``--config-dir`` names it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import DictConfig, OmegaConf

from trl_explore.checks import first_line
from trl_explore.config.building import build_trainer
from trl_explore.config.checking import differences, resolved
from trl_explore.config.composing import composed, searching
from trl_explore.config.files import GROUPS, ConfigError, files_of
from trl_explore.jobs.reading import find_jobs, read_run, read_trials

if TYPE_CHECKING:
    import pandas as pd

    from trl_explore.training.trainer import Trainer


@dataclass(frozen=True)
class RecordedJob:
    """A finished job, with its configuration recomposed from ``conf/``."""

    folder: Path
    experiment: str
    config: DictConfig
    trials: pd.DataFrame

    def trainer(self, trial: int) -> Trainer:
        """The trainer of one trial alone, with that trial's own parameters.

        Evaluation is off if the training does not depend on it.
        """
        config, row = self.config.copy(), trial - self.config.first_trial
        if config.stop_on in ("training", "never"):
            config.evaluate_every = 0
        return build_trainer(config, slice(row, row + 1))


def recompose_all(folders: Iterable[Path], config_dir: Path | None = None) -> list[RecordedJob]:
    """The finished jobs at or below the folders.

    Raises:
        ConfigError: if there is none, or one cannot be recomposed.
    """
    folders = list(folders)
    found = dict.fromkeys(job for folder in folders for job in find_jobs(folder))
    if not found:
        raise ConfigError(f"{', '.join(map(str, folders))}: no finished job found")
    with searching(config_dir):
        return [recompose(folder, config_dir) for folder in found]


def recompose(folder: Path, config_dir: Path | None = None) -> RecordedJob:
    """Recompose the configuration of a job from its recorded command-line overrides.

    Args:
        folder: the folder of the job.
        config_dir: the user's folder with further configuration files.

    Raises:
        ConfigError: if the overrides are not recorded, would construct an unknown object, or give
            another configuration than that of the job.
    """
    run = read_run(folder)
    recorded = folder / ".hydra" / "overrides.yaml"
    if not recorded.is_file():
        raise ConfigError(f"{recorded}: missing; the job cannot be rerun without it")
    try:
        overrides = [str(line) for line in OmegaConf.load(recorded)]
    except Exception as error:  # any error of an invalid file
        raise ConfigError(f"{recorded}: not a list of overrides ({first_line(error)})") from None
    for override in OverridesParser.create().parse_overrides(overrides):
        key = override.key_or_group
        if override.is_sweep_override() or key.startswith("hydra") or "_target_" in key:
            raise ConfigError(f"{recorded}: {override.input_line!r} is not allowed in a rerun")
    config, _ = composed(overrides)
    values = resolved(config)
    unknown = [str(target) for target in _targets(values) if not _is_known(target, config_dir)]
    if ":" in str(id := values["env"].get("id")) and config_dir is None:
        unknown.append(str(id))  # gymnasium would import the module before the colon
    if unknown:
        raise ConfigError(
            f"{folder}: unknown object {unknown[0]}; if it is yours, give --config-dir"
        )
    # Constructors may have been renamed; running each trial checks that it is the same.
    changed = [d for d in differences(run["config"], values) if "._" not in d]
    if changed:
        raise ConfigError(f"{folder}: conf/ has changed since the job ran ({'; '.join(changed)})")
    return RecordedJob(folder, run["experiment"], config, read_trials(folder))


@cache
def _known(config_dir: Path | None) -> frozenset[str]:
    """The objects that the files of ``conf/`` and of the user construct; no others are allowed."""
    return frozenset(
        str(target)
        for group in GROUPS
        for path in files_of(group).values()
        for target in _targets(OmegaConf.to_container(OmegaConf.load(path)))
    )


def _is_known(target: Any, config_dir: Path | None = None) -> bool:
    """Whether a recorded configuration may construct this: listed there, or a schedule."""
    from trl_explore.strategies import schedules

    place, _, name = str(target).rpartition(".")
    kind = vars(schedules).get(name) if place == schedules.__name__ else None
    schedule = isinstance(kind, type) and issubclass(kind, schedules.Schedule)
    return schedule or str(target) in _known(config_dir)


def _targets(node: Any) -> list[Any]:
    if isinstance(node, dict):
        own = [node["_target_"]] if "_target_" in node else []
        return own + [t for child in node.values() for t in _targets(child)]
    return [t for child in node for t in _targets(child)] if isinstance(node, list) else []
