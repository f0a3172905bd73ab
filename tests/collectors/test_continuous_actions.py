"""Continuous actions in a collector: frames, noise, bounds, and what is refused."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium import spaces
from scipy import stats
from tensordict.nn import TensorDictSequential
from torchrl.envs.utils import ExplorationType

from tests.continuous import BOTH, STRATEGIES, Target, collector_of, strategy_of
from trl_explore.collectors import FusedCollector, NotCompilableError, TorchRLCollector
from trl_explore.envs import make_env
from trl_explore.numerics.streams import Stream, generator
from trl_explore.policies import GaussianLinearPolicy, LinearPolicy
from trl_explore.strategies import (
    EpsilonMean,
    EpsilonUniform,
    Gaussian,
    MeanAction,
    Softmax,
    UniformAction,
)
from trl_explore.training.evaluation import acting


@pytest.mark.parametrize("name", STRATEGIES)
@pytest.mark.parametrize("policy", BOTH)
def test_frames(name, policy):
    strategy = strategy_of(name)
    collector = collector_of(strategy, policy)
    data = collector.collect(np.array([True, False, True])).frames
    assert data["action"].shape == (60, 1)
    assert data["action"].dtype == torch.float32
    assert data["trial"].tolist() == [0] * 30 + [2] * 30
    assert ("action_log_prob" in data) == strategy.exact
    assert strategy.noise_size == 2
    torch.testing.assert_close(
        data["next", "episode_reward"][29], data["next", "reward"][:30].sum(0)
    )


def test_actions_come_from_the_trials_streams():
    collector = collector_of(Gaussian(), initial_scale=0.5)
    data = collector.collect().frames
    written = collector.policy[0](data.clone())
    for k in range(3):
        noise = generator(2, Stream.ACTION, k, 0).random((30, 2))
        mine = data["trial"] == k
        loc, scale = (written[key][mine].detach().double().numpy() for key in ("loc", "scale"))
        expected = stats.norm.ppf(noise[:, :1], loc, scale)
        np.testing.assert_allclose(data["action"][mine], expected, rtol=1e-5, atol=1e-5)
        density = stats.norm.logpdf(data["action"][mine].double(), loc, scale).sum(-1)
        np.testing.assert_allclose(data["action_log_prob"][mine], density, rtol=1e-4, atol=1e-4)


def test_the_environment_clips_and_the_data_do_not():
    data = collector_of(Gaussian(), initial_scale=50.0).collect().frames
    assert data["action"].abs().max() > 20
    # Pendulum's reward has 0.001 u^2, |u| <= 2, beside at most pi^2 + 0.1 * 8^2.
    assert (data["next", "reward"] >= -(np.pi**2 + 6.4 + 0.004) - 1e-3).all()


def test_exploration_off_is_the_mean_action():
    mean = collector_of(MeanAction())
    quiet = collector_of(Gaussian())
    quiet.exploration_type = ExplorationType.DETERMINISTIC
    a, b = mean.collect().frames, quiet.collect().frames
    assert torch.equal(a["action"], b["action"])
    assert torch.equal(a["next", "reward"], b["next", "reward"])
    greedy = collector_of(acting(EpsilonMean(), "greedy")).collect().frames
    assert torch.equal(greedy["action"], a["action"])


def test_strategies_differ_in_nothing_else():
    """Paired: with the same policy, frames that are not uniform have the same noise."""
    gaussian, mixed = (
        collector_of(s, max_steps=1).collect().frames for s in (Gaussian(), EpsilonUniform())
    )
    assert torch.equal(gaussian["observation"], mixed["observation"])
    uniform = torch.tensor([generator(2, Stream.ACTION, k, 0).random(2)[1] < 0.3 for k in range(3)])
    assert torch.equal((gaussian["action"] != mixed["action"]).squeeze(-1), uniform)


def test_the_other_kind_is_refused():
    pendulum, cartpole = make_env("Pendulum-v1", 2), make_env("CartPole-v1", 2)
    with pytest.raises(ValueError, match=r"Softmax.*discrete actions"):
        TorchRLCollector(pendulum, TensorDictSequential(GaussianLinearPolicy(pendulum), Softmax()))
    with pytest.raises(ValueError, match=r"Gaussian.*continuous actions"):
        TorchRLCollector(cartpole, TensorDictSequential(LinearPolicy(cartpole), Gaussian()))
    with pytest.raises(NotCompilableError, match="no kernel is registered"):
        FusedCollector(pendulum, TensorDictSequential(GaussianLinearPolicy(pendulum), Gaussian()))


def test_a_box_without_bounds():
    class Endless(Target):
        action_space = spaces.Box(-np.inf, np.inf, (2,), np.float32)

    gym.register("Endless-v0", entry_point=Endless, max_episode_steps=1)
    env = make_env("Endless-v0", 2)
    policy = GaussianLinearPolicy(env)
    data = TorchRLCollector(env, TensorDictSequential(policy, Gaussian())).collect().frames
    assert data["action"].shape == (2, 2)
    for strategy in (UniformAction(), EpsilonUniform(), EpsilonMean()):
        with pytest.raises(ValueError, match=r"box.*finite"):
            TorchRLCollector(env, TensorDictSequential(policy, strategy))
    del gym.registry["Endless-v0"]


def test_state_of_the_collector():
    first, second = (collector_of(Gaussian([0.5, 1.0, 2.0])) for _ in range(2))
    first.collect()
    second.load_state_dict(first.state_dict())
    assert torch.equal(first.collect().frames["action"], second.collect().frames["action"])
