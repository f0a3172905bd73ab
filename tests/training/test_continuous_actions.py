"""Training with continuous actions: trials are independent, and they learn."""

from __future__ import annotations

from functools import partial

import gymnasium as gym
import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictSequential

from tests.continuous import BOTH, STRATEGIES, Target, strategy_of
from trl_explore.collectors import TorchRLCollector
from trl_explore.envs import make_env
from trl_explore.objectives import ReinforceLoss
from trl_explore.objectives.baselines import LeaveOneOut
from trl_explore.objectives.corrections import PerStep
from trl_explore.policies import GaussianLinearPolicy
from trl_explore.policies.actor import actor_of
from trl_explore.strategies import (
    EpsilonUniform,
    Gaussian,
)
from trl_explore.training.optimizers import LaneAdam
from trl_explore.training.trainer import Trainer
from trl_explore.training.trials import Trials


@pytest.fixture(autouse=True)
def _target():
    torch.set_num_threads(1)
    gym.register("Target-v0", entry_point=Target, max_episode_steps=10)
    yield
    del gym.registry["Target-v0"]


def trainer_of(
    strategy, policy, trials, first_trial=0, *, id="Target-v0", steps=None, iterations=5, k=2,
    correction=None, gamma=0.0,
) -> Trainer:  # fmt: skip
    streams = {"seed": 2, "first_trial": first_trial}
    env = make_env(id, trials, steps, **streams)
    built = policy(env, **streams)
    return Trainer(
        TorchRLCollector(env, TensorDictSequential(built, strategy), episodes_per_update=k),
        ReinforceLoss(
            actor_of(built), gamma=gamma, weight=1.0, trials=trials, functional=False,
            baseline=LeaveOneOut(), correction=correction, strategy=strategy,
        ),
        LaneAdam(built.parameters(), lr=0.05),
        Trials(trials, max_iterations=iterations, score_threshold=1e9, score_window=5),
    )  # fmt: skip


@pytest.mark.parametrize("name", STRATEGIES)
@pytest.mark.parametrize("policy", BOTH)
def test_a_trial_of_a_batch_is_the_trial_alone(name, policy):
    def run(trials, first_trial=0):
        trainer = trainer_of(
            strategy_of(name), policy, trials, first_trial, id="Pendulum-v1", steps=25, gamma=0.99
        )
        trainer.run()
        return trainer

    batch = run(6)
    for k in (0, 2, 5):
        alone = run(1, k)
        for a, b in zip(batch.optimizer.parameters, alone.optimizer.parameters, strict=True):
            assert torch.equal(a[k], b[0])
        episodes, own = batch.trials.episodes(), alone.trials.episodes()
        assert episodes["score"][episodes["trial"] == k].tolist() == own["score"].tolist()


def first_and_last(trainer):
    """Mean reward of the first and of the last 20 episodes of every trial."""
    trainer.run()
    episodes = trainer.trials.episodes()
    trials = len(trainer.trials)
    scores = np.stack([episodes["score"][episodes["trial"] == k] for k in range(trials)])
    return scores[:, :20].mean(1) / 10, scores[:, -20:].mean(1) / 10


@pytest.mark.parametrize("policy", BOTH)
def test_a_gaussian_policy_learns_to_reach_the_target(policy):
    first, last = first_and_last(trainer_of(Gaussian(), policy, 4, iterations=80))
    assert (first < -1).all()
    assert (last > -0.3).all()


def test_importance_weights_make_exploration_unbiased():
    """Uncorrected, uniform frames pull the mean and widen the scale; the ratio mends that."""
    build = partial(trainer_of, EpsilonUniform(), GaussianLinearPolicy, 4, iterations=60)
    _, biased = first_and_last(build())
    first, last = first_and_last(build(correction=PerStep()))
    assert (last > first + 0.5).all()
    assert (last > biased + 1).all()
