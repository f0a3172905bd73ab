"""The whole program against an independent implementation of the thesis's appendix.

That implementation is scalar code that shares nothing with this one; it ran 20,000 trials of each
strategy (CartPole-v1, γ 0.99, Adam 0.05, Glorot-uniform weights, full window of 100, > 195,
cap 1000). Here fewer trials run, and must agree within their sampling error.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_dir
from scipy import stats

from trl_explore.collectors import TorchRLCollector
from trl_explore.config import CONF, build_trainer, register_resolvers

ALPHA = 1e-4
"""Share of right programs that a single check would refuse, were its seed drawn at random."""

CAP = 1000

# strategy: share that converges; iterations by which a share of all trials has stopped, as far
# as they are below the cap; mean final score
REFERENCE: dict[str, tuple[float, dict[float, int], float]] = {
    "random": (0.0, {}, 22.3),
    "argmax": (0.446, {0.05: 100, 0.25: 141}, 111.0),
    "epsilon_greedy": (0.949, {0.05: 193, 0.25: 234, 0.5: 380, 0.75: 634}, 189.0),
    "decaying_epsilon_greedy": (
        0.983,
        {0.05: 134, 0.25: 155, 0.5: 186, 0.75: 221, 0.95: 264},
        194.0,
    ),
    "softmax": (0.99995, {0.05: 102, 0.25: 125, 0.5: 148, 0.75: 179, 0.95: 244}, 198.0),
}
ROUNDING = {"random": 0.05}
"""Half a unit of the last digit of the reference's mean score; 0.5 where not named."""


def run(*overrides: str) -> Any:
    torch.set_num_threads(1)
    register_resolvers()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        config = compose("train", overrides=list(overrides))
    trainer = build_trainer(config)
    trainer.run()
    return trainer


def binomial_bounds(n: int, p: float) -> tuple[int, int]:
    """The counts between which Binomial(n, p) lies with probability 1 − ALPHA or more."""
    return int(stats.binom.ppf(ALPHA / 2, n, p)), int(stats.binom.ppf(1 - ALPHA / 2, n, p))


def check_converged(trials: Any, share: float) -> None:
    low, high = binomial_bounds(len(trials), share)
    assert low <= int(trials.converged.sum()) <= high


def check_iterations(trials: Any, quantiles: dict[float, int]) -> None:
    """P(iterations < q) <= p <= P(iterations <= q), tested with the exact binomial bounds."""
    n = len(trials)
    for p, q in quantiles.items():
        low, high = binomial_bounds(n, p)
        # One iteration to either side: the reference's quantiles are rounded, and estimates.
        assert int((trials.iterations <= q + 1).sum()) >= low, (p, q)
        assert int((trials.iterations < q - 1).sum()) <= high, (p, q)


def check_score(trials: Any, mean: float, rounding: float) -> None:
    error = trials.score.std(ddof=1) / np.sqrt(len(trials))
    bound = stats.t.ppf(1 - ALPHA / 2, len(trials) - 1) * error + rounding
    assert abs(trials.score.mean() - mean) <= bound


@pytest.mark.parametrize("strategy", REFERENCE)
def test_the_program_agrees_with_an_independent_one(strategy):
    share, quantiles, score = REFERENCE[strategy]
    trainer = run("collector=auto", f"strategy={strategy}", "trials=300", f"max_iterations={CAP}")
    assert not isinstance(trainer.collector, TorchRLCollector)
    trials = trainer.trials
    assert set(trials.status) <= {"converged", "capped"}
    check_converged(trials, share)
    check_iterations(trials, quantiles)
    check_score(trials, score, ROUNDING.get(strategy, 0.5))
    assert trials.iterations.max() <= CAP
    assert (trials.iterations[~trials.converged] == CAP).all()
    assert trials.iterations.min() >= 100


@pytest.mark.parametrize("strategy", ["softmax", "epsilon_greedy"])
def test_both_collectors_train_the_same_agents(strategy):
    """What holds for hundreds of trials of the compiled collector holds for TorchRL's too."""
    job = [f"strategy={strategy}", "trials=15", "score_window=15", "score_threshold=50"]
    one, two = (
        run(*job, "max_iterations=50", f"collector={collector}").trials
        for collector in ("torchrl", "auto")
    )
    assert 0 < one.converged.sum() <= 15
    # Rounding may lead single trials apart, once in thousands of episodes.
    same = (one.iterations == two.iterations) & (one.frames == two.frames)
    assert same.sum() >= 14


def test_random_through_torchrl():
    """Its final score is the same after 100 episodes as after 1000: nothing learnt is used."""
    trials = run("collector=torchrl", "strategy=random", "trials=20", "max_iterations=100").trials
    assert not trials.converged.any()
    check_score(trials, REFERENCE["random"][2], 0.05)


def test_the_bounds_by_hand():
    assert binomial_bounds(200, 0.5) == (73, 127)
