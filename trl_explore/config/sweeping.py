"""The jobs of a sweep under any launcher, and how each one ended, in whatever process it ran.

Hydra discards the return value of a job. Therefore a Hydra callback (``hydra.callbacks.sweep`` in
``conf/train.yaml``) plans the jobs before the first one runs. The outcome of a job that ran in
another process (``hydra/launcher=joblib``) is read from its files.
"""

from __future__ import annotations

import gc
import shutil
import sys
import threading
import warnings
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, cast

from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import JobReturn
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from trl_explore.checks import first_line
from trl_explore.config import tuning_value
from trl_explore.config.files import ConfigError
from trl_explore.config.hydra_plugins import await_all, note_folders, plan
from trl_explore.config.job_names import register_resolvers
from trl_explore.config.nodes import to_yaml
from trl_explore.jobs import sweep_files
from trl_explore.jobs.files import named
from trl_explore.jobs.lock import is_locked

register_resolvers()  # a worker composes the configuration before it runs this program's code
# conf/hydra/launcher/ sets every argument of the plugins; their schemas have the same names.
warnings.filterwarnings(
    "ignore", r"\n'hydra/launcher/\w+' is validated against ConfigStore schema", UserWarning
)

EXTRAS = {"joblib": "joblib", "submitit_local": "submitit", "submitit_slurm": "submitit",
          "ray": "ray"}  # fmt: skip
"""The extra of the package that each launcher needs."""
CUT = "cut off; run the same command to resume"
"""The error of a job that ended with neither a result nor its own error."""


class Ended(NamedTuple):
    """How a job ended."""

    folder: Path
    error: str = ""
    """One line; empty if the job is finished."""

    @property
    def line(self) -> str:
        """The error, prefixed with the name of the job."""
        return f"{self.folder.name}: {self.error}"


class Sweep(Callback):
    """The jobs of a sweep; Hydra passes a copy to every process that runs one of them.

    Hydra turns an exception in a callback into a warning. Therefore errors are recorded here, or
    left to Hydra, which composes the same jobs again.
    """

    def __init__(self) -> None:
        self.folders: list[Path] = []
        """The folder of each job, in order of job numbers; empty if the jobs cannot be composed."""
        self.jobs = 0
        """The number of jobs."""
        self.repeated: set[int] = set()
        """The numbers of jobs that equal an earlier job, as in ``1,1.0``."""
        self.place: Path | None = None
        """The folder of the sweep, where Hydra writes ``multirun.yaml``."""
        self.searches = False
        """Whether the sweeper chooses jobs by the results of earlier ones."""
        self.missing = ""
        """One line that names the launcher that is not installed; empty if it is installed."""

    def on_multirun_start(self, config: DictConfig, **arguments: Any) -> None:
        """Plan the jobs, and record which ones were requested."""
        Process.sweep = self
        self.missing = _not_installed(config)
        if not self.missing:
            with suppress(Exception):  # Hydra meets the same error and raises it
                self.place = Path(str(config.hydra.sweep.dir)).absolute()
                if not config.hydra.sweeper._target_.endswith(".BasicSweeper"):
                    # It chooses jobs by the results of earlier ones, and writes into this folder.
                    self.place.mkdir(parents=True, exist_ok=True)
                    sweep_files.begin_sweep(self.place, [])
                    HydraConfig.instance().set_config(config)
                    lost = tuning_value.returned(config, None)
                    note_folders(config.hydra.launcher._target_, Process.launched.append, lost)
                    self.searches = True
                else:
                    self._plan(config)
            await_all(config.hydra.launcher._target_, Process.reasons.append)

    def _plan(self, config: DictConfig) -> None:
        folders, self.repeated = plan(config)
        for sweep, names in _by_sweep(folders).items():
            sweep.mkdir(parents=True, exist_ok=True)
            sweep_files.begin_sweep(sweep, names)
        self.folders, self.jobs = folders, len(folders)

    def on_job_end(self, config: DictConfig, job_return: JobReturn, **arguments: Any) -> None:
        """Note the folder; drop the garbage and the configuration, which Hydra would keep."""
        job_return.working_dir = str(Path(config.hydra.runtime.output_dir).absolute())
        job_return.cfg = job_return.hydra_cfg = None
        if not Process.frozen:
            Process.frozen = True
            gc.freeze()
        gc.collect()

    def on_job_start(self, config: DictConfig, **arguments: Any) -> None:
        """Record whether the job that starts in this process is a duplicate."""
        number = OmegaConf.select(config, "hydra.job.num", throw_on_missing=False)
        planned = isinstance(number, int) and number < self.jobs
        Process.place = (number, self.jobs) if planned else (0, 1)
        Process.repeated = number in self.repeated

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "folders": []}  # a process of a launcher runs one of many jobs


class Process:
    """What this process knows of its sweep; it is not sent to the processes of a launcher."""

    leads = False
    """Whether it started the sweep; if not, a launcher started this process to run jobs."""
    repeated = False
    """Whether its job equals an earlier one of its sweep."""
    place: tuple[int, int] = (0, 1)
    """The number of its job, from 0, and the number of jobs of the sweep."""
    frozen = False
    sweep: Sweep | None = None
    ended: list[Ended]
    reasons: list[str]
    """How the cluster ended each job, in the order of the jobs (see ``await_all``)."""
    launched: list[Path]
    """The folders of the jobs that a launcher returned, if they were not planned."""


def _by_sweep(folders: list[Path]) -> dict[Path, list[str]]:
    """The names of the jobs in the folder of each sweep, without duplicates."""
    places: dict[Path, list[str]] = {}
    for folder in dict.fromkeys(folders):
        places.setdefault(folder.parent, []).append(folder.name)
    return places


def _not_installed(config: DictConfig) -> str:
    """One line if the chosen launcher or sweeper cannot be imported; empty if both can."""
    choices = config.hydra.runtime.choices
    name = choices.get("hydra/launcher")
    try:
        for plugin in (config.hydra.launcher, config.hydra.sweeper):
            import_module(plugin._target_.rpartition(".")[0])
    except Exception as error:  # any error of the import
        if name in EXTRAS:
            extra = f"pip install 'trl_explore[{EXTRAS[name]}]'"
            return f"hydra/launcher={name} is not installed: {extra}"
        chosen = f"hydra/launcher={name}, hydra/sweeper={choices.get('hydra/sweeper')}"
        return f"{chosen}: {first_line(error)}"
    return ""


def end_job(folder: Path, error: str = "", *, record: bool = True) -> None:
    """Record how a job ended, for the process that started it and for ``status``.

    Args:
        folder: the folder of the job; removed if the job failed and left nothing to resume from.
        error: one line; empty if the job is finished.
        record: whether to record the error for ``status``; false if it concerns only this attempt.
    """
    if error:
        with suppress(OSError):
            if {path.name for path in folder.iterdir()} == {".hydra"}:
                shutil.rmtree(folder / ".hydra")
            folder.rmdir()
        with suppress(OSError):  # even if the lock has already removed the job's folder
            folder.parent.rmdir()
        if record and is_multirun():
            try:
                sweep_files.record_failure(folder, error)
            except OSError:  # a full disk: the process that leads the sweep cannot read the reason
                if not Process.leads:
                    print(f"error: {folder.name}: {error}", file=sys.stderr)
    else:
        sweep_files.forget_failure(folder)
    ended = Ended(folder, error)
    if Process.leads:
        if error:
            print(f"error: {ended.line if is_multirun() else error}", file=sys.stderr)
        Process.ended.append(ended)


def collect(start: Callable[[], object]) -> list[Ended]:
    """Let Hydra run the jobs; return how each one ended, in order.

    Raises:
        ConfigError: if the chosen launcher is not installed, or no job was run.
        Exception: the exception of Hydra, if the jobs cannot be composed.
    """
    Process.leads, Process.repeated, Process.sweep = True, False, None
    Process.ended, Process.reasons, Process.launched, Process.place = [], [], [], (0, 1)
    reason, before, threading.excepthook = CUT, threading.excepthook, _in_thread
    try:
        start()
    except Exception as error:
        if Process.sweep is not None and Process.sweep.missing:
            raise ConfigError(Process.sweep.missing) from None
        # The launcher itself failed: a process was killed, or a timeout.
        reason = f"the launcher failed ({type(error).__name__}: {first_line(error)})"
        failed = isinstance(error, RuntimeError) and not isinstance(error, NotImplementedError)
        if failed and Process.sweep is not None and Process.sweep.searches:
            raise ConfigError(f"{reason}; run the same command to search again") from None
        if Process.sweep is None or not Process.sweep.folders:
            raise
    finally:
        threading.excepthook = before
        sweep = Process.sweep
        if sweep is not None and sweep.place is not None:
            for place in {sweep.place, *_by_sweep(sweep.folders)}:
                sweep_files.end_sweep(place)
    if sweep is None:
        return Process.ended
    here = {job.folder.absolute(): job for job in Process.ended}
    folders = dict.fromkeys(sweep.folders or [*here, *Process.launched])
    if not folders:
        raise ConfigError("no job was run")
    reasons = zip(sweep.folders, Process.reasons, strict=False)
    lost = {folder: f"{why}; run the same command to resume" for folder, why in reasons if why}
    ended = [
        here.get(folder) or _from_files(folder, lost.get(folder, reason)) for folder in folders
    ]
    if sweep.searches and sweep.place is not None:  # which of its jobs were lost is unknown
        ended += [Ended(sweep.place, why) for why in Process.reasons if why]
    return ended


def _in_thread(error: threading.ExceptHookArgs) -> None:
    """Print no traceback of joblib's thread, which may fail after a worker was killed.

    Joblib raises an error in the main thread, too, and one line reports that one.
    """
    if not type(error.thread).__module__.startswith("joblib.externals.loky"):
        threading.__excepthook__(error)


def _from_files(folder: Path, reason: str) -> Ended:
    """How a job ended that ran in another process."""
    failure = sweep_files.read_failures(folder.parent).get(folder.name)
    if failure is None and (folder / sweep_files.RUN).is_file():
        return Ended(folder)
    if failure is None and is_locked(folder):
        failure = f"{folder} is in use: another process runs this job"
    ended = Ended(folder, failure or reason)
    print(f"error: {ended.line}", file=sys.stderr)
    return ended


def current_choices() -> dict[str, str | None]:
    """The chosen option of every group in the running job."""
    return dict(HydraConfig.get().runtime.choices)


def current_folder() -> Path:
    """The folder of the running job."""
    return Path(HydraConfig.get().runtime.output_dir)


def is_multirun() -> bool:
    """Whether the running job belongs to a sweep."""
    return HydraConfig.get().mode == RunMode.MULTIRUN


def save_hydra(folder: Path, config: DictConfig) -> None:
    """Write ``.hydra/`` as Hydra does."""
    own = cast(DictConfig, HydraConfig.instance().cfg)
    files = {
        "config.yaml": to_yaml(config),
        "hydra.yaml": to_yaml(own),
        "overrides.yaml": OmegaConf.to_yaml(own.hydra.overrides.task),
    }
    (folder / ".hydra").mkdir(exist_ok=True)
    for name, text in files.items():
        path = folder / ".hydra" / name
        try:
            path.write_text(text, encoding="utf-8")
        except OSError as error:
            raise named(error, path) from None
