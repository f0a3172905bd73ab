"""Jobs composed in a program or a notebook, from the words of the command line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from hydra import compose, version
from hydra._internal.hydra import Hydra
from hydra._internal.utils import create_config_search_path
from hydra.core.config_search_path import SearchPathQuery
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, open_dict
from omegaconf.errors import OmegaConfBaseException

from trl_explore.config.building import build_trainer, fill_threshold
from trl_explore.config.checking import check_keys, describe
from trl_explore.config.files import CONF, ConfigError, search_in
from trl_explore.config.naming import register_resolvers

if TYPE_CHECKING:
    from trl_explore.training.trainer import Trainer


@contextmanager
def searching(config_dir: Path | None = None) -> Iterator[None]:
    """Let Hydra compose from ``conf/``, and before it from the user's folder.

    Raises:
        ConfigError: if the folder does not exist.
    """
    if config_dir is not None and not config_dir.is_dir():
        raise ConfigError(f"--config-dir {config_dir}: no such folder")
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
    import torch

    torch.set_num_threads(1)
    try:
        with searching(Path(config_dir) if config_dir else None):
            config, hydra = composed(list(overrides))
            if hydra.mode == RunMode.MULTIRUN:
                raise ConfigError("this is a sweep: give one job, or use trl-explore train")
            trainer = build_trainer(config)
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(describe(error)) from error
    trainer.run()
    return trainer
