"""What is changed in Hydra's sweeper, which composes jobs, and in launchers, which wait for them.

The sweeper reads every file of the configuration for every job; here it does so once for each
choice of options. The launchers of submitit and Ray stop waiting at the first job that the cluster
has ended: cancelled, out of memory, on a node that died. The program would end while other jobs
still run.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from copy import deepcopy
from functools import wraps
from importlib import import_module
from pathlib import Path
from typing import Any

from hydra._internal.config_loader_impl import get_overrides_dirname
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.core.utils import JobReturn, JobStatus
from hydra.plugins.sweeper import Sweeper
from hydra.utils import get_class
from omegaconf import DictConfig, OmegaConf, open_dict

from trl_explore.checks import first_line

VALIDATE = Sweeper.validate_batch_is_legal
BASES = 100
"""Most choices of options whose files are kept."""
OVER = {
    "BOOT_FAIL", "CANCELLED", "COMPLETED", "DEADLINE", "FAILED", "NODE_FAIL", "OUT_OF_MEMORY",
    "TIMEOUT",
}  # fmt: skip
"""The states of Slurm from which a job does not return by itself."""
GONE = "no longer in the queue"
ARRAY = 1000
"""The largest array of jobs that Slurm accepts, if its ``MaxArraySize`` is the default."""
POLL = 60
"""The longest time between two looks at Slurm's queue [s]."""


def plan(config: DictConfig) -> tuple[list[Path], set[int]]:
    """Compose every job of a sweep, one at a time, which detects errors.

    Returns:
        The folder of each job, and the numbers of the jobs that equal an earlier one.
    """
    loader = GlobalHydra.instance().config_loader()
    Sweeper.validate_batch_is_legal = VALIDATE
    vars(loader)["load_sweep_config"] = composer = Composer(loader)  # also for the launcher
    words = [f"{key}={value}" for key, value in (config.hydra.sweeper.get("params") or {}).items()]
    words += [str(word) for word in config.hydra.overrides.task]
    overrides = OverridesParser.create(config_loader=loader).parse_overrides(words)
    (batch,) = BasicSweeper.split_arguments(overrides, max_batch_size=None)
    folders: list[Path] = []
    first: dict[Path, int] = {}
    repeated = set[int]()
    for number, words in enumerate(batch):
        job = composer(config, words)
        with open_dict(job):  # as launchers do: the name of a folder may contain it
            job.hydra.job.id = job.hydra.job.num = number
        folders.append(Path(str(job.hydra.sweep.dir), str(job.hydra.sweep.subdir)).absolute())
        earlier = first.setdefault(folders[-1], number)
        if earlier != number and _values(job) == _values(composer(config, batch[earlier])):
            repeated.add(number)
    # The loop above has done it. Hydra loads the module of BasicSweeper again, but not this one.
    Sweeper.validate_batch_is_legal = lambda self, batch: None
    return folders, repeated


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


def await_all(launcher: str, end: Callable[[str], None]) -> None:
    """Make a launcher wait for all its jobs; other launchers than submitit and Ray stay as is.

    Args:
        launcher: the full name of the launcher's class.
        end: called once per job, in the order of the jobs, with one line that says how the
            cluster ended the job, or with an empty text if the job ended by itself.
    """
    if ".hydra_submitit_launcher." in launcher:
        _await_submitit(end)
    elif ".hydra_ray_launcher." in launcher:
        _await_ray(end)


def note_folders(launcher: str, note: Callable[[Path], None], lost: Any) -> None:
    """Call ``note`` with the folder of every job that a launcher returns (see ``Sweep``).

    A job that the cluster has ended has no folder, and returns ``lost``.
    """
    kind = get_class(launcher)
    launch = getattr(kind.launch, "__wrapped__", kind.launch)

    @wraps(launch)
    def launch_and_note(*arguments: Any, **options: Any) -> Sequence[JobReturn]:
        returned = launch(*arguments, **options)
        for job in returned:
            if job.working_dir is not None:
                note(Path(job.working_dir))
            else:
                job.return_value = lost
        return returned

    kind.launch = launch_and_note


def _ended() -> JobReturn:
    """What the launcher returns for a job whose outcome is read from its files."""
    returned = JobReturn(status=JobStatus.COMPLETED)
    returned.return_value = None
    return returned


def _await_ray(end: Callable[[str], None]) -> None:
    ray = import_module("ray")  # by name: it is in no environment that the type checker sees
    core = import_module("hydra_plugins.hydra_ray_launcher._core")

    class Ray:
        @staticmethod
        def get(run: Any) -> Any:
            try:
                returned = ray.get(run)
            except ray.exceptions.RayError as error:
                end(f"Ray ended the job ({type(error).__name__})")
                return _ended()
            end("")
            return returned

    vars(core)["ray"] = Ray  # the launcher calls ray.get for one job after the other


def _await_submitit(end: Callable[[str], None]) -> None:
    from submitit import AutoExecutor
    from submitit.slurm.slurm import SlurmJob

    logging.getLogger("submitit").setLevel(logging.ERROR)
    SlurmJob.watcher = _queue()
    start = getattr(AutoExecutor.map_array, "__wrapped__", AutoExecutor.map_array)

    @wraps(start)
    def map_array(executor: Any, function: Any, *arguments: Sequence[Any]) -> list[_Awaited]:
        parts = range(0, len(arguments[0]), ARRAY)
        started = [start(executor, function, *(a[k : k + ARRAY] for a in arguments)) for k in parts]
        return [_Awaited(job, end) for jobs in started for job in jobs]

    AutoExecutor.map_array = map_array  # pyright: ignore[reportAttributeAccessIssue]


class _Awaited:
    """A job of submitit whose ``results`` waits, and never raises an exception."""

    def __init__(self, job: Any, end: Callable[[str], None]) -> None:
        self.job, self.end = job, end

    def results(self) -> list[Any]:
        self.job.wait()
        if not self.job.paths.result_pickle.exists() and self.job.state != "COMPLETED":
            self.end(f"the job ended without a result ({self.job.state})")
        elif (error := self.job.exception()) is not None:
            self.end(_last_line(error))
        else:
            self.end("")
            return self.job.results()
        return [_ended()]


def _last_line(error: Exception) -> str:
    """The last line of the traceback in a message of submitit, or else its first line."""
    _, *traceback = str(error).split(f"\n{'-' * 22}\n")
    return traceback[0].strip().splitlines()[-1] if traceback else first_line(error)


def _queue() -> Any:
    """The states of Slurm's jobs, from ``squeue``: unlike ``sacct``, it needs no database."""
    from submitit.slurm.slurm import SlurmInfoWatcher

    class Queue(SlurmInfoWatcher):
        def _make_command(self) -> list[str] | None:
            if not self._registered - self._finished:
                return None
            user = f"--user={os.getuid()}"
            return ["squeue", user, "--array", "--noheader", "--states=all", "--format=%i|%T"]

        def read_info(self, string: bytes | str) -> dict[str, dict[str, str]]:
            text = string if isinstance(string, str) else string.decode()
            states = dict(line.split("|", 1) for line in text.split())
            known = {job: states.get(job, GONE) for job in self._registered}
            return {
                job: {"State": state if state in OVER or state == GONE else "RUNNING"}
                for job, state in known.items()
            }

    return Queue(delay_s=POLL)
