"""A small finished job, written without training."""

from pathlib import Path

import numpy as np
import torch

from trl_explore import jobs as results
from trl_explore.training.trials import Trials

CONFIG = {
    "seed": 5,
    "trials": 3,
    "first_trial": 10,
    "threads": 1,
    "max_iterations": 4,
    "score_threshold": 5.0,
    "score_window": 2,
    "strategy": {"_target_": "somewhere", "epsilon": 0.1},
    "env": {"id": "CartPole-v1"},
}
WEIGHTS = {"weight": torch.arange(24.0).reshape(3, 2, 4).transpose(1, 2)}  # not contiguous

TRIALS_CSV = """\
trial,seed,iterations,converged,score,frames,seconds,status,passed,iterations_to_pass,frames_to_pass
10,5,3,False,2.5,33,1.500000,diverged,False,3,33
11,5,2,True,5.6,41,1.000000,converged,True,2,41
12,5,4,False,4.0,126,2.000000,capped,False,4,126
"""
EPISODES_CSV = """\
trial,iteration,score,frames
10,1,1.0,10
11,1,2.0,20
12,1,3.0,30
10,2,2.0,11
11,2,9.2,21
12,2,4.0,31
10,3,3.0,12
12,3,5.0,32
12,4,3.0,33
"""


def record() -> Trials:
    """One trial of each status: 10 diverges, 11 converges, 12 is capped."""
    trials = Trials(3, max_iterations=4, score_threshold=5, score_window=2)
    for scores, frames, seconds, diverged in (
        ([1, 2, 3], [10, 20, 30], 0.5, [False] * 3),
        ([2, 9.2, 4], [11, 21, 31], 1.0, [False] * 3),
        ([3, 5], [12, 32], 1.5, [True, False]),
        ([3], [33], 2.0, [False]),
    ):
        trials.record(np.array(scores, np.float64), np.array(frames), np.array(diverged), seconds)
    return trials


def write(folder: Path, **options) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    arguments = {
        "config": CONFIG,
        "experiment": "thesis",
        "strategy": "epsilon_greedy",
        "collector": "TorchRLCollector",
        "seconds": 2.25,
    }
    results.write_job(folder, record(), WEIGHTS, **{**arguments, **options})
    return folder
