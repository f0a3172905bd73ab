"""Time single trials of a finished sweep: ``trl-explore time DIR [--trials N]``.

The seconds in the results of a sweep are those of whole batches. The thesis measured the time of
single trials that run alone. This command reruns trials of every finished job in DIR, one at a time
in this process, on one thread, in random order over all jobs, after a warm-up that compiles and
loads everything. It writes ``timings.csv`` to the folder of the sweep and keeps the timings of
other jobs there. Only training is timed, not imports, the construction of the agent or files.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd

from trl_explore import config as configuration
from trl_explore import jobs as results
from trl_explore.config import ConfigError
from trl_explore.config.composing import RecordedJob, recompose_all
from trl_explore.jobs.console import Bar, printable, tell

ORDER_SEED = 0
"""Seed of the order in which the trials run."""


def time_trial(job: RecordedJob, trial: int) -> tuple[float, int]:
    """Run one trial alone; return its seconds of training and its number of frames.

    Raises:
        ConfigError: if the number of frames differs from that in the job.
    """
    trainer = job.trainer(trial)
    try:
        started = time.perf_counter()
        trials = trainer.run()
        seconds = time.perf_counter() - started - trainer.evaluating
    finally:
        trainer.close()
    frames = int(trials.frames[0])
    recorded = int(job.trials["frames"].iloc[trial - job.config.first_trial])
    if frames != recorded:
        raise ConfigError(
            f"{job.folder}: trial {trial} took {frames} frames alone and {recorded} in the"
            " job; the program has changed since the job ran"
        )
    return seconds, frames


def time_all(jobs: list[RecordedJob], trials: int) -> pd.DataFrame:
    """Time the first ``trials`` trials of every job, in random order."""
    plan = [(job, int(t)) for job in jobs for t in job.trials["trial"].iloc[:trials]]
    for job in jobs:  # warm-up: the shortest trial of each
        shortest = job.trials["frames"].iloc[:trials].argmin()
        time_trial(job, int(job.trials["trial"].iloc[shortest]))
    rows = {}
    bar = Bar("timing single trials")
    for k, i in enumerate(np.random.default_rng(ORDER_SEED).permutation(len(plan)), start=1):
        job, trial = plan[i]
        rows[i] = (job.experiment, job.folder.name, trial, *time_trial(job, trial))
        if bar.due:
            bar.show(k, len(plan), f"{k}/{len(plan)} trials")
    bar.close()
    return pd.DataFrame([rows[i] for i in sorted(rows)], columns=list(results.TIMING_COLUMNS))


def run(folders: list[Path], trials: int, config_dir: Path | None = None) -> None:
    """Time the jobs of every sweep at or below ``folders`` and write their timings."""
    import torch

    torch.set_num_threads(1)
    jobs = recompose_all(folders, config_dir)
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
        print(f"{printable(str(sweep / results.TIMINGS))}: {sum(mask)} trials timed")


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
    try:
        if arguments.trials < 1:
            raise ConfigError(f"--trials must be at least 1, got {arguments.trials}")
        run(arguments.folders, arguments.trials, arguments.config_dir)
    except configuration.ERRORS as error:
        tell(configuration.describe(error))
        return 1
    except KeyboardInterrupt as error:
        print(f"{str(error) or 'interrupted'}; nothing was written", file=sys.stderr)
        return getattr(error, "status", 130)
    return 0
