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
    "config": (dict,), "strategy": (str,), "experiment": (str,), "trials": (int,),
    "versions": (dict,), "seed": (int,), "collector": (str,), "seconds": (int, float),
    "machine": (dict,),
}  # fmt: skip
CONFIG_KEYS = {
    "strategy": (dict,), "max_iterations": (int,), "score_threshold": (int, float),
    "score_window": (int,),
}  # fmt: skip
PACKAGES = ("trl_explore", "torch", "torchrl", "tensordict", "gymnasium", "numpy", "numba")


class ResultsError(ValueError):
    """A folder that does not hold what it should; the message is one line."""
