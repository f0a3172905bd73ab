"""One job of ``train``, from its configuration to its files, unless it is already finished."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from trl_explore import config as configuration
from trl_explore import jobs as results
from trl_explore.commands.main import TRACEBACK
from trl_explore.config import ConfigError, sweeping, tuning_value
from trl_explore.config.sweeping import Process
from trl_explore.jobs import signals
from trl_explore.jobs.checkpoint import FOLDER as CHECKPOINT
from trl_explore.jobs.code import changed_code, code_digests
from trl_explore.jobs.files import ResultsError
from trl_explore.jobs.lock import NAME as LOCK
from trl_explore.jobs.lock import Lock, LockedError
from trl_explore.jobs.resume import Checkpoints
from trl_explore.jobs.signals import Interrupts

if TYPE_CHECKING:
    from trl_explore.jobs.resume import Saver
    from trl_explore.training.trials import Trials

EXPECTED = (ValueError, OmegaConfBaseException, OSError, MemoryError)
"""Errors whose message suffices; other messages are prefixed with the type of the error."""


def run(config: DictConfig) -> float | list[float] | None:
    """Run one job, in this process or in a worker of a launcher, and record how it ended.

    Returns its objective if the sweeper optimises one; a job that failed has the worst.
    """
    folder = sweeping.current_folder()
    if Process.repeated:
        with suppress(OSError):
            folder.rmdir()  # created by Hydra
        return None
    if not Process.leads:
        begin_worker()
    try:
        try:
            train(config, folder)
        except Exception:
            signals.check()  # the error may be a converted signal
            raise
    except Exception as error:  # no error of a job stops the other jobs of the sweep
        if os.environ.get(TRACEBACK) or config.debug is True:
            traceback.print_exc()
        line = configuration.describe(error)
        if not isinstance(error, EXPECTED):
            line = f"{type(error).__name__}: {line}"
        # The process that holds a lock reports the outcome itself.
        sweeping.end_job(folder, line, record=not isinstance(error, LockedError))
    except KeyboardInterrupt as error:
        if Process.leads:
            raise
        end_interrupted(folder, error)
    else:
        sweeping.end_job(folder)
        return tuning_value.returned(config, folder)
    return tuning_value.returned(config, None)


def end_interrupted(folder: Path, error: KeyboardInterrupt) -> None:
    """End a job of a launcher after a signal; Slurm may be asked to start it again."""
    sweeping.end_job(folder, str(error) or "interrupted", record=False)
    if str(sweeping.current_choices().get("hydra/launcher")).startswith("submitit"):
        try:
            signals.end_in_launcher(error)
        except Exception as refused:
            line = configuration.describe(refused)
            sweeping.end_job(folder, f"{line}; run the same command to resume")


def begin_worker() -> None:
    """Print only whole lines, because this process shares the terminal with others."""
    from trl_explore.jobs.console import Bar

    if sweeping.current_choices().get("hydra/launcher") == "joblib":
        signals.end_with_parent()
    Bar.quiet = True
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(line_buffering=True)


def train(config: DictConfig, folder: Path) -> None:
    """Run a job and write its folder, unless the job is already finished."""
    choices = sweeping.current_choices()
    configuration.check_keys(config, choices)
    configuration.fill_threshold(config)
    values = configuration.resolved(config)
    if results.is_finished(folder) and not config.restart:
        leave_finished(folder, values)
        return

    # A search may run two jobs with the same values at once; both need the number.
    lock = Lock(folder, wait=tuning_value.is_wanted())
    with lock, Interrupts(lock.release) as interrupts:
        if results.is_finished(folder) and not config.restart:  # finished in the meantime
            leave_finished(folder, values)
            return
        checkpoints = Checkpoints(folder, load=not config.restart)
        if checkpoints.header is not None:
            check_same(folder, checkpoints.header, values, finished=False)
        train_from(config, folder, values, checkpoints, interrupts)


def leave_finished(folder: Path, values: dict[str, Any]) -> None:
    """Report that a job is finished, and remove leftovers of a kill at its very end."""
    record = results.read_run(folder)
    check_same(folder, record, values, finished=True)
    try:
        results.check_files(folder, record, up_to=results.SMALL)
    except ResultsError as error:
        raise ResultsError(f"{error}; restart=true starts over") from None
    if (folder / CHECKPOINT).exists() or (folder / LOCK).exists():
        with suppress(OSError), Lock(folder):
            Checkpoints(folder, load=False).clear()
    print(f"{folder.name}: already finished, nothing to do (restart=true starts over)")


def check_same(
    folder: Path, record: Mapping[str, Any], values: dict[str, Any], *, finished: bool
) -> None:
    """Refuse a folder whose job has another configuration or code; unfinished, also versions."""
    found = configuration.differences(record["config"], values)
    if not finished:
        found += configuration.differences(record["versions"], results.versions(), "versions.")
    found += changed_code(record.get("code", {}), code_digests(values), own=not finished)
    if found:
        raise ConfigError(
            f"{folder} holds {'a' if finished else 'an unfinished'} job with another configuration "
            f"({'; '.join(found)}); restart=true starts over"
        )


def train_from(
    config: DictConfig,
    folder: Path,
    values: dict[str, Any],
    checkpoints: Checkpoints,
    interrupts: Interrupts,
) -> None:
    """Train from the checkpoints or from the start, and write the results."""
    import torch

    from trl_explore.jobs.console import Progress

    choices = sweeping.current_choices()
    torch.set_num_threads(1)
    shards = configuration.build_shards(config, checkpoints.sizes)
    header = {"config": values, "versions": results.versions(), "code": code_digests(values)}
    checkpoints.attach(shards, header, interrupts, config.checkpoint_seconds)
    if checkpoints.header is None:
        checkpoints.clear()
    results.clear(folder)
    sweeping.save_hydra(folder, config)
    records = [trainer.trials for trainer in shards.trainers]
    progress = Progress(folder.name, records, place=Process.place)

    def after_iteration(saver: Saver, trials: Trials) -> None:
        progress()
        saver(trials)

    for trainer, saver in zip(shards.trainers, checkpoints.savers, strict=True):
        trainer.on_iteration = partial(after_iteration, saver)
    try:
        with interrupts.deferred():
            interrupts.check()
            trials = shards.run(config.threads)
            progress.close()
            with interrupts.held():  # a finished training is always written
                results.write_job(
                    folder,
                    trials,
                    shards.weights(),
                    config=values,
                    experiment=choices.get("experiment") or "train",
                    strategy=str(choices["strategy"]),
                    collector=type(shards.trainers[0].collector).__name__,
                    seconds=shards.seconds,
                    episodes=config.episodes,
                    **shards.recorded(),
                )
    except BaseException:
        if interrupts.pending is not None:
            checkpoints.rescue()
            if checkpoints.where:
                interrupts.pending.where = f" at {checkpoints.where} of {folder.name}"
            interrupts.check()
        raise
    finally:
        progress.close()
        shards.close()
        for trainer in shards.trainers:  # a reference cycle would keep the data of each job alive
            trainer.on_iteration = None
    checkpoints.clear()
    interrupts.check()
