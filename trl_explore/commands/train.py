"""``trl-explore train [-m] [key=value ...]``; ``--help`` lists the keys."""

from __future__ import annotations

import logging
import os
import sys
import traceback
from contextlib import suppress
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hydra
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from trl_explore import config as configuration
from trl_explore import jobs as results
from trl_explore.config import CONF, ConfigError
from trl_explore.jobs import signals
from trl_explore.jobs.checkpoint import FOLDER as CHECKPOINT
from trl_explore.jobs.checkpoint import Checkpoint, Store
from trl_explore.jobs.columns import ResultsError
from trl_explore.jobs.lock import NAME as LOCK
from trl_explore.jobs.lock import Lock, LockedError
from trl_explore.jobs.resume import find
from trl_explore.jobs.signals import Interrupted, Interrupts

if TYPE_CHECKING:
    from trl_explore.training.record import Trials

EXPECTED = (ValueError, OmegaConfBaseException, OSError, MemoryError)
"""Errors whose message says enough; before others stands their type."""
TRACEBACK = "TRL_EXPLORE_TRACEBACK"
"""Set in the environment, also of other processes, where the user asked for whole tracebacks."""


def run(config: DictConfig) -> None:
    """One job of a sweep, or the only one; in a process of a launcher, if there is one."""
    folder = configuration.current_folder()
    if configuration.is_repeated():
        with suppress(OSError):
            folder.rmdir()  # Hydra has made it
        return
    if configuration.is_worker():
        begin_worker()
    try:
        try:
            train(config, folder)
        except Exception:
            signals.check()  # it may be what a signal has become on its way
            raise
    except Exception as error:  # whatever ends a job, the others of the sweep are run
        if TRACEBACK in os.environ:
            traceback.print_exc()
        line = configuration.describe(error)
        if not isinstance(error, EXPECTED):
            line = f"{type(error).__name__}: {line}"
        other = isinstance(error, LockedError)  # the process that has it tells how it ends
        configuration.end_job(folder, line, record=not other)
    except KeyboardInterrupt as error:
        if not configuration.is_worker():
            raise
        configuration.end_job(folder, str(error) or "interrupted", record=False)
    else:
        configuration.end_job(folder)


def begin_worker() -> None:
    """Only whole lines come from a process that shares its terminal with others."""
    from trl_explore.jobs.console import Progress

    Progress.quiet = True
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(line_buffering=True)


def train(config: DictConfig, folder: Path) -> None:
    """Run a job into its folder, unless it is there already."""
    choices = configuration.current_choices()
    configuration.check_keys(config, choices)
    configuration.fill_threshold(config)
    values = configuration.resolved(config)
    if results.is_finished(folder) and not config.restart:
        leave_finished(folder, values)
        return

    lock = Lock(folder)
    with lock, Interrupts(lock.release) as interrupts:
        if results.is_finished(folder) and not config.restart:  # by now
            leave_finished(folder, values)
            return
        store, checkpoint = (Store(folder), None) if config.restart else find(folder)
        if checkpoint is not None:
            check_same(folder, checkpoint.header, values)
        train_from(config, folder, values, store, checkpoint, interrupts)


def leave_finished(folder: Path, values: dict[str, Any]) -> None:
    """Say that a job is finished, and remove what a kill in its last moment left there."""
    record = results.read_run(folder)
    differences = configuration.differences(record["config"], values)
    if differences:
        raise ConfigError(
            f"{folder} holds a job of another configuration ({'; '.join(differences)}); "
            "restart=true begins anew"
        )
    try:
        results.check_whole(folder, record)
    except ResultsError as error:
        raise ResultsError(f"{error}; restart=true begins anew") from None
    if (folder / CHECKPOINT).exists() or (folder / LOCK).exists():
        with suppress(OSError), Lock(folder):
            Store(folder).clear()
    print(f"{folder.name}: finished before, nothing to do (restart=true begins anew)")


def check_same(folder: Path, header: dict[str, Any], values: dict[str, Any]) -> None:
    """Refuse to go on from a checkpoint of another configuration, or of other packages."""
    differences = configuration.differences(header["config"], values)
    differences += configuration.differences(header["versions"], results.versions(), "versions.")
    if differences:
        raise ConfigError(
            f"{folder} holds an unfinished job of another configuration "
            f"({'; '.join(differences)}); restart=true begins anew"
        )


def train_from(
    config: DictConfig,
    folder: Path,
    values: dict[str, Any],
    store: Store,
    checkpoint: Checkpoint | None,
    interrupts: Interrupts,
) -> None:
    """Train from a checkpoint, or from the beginning, and write the results."""
    import torch

    from trl_explore.jobs.console import Progress
    from trl_explore.jobs.resume import Saver, restore

    choices = configuration.current_choices()
    trainer = configuration.build_trainer(config)
    torch.set_num_threads(1)
    if checkpoint is not None:
        restore(trainer, checkpoint)
    header = {"config": values, "versions": results.versions()}
    saver = Saver(store, trainer, header, interrupts, seconds=config.checkpoint_seconds)
    if checkpoint is None:
        store.clear()
    results.clear(folder)
    configuration.save_hydra(folder, config)
    progress = Progress(folder.name, begun=trainer.trials)

    def on_iteration(trials: Trials) -> None:
        progress(trials)
        saver(trials)

    trainer.on_iteration = on_iteration
    try:
        with interrupts.deferred():
            interrupts.check()
            trials = trainer.run()
            progress.close()
            with interrupts.held():  # what is trained is not thrown away
                results.write_job(
                    folder,
                    trials,
                    dict(trainer.collector.policy[0].named_parameters()),
                    config=values,
                    experiment=choices.get("experiment") or "train",
                    strategy=str(choices["strategy"]),
                    collector=type(trainer.collector).__name__,
                    seconds=trainer.seconds,
                    episodes=config.episodes,
                    evaluator=trainer.evaluator,
                    diagnostics=trainer.diagnostics,
                )
    except BaseException:
        if interrupts.pending is not None:
            saver.rescue()
            if saver.saved:
                interrupts.pending.where = f" at iteration {saver.saved} of {folder.name}"
            interrupts.check()
        raise
    finally:
        progress.close()
        trainer.collector.shutdown()
        trainer.on_iteration = None  # a cycle, which would keep the data of job after job
    store.clear()
    interrupts.check()


def main() -> int:
    """Run Hydra; anything that the user did wrong is one line on stderr, and status 1."""
    logging.basicConfig(format="%(message)s", stream=sys.stderr)
    logging.getLogger("trl_explore").setLevel(logging.INFO)
    if os.environ.get("HYDRA_FULL_ERROR"):
        os.environ[TRACEBACK] = "1"
    os.environ["HYDRA_FULL_ERROR"] = "1"  # hand errors over instead of printing tracebacks
    configuration.register_resolvers()
    sys.argv[1:] = sorted(sys.argv[1:], key=_place)
    try:
        return sweep()
    except Interrupted as error:
        print(f"{error}{error.where}; the same command goes on", file=sys.stderr)
        return error.status


def _place(word: str) -> int:
    """Flags stand first, overrides last: argparse takes no overrides on both sides of a flag."""
    if word in ("-m", "--multirun"):
        return 0
    return 2 if word[:1] == "~" or (word[:1] != "-" and "=" in word) else 1


def sweep() -> int:
    """All jobs of the command; returns the exit status."""
    try:
        signals.raise_on_signals()
        start = hydra.main(version_base="1.3", config_path=str(CONF), config_name="train")
        jobs = configuration.collect(start(run))
        signals.check()
        finished = [job.folder for job in jobs if not job.error]
        failed = [job for job in jobs if job.error]
        if finished:
            show(finished)
    except Exception as error:
        signals.check()
        if TRACEBACK in os.environ or not isinstance(error, (HydraException, *EXPECTED)):
            raise
        print(f"error: {configuration.describe(error)}", file=sys.stderr)
        return 1
    if len(jobs) > 1 and failed:
        print(f"{len(failed)} of {len(jobs)} jobs failed:", file=sys.stderr)
        for job in failed:
            print(f"  {job.line}", file=sys.stderr)
    return 1 if failed else 0


def show(folders: list[Path]) -> None:
    """The table over all jobs, and where the files are."""
    from trl_explore.jobs.console import table, warnings
    from trl_explore.jobs.reading import read_job

    jobs = [read_job(folder) for folder in folders]
    print("\n".join([table(jobs), *warnings(jobs)]))
    print(f"results: {folders[0] if len(folders) == 1 else folders[0].parent}")
