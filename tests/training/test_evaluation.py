"""Evaluation must not touch training, and diagnostics must be what they say."""

import math

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_dir
from tensordict import TensorDict
from tensordict.nn import TensorDictSequential

from trl_explore import config as configuration
from trl_explore.collectors import TorchRLCollector
from trl_explore.config import CONF
from trl_explore.config.building import build_trainer
from trl_explore.envs import make_env
from trl_explore.numerics.streams import Stream, generator
from trl_explore.policies import LinearPolicy
from trl_explore.policies.actor import SoftmaxActor
from trl_explore.strategies import EpsilonGreedy, ParameterNoise
from trl_explore.training.diagnostics import COLUMNS, Diagnostics


@pytest.fixture(scope="module", autouse=True)
def hydra():
    configuration.register_resolvers()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        yield


def trained(*overrides):
    config = compose(
        "train", [*overrides, "trials=4", "max_iterations=24", "score_window=6"],
        return_hydra_config=True,
    )  # fmt: skip
    trainer = build_trainer(config)
    trainer.run()
    return trainer


@pytest.mark.parametrize("strategy", ["epsilon_greedy", "softmax"])
def test_training_is_the_same_evaluated_or_not(strategy):
    plain = trained(f"strategy={strategy}")
    other = trained(
        f"strategy={strategy}", "evaluate_every=5", "evaluate_episodes=3", "diagnostics=true"
    )
    for name, column in plain.trials.episodes().items():
        np.testing.assert_array_equal(column, other.trials.episodes()[name])
    assert torch.equal(plain.collector.policy[0].weight, other.collector.policy[0].weight)


def test_every_evaluation_is_recorded():
    rows = trained("evaluate_every=7", "evaluate_episodes=2").evaluator.rows()
    assert rows["iteration"].tolist() == [7] * 8 + [14] * 8 + [21] * 8
    assert rows["trial"].tolist() == [0, 0, 1, 1, 2, 2, 3, 3] * 3
    assert (rows["score"] >= 1).all()


def test_a_greedy_episode_repeats_gymnasiums():
    """The recorded score is that of argmax(W s) in gymnasium, from the trial's own stream."""
    import gymnasium as gym

    trainer = trained("evaluate_every=24", "seed=5")
    for trial in range(4):
        env = gym.make("CartPole-v1").unwrapped
        env.np_random = generator(5, Stream.EVALUATION, trial, 0)
        weight = trainer.collector.policy[0].weight.detach().numpy()[trial]
        state, _ = env.reset()
        score, ended = 0, False
        while not ended and score < 500:
            state, _, ended, _, _ = env.step(int(np.argmax(weight @ state)))
            score += 1
        assert trainer.evaluator.rows()["score"][trial] == score


def test_the_stopping_rule_can_follow_the_evaluation():
    trainer = trained(
        "stop_on=evaluation", "evaluate_every=2", "evaluate_episodes=3", "score_threshold=5"
    )
    # Every greedy episode lasts for more than 5 steps; a window of 6 is full after two evaluations.
    assert trainer.trials.iterations.tolist() == [4] * 4
    assert trainer.trials.converged.all()


def test_evaluations_survive_a_checkpoint():
    overrides = ("trials=4", "evaluate_every=3", "diagnostics=true", "max_iterations=9")
    config = compose("train", list(overrides), return_hydra_config=True)
    first, second = build_trainer(config), build_trainer(config)
    first.run()
    for name in ("evaluator", "diagnostics"):
        second.parts[name].load_history(first.parts[name].history())
        second.parts[name].load_state_dict(first.parts[name].state_dict())
    for name, column in first.evaluator.rows().items():
        np.testing.assert_array_equal(column, second.evaluator.rows()[name])
    for name, column in first.diagnostics.columns().items():
        np.testing.assert_array_equal(column, second.diagnostics.columns()[name])


def test_diagnostics_by_hand():
    """One trial, π = (1/4, 3/4), μ = ε-greedy at 0.4 = (0.2, 0.8), actions 1, 0, 1, 1."""
    env = make_env("CartPole-v1", trials=1)
    policy = LinearPolicy(env)
    with torch.no_grad():
        policy.weight.zero_()
        policy.weight[0, 1, 0] = math.log(3)
    pi, mu = (0.25, 0.75), (0.2, 0.8)
    action = torch.tensor([1, 0, 1, 1])
    observation = torch.tensor([[1.0, 0, 0, 0]] * 3 + [[1.0, 0.25, 0, 0]])
    done = torch.tensor([[False], [False], [False], [True]])
    data = TensorDict(
        {
            "trial": torch.zeros(4, dtype=torch.int64),
            "observation": observation,
            "action": action,
            "action_log_prob": torch.tensor([mu[a] for a in action]).log(),
            "next": {"reward": torch.ones(4, 1), "done": done},
        },
        [4],
    )
    policy.weight.grad = torch.tensor([[[3.0, 0, 0, 0], [0, 4.0, 0, 0]]])
    diagnostics = Diagnostics(SoftmaxActor(policy), EpsilonGreedy(0.4), 1, policy.parameters())
    diagnostics.record(data, np.ones(1, dtype=np.bool_))
    found = {name: float(column[0]) for name, column in diagnostics.columns().items()}
    ratios = np.array([pi[a] / mu[a] for a in action])
    expected = {
        "entropy_policy": -sum(p * math.log(p) for p in pi),
        "entropy_behaviour": -sum(p * math.log(p) for p in mu),
        "kl": sum(m * math.log(m / p) for m, p in zip(mu, pi, strict=True)),
        "ratio_mean": ratios.mean(),
        "effective_sample_size": ratios.sum() ** 2 / (4 * (ratios**2).sum()),
        "exploratory": 0.25,
        "greedy_share": 1.0,
        "coverage": 2.0,
        "gradient_norm": 5.0,
    }
    assert set(found) == set(COLUMNS)
    assert found == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("episodes", [1, 3])
def test_what_is_said_of_the_behaviour_is_that_of_the_frames(episodes):
    """Under parameter noise μ is known of one episode: of more there is nothing to be said."""
    env = make_env("CartPole-v1", trials=2)
    policy, strategy = LinearPolicy(env), ParameterNoise(sigma=2.0)
    collector = TorchRLCollector(
        env, TensorDictSequential(policy, strategy), episodes_per_update=episodes
    )
    data = collector.collect().frames
    diagnostics = Diagnostics(SoftmaxActor(policy), strategy, 2, policy.parameters())
    diagnostics.record(data, np.ones(2, dtype=np.bool_))
    columns = diagnostics.columns()
    assert np.isfinite(columns["ratio_mean"]).all()
    if episodes > 1:
        assert np.isnan([columns["entropy_behaviour"], columns["kl"]]).all()
        return
    weight = policy.weight.detach().double()
    for k in range(2):
        own = data[data["trial"] == k]
        xi = generator(0, Stream.STRATEGY, k, 0).standard_normal((2, 4))
        x = own["observation"].double()
        log_mu = (x @ (weight[k] + 2 * torch.from_numpy(xi)).T).log_softmax(-1)
        log_pi = (x @ weight[k].T).log_softmax(-1)
        kl = (log_mu.exp() * (log_mu - log_pi)).sum(-1).mean()
        assert columns["kl"][k] == pytest.approx(float(kl), rel=1e-4)
