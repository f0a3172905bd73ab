"""Jobs composed from words: in a program or a notebook, or as a finished job has recorded them.

A folder of results may come from someone else. So nothing in it is constructed unless ``conf/`` or
the user's own ``--config-dir`` names it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra import compose, version
from hydra._internal.hydra import Hydra
from hydra._internal.utils import create_config_search_path
from hydra.core.config_search_path import SearchPathQuery
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

from trl_explore.checks import first_line
from trl_explore.config.building import build_trainer, fill_threshold
from trl_explore.config.checking import check_keys, describe, differences, resolved
from trl_explore.config.files import (
    CONF,
    GROUPS,
    ConfigError,
    check_folder,
    files_of,
    load,
    search_in,
)
from trl_explore.config.job_names import register_resolvers
from trl_explore.jobs.columns import EVALUATIONS
from trl_explore.jobs.reading import find_jobs, read_run, read_trials

if TYPE_CHECKING:
    import pandas as pd

    from trl_explore.training.trainer import Trainer


@contextmanager
def searching(config_dir: Path | None = None) -> Iterator[None]:
    """Let Hydra compose from ``conf/``, and before it from the user's folder.

    Raises:
        ConfigError: if the folder cannot be read.
    """
    if config_dir is not None:
        check_folder(config_dir)
    register_resolvers()
    search_in([config_dir] if config_dir else [])
    search = create_config_search_path(str((config_dir or CONF).resolve()))
    search.append("conf", str(CONF), anchor=SearchPathQuery(provider="main"))
    GlobalHydra.instance().clear()
    version.setbase("1.3")
    Hydra.create_main_hydra2(task_name="recorded", config_search_path=search)
    try:
        yield
    finally:
        GlobalHydra.instance().clear()


def composed(overrides: list[str]) -> tuple[DictConfig, DictConfig]:
    """The checked configuration of one job, and Hydra's own.

    Raises:
        ConfigError: if a key is unknown.
    """
    config = compose("train", overrides=overrides, return_hydra_config=True)
    with open_dict(config):
        hydra = config.pop("hydra")
    check_keys(config, dict(hydra.runtime.choices))
    fill_threshold(config)
    return config, hydra


def build(*overrides: str, config_dir: str | Path | None = None) -> Trainer:
    """The trainer of the job that these words of the command line describe.

    Raises:
        ConfigError: if a value is not allowed, or the words describe several jobs.
    """
    import torch

    torch.set_num_threads(1)
    try:
        with searching(Path(config_dir) if config_dir else None):
            config, hydra = composed(list(overrides))
            if hydra.mode == RunMode.MULTIRUN:
                raise ConfigError("this is a sweep: give one job, or use trl-explore train")
            return build_trainer(config)
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(describe(error)) from error


def train(*overrides: str, config_dir: str | Path | None = None) -> Trainer:
    """Train the trials that these words of the command line describe; write no files.

    The trials are those of ``trl-explore train``, to the last bit.

    Args:
        overrides: such as ``"strategy=epsilon_greedy"``, ``"strategy.epsilon=0.1"``.
        config_dir: a folder with configuration files of your own.

    Returns:
        The trainer after its last iteration: ``trials`` is the record of what the agents did
        (``passed`` [trials], ``iterations`` [trials], ``curves()``), ``evaluator`` the record of
        what they learned (``learned`` [trials], ``learned_score`` [trials]).

    Raises:
        ConfigError: if a value is not allowed, or the words describe several jobs.

    Example:
        >>> trainer = train("strategy=random", "trials=2", "max_iterations=3")
        >>> trainer.trials.iterations
        array([3, 3])
    """
    trainer = build(*overrides, config_dir=config_dir)
    trainer.run()
    return trainer


@dataclass(frozen=True)
class RecordedJob:
    """A finished job, with its configuration recomposed from ``conf/``."""

    folder: Path
    experiment: str
    config: DictConfig
    trials: pd.DataFrame

    def trainer(self, trial: int) -> Trainer:
        """The trainer of one trial alone, with that trial's own parameters.

        Evaluation is off if the training does not depend on it. If the environment is compiled,
        the trainers of a job share one, which is never stepped.
        """
        from trl_explore.collectors import FusedCollector

        row = trial - self.config.first_trial
        trainer = build_trainer(self._alone, slice(row, row + 1), self._shared.get("env"))
        if isinstance(trainer.collector, FusedCollector):
            self._shared["env"] = trainer.collector.env
        return trainer

    @cached_property
    def _shared(self) -> dict[str, Any]:
        return {}

    @cached_property
    def _alone(self) -> DictConfig:
        config = self.config.copy()
        if config.stop_on in ("training", "never"):
            config.evaluate_every, config.evaluate_episodes = 0, 1
        OmegaConf.resolve(config)  # once, and not at every access of every trial
        return config


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
    if config.evaluate_every == "auto" and not (folder / EVALUATIONS).is_file():
        config.evaluate_episodes = load("train").evaluate_episodes  # older versions ignored it
    return RecordedJob(folder, run["experiment"], config, read_trials(folder))


@cache
def _known(config_dir: Path | None) -> frozenset[str]:
    """The objects that the files of ``conf/`` and of the user construct; no others are allowed.

    ``files_of`` searches the user's folder as well: ``config_dir`` is only the key of the cache.
    """
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
