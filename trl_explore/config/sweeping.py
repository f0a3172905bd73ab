"""A sweep under any launcher: which jobs it has, and how each one ended, whatever process ran it.

Hydra drops what a job returns, and knows the jobs of a sweep only inside its sweeper. So the
sweeper that Hydra builds is given a launcher of ours, which hands on to the one that was chosen
(``hydra/launcher=joblib``), and keeps what comes back.
"""

from __future__ import annotations

import shutil
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from hydra.core.plugins import Plugins
from hydra.core.utils import JobReturn
from hydra.plugins.launcher import Launcher
from hydra.plugins.sweeper import Sweeper
from omegaconf import DictConfig

from trl_explore.checks import first_line
from trl_explore.config.base import ConfigError
from trl_explore.config.building import is_multirun
from trl_explore.config.naming import register_resolvers
from trl_explore.jobs import sweeps

register_resolvers()  # a launcher's process composes the configuration before it runs our code
# conf/hydra/launcher/ says every argument of the plugins, whose schemas have the same names.
warnings.filterwarnings(
    "ignore", r"\n'hydra/launcher/\w+' is validated against ConfigStore schema", UserWarning
)

EXTRAS = {"joblib": "joblib", "submitit_local": "submitit", "submitit_slurm": "submitit",
          "ray": "ray"}  # fmt: skip
"""Which extra of the package a launcher needs."""


class Ended(NamedTuple):
    """How a job ended; this goes through a pipe or a file where another process ran it."""

    folder: Path
    error: str = ""
    """One line; nothing if the job is finished."""
    told: bool = False
    """Whether the user has seen the line."""

    @property
    def line(self) -> str:
        """The error with the name of the job."""
        return f"{self.folder.name}: {self.error}"


class _State:
    """Of this process alone: it does not go to the processes of a launcher."""

    leads = False
    ended: list[Ended]


def is_worker() -> bool:
    """Whether this process was started by a launcher, to run jobs."""
    return not _State.leads


def end_job(folder: Path, error: str = "", *, record: bool = True) -> Ended:
    """Note how a job ended: for the one who started it, and for ``status``.

    Args:
        folder: of the job; of one that failed it is removed, unless there is something in it
            from which it could go on.
        error: one line; nothing if the job is finished.
        record: whether the failure is one of the job, and not of this attempt.
    """
    if error:
        with suppress(OSError):
            if {path.name for path in folder.iterdir()} == {".hydra"}:
                shutil.rmtree(folder / ".hydra")
            folder.rmdir()
        with suppress(OSError):  # also where the lock has removed the job's own already
            folder.parent.rmdir()
        if record and is_multirun():
            sweeps.record_failure(folder, error)
    else:
        sweeps.forget_failure(folder)
    ended = Ended(folder, error, told=_State.leads)
    if error and ended.told:
        print(f"error: {ended.line if is_multirun() else error}", file=sys.stderr)
    if _State.leads and not is_multirun():
        _State.ended.append(ended)
    return ended


@contextmanager
def collecting() -> Iterator[list[Ended]]:
    """How the jobs that Hydra runs within this context ended, in their order.

    Raises:
        ConfigError: if the launcher that was chosen is not installed.
    """
    _State.leads, _State.ended = True, []
    plugins = Plugins.instance()

    def instantiate(*, config: DictConfig, **arguments: Any) -> Sweeper:
        del plugins.instantiate_sweeper  # for once; and nothing of ours goes to other processes
        try:
            sweeper = plugins.instantiate_sweeper(config=config, **arguments)
        except (RuntimeError, ImportError) as error:
            raise ConfigError(_not_installed(config, error)) from None
        watch = _Watch(sweeper, _State.ended)
        sweeper.validate_batch_is_legal = watch.compose
        sweeper.launcher = watch
        return sweeper

    plugins.instantiate_sweeper = instantiate
    try:
        yield _State.ended
    finally:
        vars(plugins).pop("instantiate_sweeper", None)


def _not_installed(config: DictConfig, error: Exception) -> str:
    choices = config.hydra.runtime.choices
    name = choices.get("hydra/launcher")
    if name in EXTRAS:
        return f"hydra/launcher={name} is not installed: pip install 'trl_explore[{EXTRAS[name]}]'"
    chosen = f"hydra/launcher={name}, hydra/sweeper={choices.get('hydra/sweeper')}"
    return f"{chosen}: {first_line(error)}"


class _Watch(Launcher):
    """The launcher of a sweeper, and what is known of its jobs before and after they are run."""

    def __init__(self, sweeper: Sweeper, ended: list[Ended]) -> None:
        assert sweeper.launcher is not None
        self.sweeper, self.launcher, self.ended = sweeper, sweeper.launcher, ended
        self.folders: dict[tuple[str, ...], Path] = {}

    def setup(self, **arguments: Any) -> None:
        """The launcher has been set up."""

    def compose(self, batch: Sequence[Sequence[str]]) -> None:
        """Compose every job, which finds what cannot be, and note the folders that they have."""
        assert self.sweeper.hydra_context is not None
        assert self.sweeper.config is not None
        loader = self.sweeper.hydra_context.config_loader
        try:
            for overrides in batch:
                job = loader.load_sweep_config(self.sweeper.config, list(overrides))
                folder = Path(str(job.hydra.sweep.dir), str(job.hydra.sweep.subdir))
                self.folders[tuple(overrides)] = folder.absolute()
        except BaseException:
            sweeps.end_sweep(Path(str(self.sweeper.config.hydra.sweep.dir)))
            raise

    def launch(
        self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int
    ) -> Sequence[JobReturn]:
        """Launch each job once, also where a sweep names it twice, as ``1`` and ``1.0``."""
        unknown = [o for o in job_overrides if tuple(o) not in self.folders]
        if unknown:
            self.compose(unknown)
        jobs: dict[Path, Sequence[str]] = {}
        for overrides in job_overrides:
            jobs.setdefault(self.folders[tuple(overrides)], overrides)
        places: dict[Path, list[str]] = {}
        for folder in jobs:
            places.setdefault(folder.parent, []).append(folder.name)
        for sweep, names in places.items():
            sweep.mkdir(parents=True, exist_ok=True)
            sweeps.begin_sweep(sweep, names)
        try:
            return self._launch(jobs, job_overrides, initial_job_idx)
        finally:
            for sweep in places:
                sweeps.end_sweep(sweep)

    def _launch(
        self,
        jobs: dict[Path, Sequence[str]],
        job_overrides: Sequence[Sequence[str]],
        initial_job_idx: int,
    ) -> list[JobReturn]:
        try:
            returned = self.launcher.launch(list(jobs.values()), initial_job_idx)
        except Exception as error:  # of the launcher itself: a process that was killed, a timeout
            reason = f"the launcher lost it ({type(error).__name__}: {first_line(error)})"
            self.ended += [_from_files(folder, reason) for folder in jobs]
            return []
        by_folder = dict(zip(jobs, returned, strict=True))
        for job in by_folder.values():
            ended: Ended = job.return_value
            if ended.error and not ended.told:
                print(f"error: {ended.line}", file=sys.stderr)
            self.ended.append(ended)
        return [by_folder[self.folders[tuple(overrides)]] for overrides in job_overrides]


def _from_files(folder: Path, reason: str) -> Ended:
    """How a job ended of which nothing came back."""
    if (folder / sweeps.RUN).is_file():
        return Ended(folder)
    ended = Ended(folder, sweeps.read_failures(folder.parent).get(folder.name, reason))
    print(f"error: {ended.line}", file=sys.stderr)
    return ended
