"""The names of the files of a job, and of their columns; no other module knows them."""

from __future__ import annotations

TRIALS, EPISODES, SCALARS = "trials.csv", "episodes.csv", "scalars"
WEIGHTS, RUN = "weights.safetensors", "run.json"
TRIAL_COLUMNS = (
    "trial", "seed", "iterations", "converged", "score", "frames", "seconds", "status",
)  # fmt: skip
EPISODE_COLUMNS = ("trial", "iteration", "score", "frames")
EVALUATIONS = "evaluations.csv"
EVALUATION_COLUMNS = ("trial", "iteration", "score")
TIMINGS = "timings.csv"
TIMING_COLUMNS = ("experiment", "job", "trial", "seconds", "frames")
RUN_KEYS = {
    "config", "strategy", "experiment", "trials", "versions", "seed", "collector", "seconds",
    "machine",
}  # fmt: skip
CONFIG_KEYS = {"strategy", "max_iterations", "score_threshold", "score_window"}
PACKAGES = ("trl_explore", "torch", "torchrl", "tensordict", "gymnasium", "numpy", "numba")


class ResultsError(ValueError):
    """A folder that does not hold what it should; the message is one line."""
