"""The configurations of the jobs of a sweep."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

from hydra._internal.config_loader_impl import get_overrides_dirname
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from omegaconf import DictConfig, OmegaConf, open_dict

VALIDATE = BasicSweeper.validate_batch_is_legal
BASES = 100
"""Most choices of options whose files are kept."""


def plan(config: DictConfig) -> tuple[list[Path], set[int]]:
    """Compose every job of a sweep, one at a time, which detects errors.

    Returns:
        The folder of each job, and the numbers of the jobs whose folder belongs to an earlier job
        of another configuration.
    """
    loader = GlobalHydra.instance().config_loader()
    BasicSweeper.validate_batch_is_legal = VALIDATE
    vars(loader)["load_sweep_config"] = composer = Composer(loader)  # also for the launcher
    words = [f"{key}={value}" for key, value in (config.hydra.sweeper.get("params") or {}).items()]
    words += [str(word) for word in config.hydra.overrides.task]
    overrides = OverridesParser.create(config_loader=loader).parse_overrides(words)
    (batch,) = BasicSweeper.split_arguments(overrides, max_batch_size=None)
    folders: list[Path] = []
    first: dict[Path, int] = {}
    others = set[int]()
    for number, words in enumerate(batch):
        job = composer(config, words)
        with open_dict(job):  # as launchers do: the name of a folder may contain it
            job.hydra.job.id = job.hydra.job.num = number
        folders.append(Path(str(job.hydra.sweep.dir), str(job.hydra.sweep.subdir)).absolute())
        earlier = first.setdefault(folders[-1], number)
        if earlier != number and _values(job) != _values(composer(config, batch[earlier])):
            others.add(number)
    BasicSweeper.validate_batch_is_legal = lambda self, batch: None  # the loop above has done it
    return folders, others


def _values(job: DictConfig) -> Any:
    """A job's configuration but for Hydra's own."""
    return OmegaConf.to_container(OmegaConf.masked_copy(job, [str(k) for k in job if k != "hydra"]))


class Composer:
    """Composes the jobs of a sweep, and reads the files once for each choice of options.

    It replaces ``load_sweep_config`` of Hydra's loader, which reads every file for every job.
    """

    def __init__(self, loader: Any) -> None:
        self.loader = loader
        self._bases: dict[tuple[str, ...], DictConfig] = {}

    def __call__(self, master_config: DictConfig, sweep_overrides: Sequence[str]) -> DictConfig:
        """The configuration of a job, as ``load_sweep_config`` gives it."""
        parsed = OverridesParser.create().parse_overrides(list(sweep_overrides))
        values = [override for override in parsed if self._is_value(override)]
        chosen = tuple(str(one.input_line) for one in parsed if one not in values)
        if chosen not in self._bases:
            if len(self._bases) >= BASES:
                self._bases.clear()
            load = type(self.loader).load_sweep_config
            self._bases[chosen] = load(self.loader, master_config, list(chosen))
        job = deepcopy(self._bases[chosen])
        type(self.loader)._apply_overrides_to_config(values, job)
        own = [override for override in parsed if not override.is_hydra_override()]
        names = job.hydra.job.config.override_dirname
        with open_dict(job.hydra):
            job.hydra.overrides.task = [str(override.input_line) for override in own]
            job.hydra.job.override_dirname = get_overrides_dirname(
                own, names.exclude_keys, names.item_sep, names.kv_sep
            )
        OmegaConf.copy_cache(from_config=master_config, to_config=job)
        return job

    def _is_value(self, override: Override) -> bool:
        """Whether an override sets a value after the files are read, and chooses none of them."""
        if override.is_hydra_override() or override.is_sweep_override():
            return False
        if override.package is not None:
            return False
        group = self.loader.repository.group_exists(override.key_or_group)
        return not group or isinstance(override.value(), dict)

    def __getstate__(self) -> dict[str, Any]:
        return {"loader": self.loader, "_bases": {}}  # a launcher sends it to other processes
