"""The files of a job: the only place that knows their names and columns, for writing and reading.

    trials.csv              one row per trial
    episodes.csv            one row per episode, by iteration and then trial (can be switched off);
                            with diagnostics=true what happened inside of the trial, too
    evaluations.csv         one row per episode of the greedy policy, where it was evaluated
    scalars/*.csv           learning curves averaged over the trials (TorchRL's CSVLogger)
    weights.safetensors     the final policy of every trial
    run.json                configuration, versions, seed, wall time; written last

Beside the jobs, in the folder of their sweep:

    timings.csv             seconds of single trials, each run by itself (``trl-explore time``)

A folder holds a finished job exactly if it holds ``run.json``. Every file appears at once and
whole. While a job is not finished, its folder also holds ``checkpoint/`` (see
``trl_explore.jobs.checkpoint``), from which it goes on, and ``.lock`` while a process runs it.
"""

from trl_explore.jobs.columns import (
    EPISODE_COLUMNS,
    EPISODES,
    TIMING_COLUMNS,
    TIMINGS,
    TRIAL_COLUMNS,
    TRIALS,
    ResultsError,
)
from trl_explore.jobs.reading import (
    check_whole,
    find_folders,
    find_jobs,
    is_finished,
    read_curves,
    read_episodes,
    read_frame,
    read_job,
    read_jobs,
    read_run,
    read_timings,
    read_trials,
    read_weights,
)
from trl_explore.jobs.records import read_diagnostics, read_evaluations
from trl_explore.jobs.writing import clear, versions, write_job, write_timings
from trl_explore.training.columns import DIAGNOSTIC_COLUMNS

__all__ = [
    "DIAGNOSTIC_COLUMNS",
    "EPISODES",
    "EPISODE_COLUMNS",
    "TIMINGS",
    "TIMING_COLUMNS",
    "TRIALS",
    "TRIAL_COLUMNS",
    "ResultsError",
    "check_whole",
    "clear",
    "find_folders",
    "find_jobs",
    "is_finished",
    "read_curves",
    "read_diagnostics",
    "read_episodes",
    "read_evaluations",
    "read_frame",
    "read_job",
    "read_jobs",
    "read_run",
    "read_timings",
    "read_trials",
    "read_weights",
    "versions",
    "write_job",
    "write_timings",
]
