"""Run finished jobs again, and say whether their results are the same: ``trl-explore verify DIR``.

On the same kind of processor and with the same versions, every number of a job is the same. On
others, the last bits of a weight may differ, and a trial may take another course from some
iteration on.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trl_explore import config as configuration
from trl_explore import jobs as results
from trl_explore.config.composing import RecordedJob, recompose_all
from trl_explore.jobs.console import Progress, printable, tell

TOLERANCE = 1e-5
"""The largest difference of weights, relative to the largest, that is called rounding."""
SAME, CLOSE = "equal", "equal within rounding"


def verify(job: RecordedJob, place: tuple[int, int] = (0, 1)) -> str:
    """Train the trials of a job again; returns in words how the results compare.

    ``place``: the number of the job, from 0, and the number of jobs, for the progress line.

    ``equal``: every trial has the same outcome, scores and weights. ``equal within rounding``: the
    same outcomes and scores, and weights that differ by at most ``TOLERANCE``. Otherwise the words
    name the first difference.
    """
    shards = configuration.build_shards(job.config)
    records = [trainer.trials for trainer in shards.trainers]
    progress = Progress(job.folder.name, records, place=place)
    for trainer in shards.trainers:
        trainer.on_iteration = lambda trials: progress()
    try:
        trials = shards.run(job.config.threads)
        weights = {name: w.detach().numpy() for name, w in shards.weights().items()}
    finally:
        progress.close()
        shards.close()
    first = int(job.config.first_trial)
    if (job.folder / results.EPISODES).is_file():
        old = results.read_episodes(job.folder)
        new = trials.episodes()
        rows = min(len(old), len(new["trial"]))
        same = [
            old[name].to_numpy()[:rows] == new[name][:rows] + (first if name == "trial" else 0)
            for name in ("trial", "iteration", "score", "frames")
        ]
        wrong = ~np.logical_and.reduce(same)
        if wrong.any():
            row = old.iloc[int(np.argmax(wrong))]
            return f"different from iteration {row['iteration']:.0f} on (trial {row['trial']:.0f})"
    for name in ("iterations", "frames", "score", "status"):
        wrong = job.trials[name].to_numpy() != np.asarray(getattr(trials, name))
        if wrong.any():
            return f"different {name} of trial {first + int(np.argmax(wrong))}"
    recorded = results.read_weights(job.folder)
    if {name: w.shape for name, w in recorded.items()} != {k: w.shape for k, w in weights.items()}:
        return "different names or shapes of weights"
    error = max((_distance(old, weights[name]) for name, old in recorded.items()), default=0.0)
    if error == 0:
        return SAME
    how = f"weights differ by up to {error:.1g} of the largest"
    return f"{CLOSE} ({how})" if error <= TOLERANCE else f"different: {how}"


def _distance(old: NDArray[Any], new: NDArray[Any]) -> float:
    """The largest difference of weights, relative to the largest; of a NaN to a number, ∞."""
    differs = (old != new) & ~(np.isnan(old) & np.isnan(new))
    if not differs.any():
        return 0.0
    with np.errstate(all="ignore"):
        largest = np.abs(old[np.isfinite(old)]).max(initial=0.0)
        distance = np.abs(old - new)[differs].max() / largest
    return np.inf if np.isnan(distance) else float(distance)


def main() -> int:
    """Verify jobs; returns status 1 if a job is different, or after one line with an error."""
    parser = argparse.ArgumentParser(
        description="Run finished jobs again, and say whether their results are the same."
    )
    parser.add_argument(
        "folders", nargs="+", type=Path, metavar="DIR", help="folder of a sweep or job"
    )
    parser.add_argument(
        "--config-dir", type=Path, metavar="DIR", help="the --config-dir used to train the jobs"
    )
    arguments = parser.parse_args()
    different = False
    try:
        found = recompose_all(arguments.folders, arguments.config_dir)
        for number, job in enumerate(found):
            words = verify(job, (number, len(found)))
            different |= not words.startswith(SAME)
            print(f"{printable(job.folder.name)}: {words}", flush=True)
    except configuration.ERRORS as error:
        tell(configuration.describe(error))
        return 1
    return 1 if different else 0
