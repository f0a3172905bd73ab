"""What a job returns to Optuna."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
from omegaconf import OmegaConf

from trl_explore.config.tuning_value import objective, worst
from trl_explore.statistics.outcomes import Outcomes


def outcomes(**changes):
    base = Outcomes(
        name="job", experiment="", strategy="softmax", parameters={},
        config={"stop_on": "training", "env": {"id": "Acrobot-v1", "max_steps": 500}},
        cap=100, threshold=0.0, window=10, trial=np.arange(4), seed=np.zeros(4, int),
        iterations=np.array([40, 60, 100, 7]), converged=np.array([True, True, False, False]),
        score=np.array([1.0, 2.0, -300.0, np.nan]), frames=np.ones(4, int), seconds=np.ones(4),
        status=np.array(["converged", "converged", "capped", "diverged"]),
    )  # fmt: skip
    return replace(base, **changes)


def test_the_restricted_mean_counts_diverged_trials_as_the_cap():
    assert objective(outcomes(), "minimize") == (40 + 60 + 100 + 100) / 4


def test_scores_of_diverged_trials_are_the_lowest_of_the_environment():
    assert objective(outcomes(), "maximize") == (1 + 2 - 300 - 500) / 4
    unknown = outcomes(config={"env": {"id": "Own-v0"}})
    assert objective(unknown, "maximize") == (1 + 2 - 300 - 1e6) / 4


def test_what_was_learned_comes_first():
    learned = outcomes(
        learned=np.arange(4) == 0, iterations_to_learn=np.array([0, 60, 100, 7]),
        frames_to_learn=np.ones(4, int), learned_score=np.array([10.0, 20.0, 30.0, 40.0]),
        config={"stop_on": "never", "env": {"id": "CartPole-v1", "max_steps": 500}},
        iterations=np.array([100, 100, 100, 7]),
    )  # fmt: skip
    assert objective(learned, "minimize") == (1 + 3 * 100) / 4
    assert objective(learned, "maximize") == (10 + 20 + 30 + 0) / 4


def test_a_job_that_failed_is_finite_and_worst():
    config = OmegaConf.create({"max_iterations": 500, "env": {"id": "CartPole-v1"}})
    assert worst(config, "minimize") == 500
    assert worst(config, "maximize") == 0
    assert worst(OmegaConf.create({"env": None, "max_iterations": "x"}), "minimize") == 1e9
    assert worst(OmegaConf.create({}), "maximize") == -1e6


def test_optuna_with_a_diverged_and_a_failing_job(tmp_path):
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "scripts/train.py", "-m", "hydra/sweeper=optuna",
         "hydra/sweeper/sampler=grid", "strategy=epsilon_greedy",
         "strategy.epsilon=choice(0.1,3)", "optimizer.lr=choice(0.01,1e30)",
         "hydra.sweeper.n_jobs=2", "hydra.sweeper.direction=[minimize,maximize]", "trials=2",
         "max_iterations=4", "score_window=2", "evaluate_every=0", f"output_dir={tmp_path}",
         "hydra/launcher=joblib"],
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert run.returncode == 1, run.stderr  # two of four jobs failed
    assert "Traceback" not in run.stderr
    assert "2 of 4 jobs failed" in run.stderr
    assert "2 diverged" in run.stdout
    assert "best: strategy.epsilon=0.1 optimizer.lr=0.01 (4, " in run.stdout
