"""Time single trials of a finished sweep: ``trl-explore time DIR [--trials N]``.

The seconds in the results of a sweep are those of whole batches. The thesis measured the time of
single trials that run alone. This command reruns trials of every finished job in DIR, one at a time
in this process, on one thread, in random order over all jobs, after a warm-up that compiles and
loads everything. It writes ``timings.csv`` to the folder of the sweep and keeps the timings of
other jobs there. Only training is timed, not imports, the construction of the agent or files.
"""

from __future__ import annotations

import argparse
import logging
import sys
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

from trl_explore import config as configuration
from trl_explore import jobs as results
from trl_explore.config import CONF, GROUPS, ConfigError
from trl_explore.strategies import schedules

ORDER_SEED = 0
"""Seed of the order in which the trials run."""


@dataclass(frozen=True)
class Job:
    """A finished job, with its configuration recomposed from ``conf/``."""

    folder: Path
    experiment: str
    config: DictConfig
    trials: pd.DataFrame


def compose_job(folder: Path, config_dir: Path | None = None) -> Job:
    """Recompose the configuration of a job from its recorded command-line overrides.

    Args:
        folder: the folder of the job.
        config_dir: the user's folder with further configuration files.

    Raises:
        ConfigError: if the overrides are not recorded, would construct an unknown object, or give
            another configuration than that of the job.
    """
    run = results.read_run(folder)
    recorded = folder / ".hydra" / "overrides.yaml"
    if not recorded.is_file():
        raise ConfigError(f"{recorded}: missing; the job cannot be rerun without it")
    try:
        overrides = [str(line) for line in OmegaConf.load(recorded)]
    except Exception as error:  # any error of an invalid file
        raise ConfigError(
            f"{recorded}: not a list of overrides ({configuration.first_line(error)})"
        ) from None
    for override in OverridesParser.create().parse_overrides(overrides):
        key = override.key_or_group
        if override.is_sweep_override() or key.startswith("hydra") or "_target_" in key:
            raise ConfigError(f"{recorded}: {override.input_line!r} is not allowed in a rerun")
    own = [f"hydra.searchpath=['{config_dir.resolve()}']"] if config_dir else []
    composed = compose("train", overrides=[*overrides, *own], return_hydra_config=True)
    choices = dict(composed.hydra.runtime.choices)
    with open_dict(composed):
        del composed["hydra"]
    configuration.check_keys(composed, choices)
    configuration.fill_threshold(composed)
    values = configuration.resolved(composed)
    for target in _targets(values):
        if not _is_known(target, config_dir):
            raise ConfigError(
                f"{folder}: unknown object {target}; if it is yours, give --config-dir"
            )
    # Constructors may have been renamed; running each trial checks that it is the same.
    changed = [d for d in configuration.differences(run["config"], values) if "._" not in d]
    if changed:
        raise ConfigError(f"{folder}: conf/ has changed since the job ran ({'; '.join(changed)})")
    return Job(folder, run["experiment"], composed, results.read_trials(folder))


@cache
def _known(config_dir: Path | None) -> frozenset[str]:
    """The objects that the files of ``conf/`` and of the user construct; no others are allowed."""
    folders = [CONF, *([config_dir] if config_dir else [])]
    files = [path for f in folders for group in GROUPS for path in (f / group).glob("*.yaml")]
    return frozenset(
        str(target)
        for path in files
        for target in _targets(OmegaConf.to_container(OmegaConf.load(path)))
    )


def _is_known(target: Any, config_dir: Path | None = None) -> bool:
    """Whether a recorded configuration may construct this: listed there, or a schedule."""
    place, _, name = str(target).rpartition(".")
    kind = vars(schedules).get(name) if place == schedules.__name__ else None
    schedule = isinstance(kind, type) and issubclass(kind, schedules.Schedule)
    return schedule or str(target) in _known(config_dir)


def _targets(node: Any) -> list[Any]:
    if isinstance(node, dict):
        own = [node["_target_"]] if "_target_" in node else []
        return own + [t for child in node.values() for t in _targets(child)]
    return [t for child in node for t in _targets(child)] if isinstance(node, list) else []


def time_trial(job: Job, trial: int) -> tuple[float, int]:
    """Run one trial alone; return its seconds of training and its number of frames.

    Raises:
        ConfigError: if the number of frames differs from that in the job.
    """
    config = job.config.copy()
    config.update(trials=1, first_trial=trial, threads=1)
    if config.stop_on in ("training", "never"):
        config.evaluate_every = 0  # only training is timed
    trainer = configuration.build_trainer(config)
    try:
        started = time.perf_counter()
        trials = trainer.run()
        seconds = time.perf_counter() - started - trainer.evaluating
    finally:
        trainer.collector.shutdown()
    frames = int(trials.frames[0])
    recorded = int(job.trials.set_index("trial")["frames"].to_dict()[trial])
    if frames != recorded:
        raise ConfigError(
            f"{job.folder}: trial {trial} took {frames} frames alone and {recorded} in the"
            " job; the program has changed since the job ran"
        )
    return seconds, frames


def time_all(jobs: list[Job], trials: int) -> pd.DataFrame:
    """Time the first ``trials`` trials of every job, in random order."""
    plan = [(job, int(t)) for job in jobs for t in job.trials["trial"].iloc[:trials]]
    for job in jobs:  # warm-up: the shortest trial of each
        shortest = job.trials["frames"].iloc[:trials].argmin()
        time_trial(job, int(job.trials["trial"].iloc[shortest]))
    rows = {}
    for k, i in enumerate(np.random.default_rng(ORDER_SEED).permutation(len(plan)), start=1):
        job, trial = plan[i]
        rows[i] = (job.experiment, job.folder.name, trial, *time_trial(job, trial))
        if sys.stderr.isatty():
            print(f"\r{k}/{len(plan)} trials", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr) if sys.stderr.isatty() else None
    return pd.DataFrame([rows[i] for i in sorted(rows)], columns=list(results.TIMING_COLUMNS))


def run(folders: list[Path], trials: int, config_dir: Path | None = None) -> None:
    """Time the jobs of every sweep at or below ``folders`` and write their timings."""
    import torch

    torch.set_num_threads(1)
    found = dict.fromkeys(job for folder in folders for job in results.find_jobs(folder))
    if not found:
        raise ConfigError(f"{', '.join(map(str, folders))}: no finished job found")
    configuration.register_resolvers()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        jobs = [compose_job(folder, config_dir) for folder in found]
    sweeps = dict.fromkeys(job.folder.parent for job in jobs)
    kept = {sweep: results.read_timings(sweep) for sweep in sweeps}
    timings = time_all(jobs, trials)
    names = [(job.experiment, job.folder.name) for job in jobs]
    for sweep in sweeps:
        here = {n for n, job in zip(names, jobs, strict=True) if job.folder.parent == sweep}
        mask = [pair in here for pair in zip(timings["experiment"], timings["job"], strict=True)]
        tables = [timings.loc[mask]]
        if (before := kept[sweep]) is not None:  # keep the timings of other jobs
            others = [
                pair not in here for pair in zip(before["experiment"], before["job"], strict=True)
            ]
            tables = [before.loc[others], *tables] if any(others) else tables
        results.write_timings(sweep, pd.concat(tables))
        print(f"{sweep / results.TIMINGS}: {sum(mask)} trials timed")


def main() -> int:
    """Time trials; an error prints one line on stderr and returns status 1."""
    parser = argparse.ArgumentParser(description="Time single trials of a finished sweep.")
    parser.add_argument(
        "folders", nargs="+", type=Path, metavar="DIR", help="folder of a sweep or job"
    )
    parser.add_argument(
        "--trials", type=int, default=10, help="trials of each job (default: %(default)s)"
    )
    parser.add_argument(
        "--config-dir", type=Path, metavar="DIR", help="the --config-dir used to train the jobs"
    )
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.WARNING)
    try:
        if arguments.trials < 1:
            raise ConfigError(f"--trials must be at least 1, got {arguments.trials}")
        if (own := arguments.config_dir) is not None and not own.is_dir():
            raise ConfigError(f"--config-dir {own}: no such folder")
        run(arguments.folders, arguments.trials, own)
    except (HydraException, OmegaConfBaseException, ValueError, OSError) as error:
        print(f"error: {configuration.describe(error)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; nothing was written", file=sys.stderr)
        return 130
    return 0
