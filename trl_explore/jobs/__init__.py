"""The files of a job. Only this package knows their names and columns; it writes and reads them.

    trials.csv              one row per trial
    episodes.csv            one row per episode, by iteration, then trial (unless episodes=false);
                            with diagnostics=true, also the diagnostics of the iteration
    evaluations.csv         one row per episode of the policy without its strategy, if evaluated
    scalars/*.csv           learning curves averaged over the trials (TorchRL's CSVLogger)
    weights.safetensors     the final policy of every trial
    kept_weights.safetensors    its weights along the way (keep_weights=[0,10,50])
    visits.safetensors      where the trials have been (diagnostics=true)
    run.json                configuration, versions, seed, wall time; written last

In the folder of a sweep:

    timings.csv             seconds of single trials, each run alone (``trl-explore time``)

A job is finished if and only if its folder holds ``run.json``. Every file is written atomically.
The folder of an unfinished job also holds ``checkpoint/`` (see ``trl_explore.jobs.checkpoint``),
from which the job resumes, and ``.lock`` while a process runs it.
"""

from trl_explore.jobs.columns import (
    EPISODE_COLUMNS,
    EPISODES,
    TIMING_COLUMNS,
    TIMINGS,
    TRIAL_COLUMNS,
    TRIALS,
)
from trl_explore.jobs.files import SMALL, ResultsError, check_files, flaws
from trl_explore.jobs.reading import (
    find_folders,
    find_jobs,
    is_finished,
    read_frame,
    read_job,
    read_jobs,
    read_run,
    read_trials,
)
from trl_explore.jobs.records import (
    read_curves,
    read_diagnostics,
    read_episodes,
    read_evaluations,
    read_timings,
    read_weights,
)
from trl_explore.jobs.writing import clear, versions, write_job, write_timings
from trl_explore.training.diagnostic_quantities import DIAGNOSTIC_COLUMNS

__all__ = [
    "DIAGNOSTIC_COLUMNS",
    "EPISODES",
    "EPISODE_COLUMNS",
    "SMALL",
    "TIMINGS",
    "TIMING_COLUMNS",
    "TRIALS",
    "TRIAL_COLUMNS",
    "ResultsError",
    "check_files",
    "clear",
    "find_folders",
    "find_jobs",
    "flaws",
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
